//! The truth about a frame, which detections are tested against.

use scene::{Camera, MAX_POINTS, Pose, Scene};

use crate::homography::{Homography, Point};
use crate::layer::covers;

/// Samples along a side of a marker.
const SAMPLES: usize = 20;

/// The truth about a marker.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Truth {
    /// Where its centre is seen, px.
    pub pixel: [f64; 2],
    /// Its centre lies inside an occlusion or outside the image.
    pub occluded: bool,
    /// Share of its square that is covered by occlusions or lies outside the image, 0 to 1.
    pub covered: f64,
}

/// The truth about each marker of a scene: squares of this side (m) about the pattern's points, seen
/// from a pose. A marker behind the camera is occluded, covered, and seen at the principal point.
/// `shown(i)` returns whether occlusion i is there.
pub fn truth(
    scene: &Scene,
    pose: &Pose,
    side: f64,
    shown: impl Fn(usize) -> bool,
) -> heapless::Vec<Truth, MAX_POINTS> {
    let camera = &scene.camera;
    let plane = Homography::of_pose(camera, pose);
    let hidden = |point: Point| {
        plane.apply(point).is_none_or(|[u, v]| {
            let mut there = scene.occlusions.iter().enumerate();
            !inside(camera, u, v) || there.any(|(i, shape)| shown(i) && covers(shape, u, v))
        })
    };
    let of_point = |point: &[f64; 3]| {
        let center = [point[0], point[1]];
        let offset = |i: usize| side * ((i as f64 + 0.5) / SAMPLES as f64 - 0.5);
        let samples = (0..SAMPLES * SAMPLES).filter(|k| {
            let [x, y] = [offset(k % SAMPLES), offset(k / SAMPLES)];
            hidden([center[0] + x, center[1] + y])
        });
        Truth {
            pixel: plane.apply(center).unwrap_or([camera.cx, camera.cy]),
            occluded: hidden(center),
            covered: samples.count() as f64 / (SAMPLES * SAMPLES) as f64,
        }
    };
    scene.pattern.iter().map(of_point).collect()
}

fn inside(camera: &Camera, u: f64, v: f64) -> bool {
    (0.0..=camera.width - 1.0).contains(&u) && (0.0..=camera.height - 1.0).contains(&v)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn half_a_marker_behind_a_border_is_half_covered() {
        let scene = Scene::parse(scene::PAPER_ROBOT, "robot").unwrap();
        // Shift the first marker, at the goal near (214.6, 143.4) px, onto the left border of the
        // object's box.
        let mut pose = scene.goal;
        pose.translation = [0.06 + 0.35 * (200.0 - 320.0) / 615.0, 0.17, 0.35];
        let there = truth(&scene, &pose, 0.012, |_| true)[0];
        assert!((there.covered - 0.5).abs() < 0.05, "{there:?}");
        let gone = truth(&scene, &pose, 0.012, |i| i == 0)[0];
        assert_eq!((gone.covered, gone.occluded), (0.0, false));
    }

    #[test]
    fn a_marker_behind_the_camera_is_occluded() {
        let scene = Scene::parse(scene::PAPER_ROBOT, "robot").unwrap();
        let mut pose = scene.goal;
        pose.translation[2] = -0.3;
        let all = truth(&scene, &pose, 0.012, |_| true);
        assert!(
            all.iter()
                .all(|marker| marker.occluded && marker.covered == 1.0)
        );
    }
}
