//! The paper's free-flying camera: it moves exactly as told and projects the pattern.

use nalgebra::Point3;
use scene::{MAX_POINTS, Pose, Scene};

use crate::pose::{RigidPose, from_scene, seen_after};

/// Image points of the pattern, px.
pub type Points = heapless::Vec<[f64; 2], MAX_POINTS>;

/// A point of the pattern is not in front of the camera.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("point {point} of the pattern is behind the camera")]
pub struct Hidden {
    /// Index of the point.
    pub point: usize,
}

/// Places on each side of a marker's square, one corner among them.
const PLACES: usize = 8;

/// Image points on the edge of a marker's square, px: a corner, and from there all round.
pub type Outline = [[f64; 2]; 4 * PLACES];

/// A camera that looks at the pattern.
#[derive(Clone, Debug)]
pub struct FreeCamera {
    scene: Scene,
    /// The object in the camera frame.
    pub pose: RigidPose,
}

impl FreeCamera {
    /// A camera that sees the object at `start`.
    pub fn new(scene: &Scene, start: &Pose) -> Self {
        Self {
            scene: scene.clone(),
            pose: from_scene(start),
        }
    }

    /// The true features, px.
    ///
    /// # Errors
    /// [`Hidden`] where a point is behind the camera.
    pub fn features(&self) -> Result<Points, Hidden> {
        project(&self.scene, &self.pose)
    }

    /// Moves the camera with a constant twist (vx vy vz m/s, wx wy wz rad/s; camera frame) for `dt`
    /// seconds.
    pub fn advance(&mut self, twist: &[f64; 6], dt: f64) {
        self.pose = seen_after(&self.pose, twist, dt);
    }
}

/// The pattern of a scene as its camera sees the object at a pose, px.
///
/// # Errors
/// [`Hidden`] where a point is behind the camera.
pub fn project(scene: &Scene, object: &RigidPose) -> Result<Points, Hidden> {
    let points = scene.pattern.iter().enumerate();
    let pixel = |(point, p): (usize, _)| pixel(scene, object, p).ok_or(Hidden { point });
    points.map(pixel).collect()
}

/// The edge of the marker round each point of the pattern, as its camera sees the object at a pose;
/// `None` where a place is behind the camera. Nothing where markers are points.
pub fn outlines(scene: &Scene, object: &RigidPose) -> impl Iterator<Item = Option<Outline>> {
    let has_size = scene.marker_size > 0.0;
    let points = scene.pattern.iter().filter(move |_| has_size);
    points.map(|&[x, y, z]| {
        let mut outline = Outline::default();
        for (k, place) in outline.iter_mut().enumerate() {
            // Along the side y = -1 of the square from -1 to 1, then turned onto side after side.
            let along = 2.0 * (k % PLACES) as f64 / PLACES as f64 - 1.0;
            let [a, b] = match k / PLACES {
                0 => [along, -1.0],
                1 => [1.0, along],
                2 => [-along, 1.0],
                _ => [-1.0, -along],
            };
            let half = 0.5 * scene.marker_size;
            *place = pixel(scene, object, &[x + half * a, y + half * b, z])?;
        }
        Some(outline)
    })
}

/// Where a point of the object is in the image, px; `None` behind the camera.
fn pixel(scene: &Scene, object: &RigidPose, point: &[f64; 3]) -> Option<[f64; 2]> {
    let (camera, x) = (&scene.camera, object * Point3::from(*point));
    let pixel = || {
        [
            camera.fx * x.x / x.z + camera.cx,
            camera.fy * x.y / x.z + camera.cy,
        ]
    };
    (x.z >= 1e-6).then(pixel)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_goal_is_where_the_scene_says() {
        let scene = Scene::parse(scene::PAPER_SIM, "sim").unwrap();
        let seen = FreeCamera::new(&scene, &scene.goal).features().unwrap();
        let expected = [
            [312.0, 312.0],
            [712.0, 312.0],
            [712.0, 712.0],
            [312.0, 712.0],
        ];
        for (a, b) in seen.iter().flatten().zip(expected.iter().flatten()) {
            assert!((a - b).abs() < 1e-9);
        }
    }

    #[test]
    fn a_camera_that_moves_right_sees_the_object_move_left() {
        let scene = Scene::parse(scene::PAPER_SIM, "sim").unwrap();
        let mut camera = FreeCamera::new(&scene, &scene.goal);
        camera.advance(&[0.3, 0.0, 0.0, 0.0, 0.0, 0.0], 0.1);
        let expected = 312.0 - 800.0 * 0.03 / 0.6;
        assert!((camera.features().unwrap()[0][0] - expected).abs() < 1e-9);
    }

    #[test]
    fn the_outline_of_a_marker_is_its_square_all_round() {
        let scene = Scene::parse(scene::TAGS_ROBOT, "tags").unwrap();
        let goal = from_scene(&scene.goal);
        let (points, half) = (project(&scene, &goal).unwrap(), 0.5 * 0.03 * 615.0 / 0.35);
        let outlines: Vec<Outline> = outlines(&scene, &goal).map(Option::unwrap).collect();
        assert_eq!(outlines.len(), points.len());
        for (outline, [u, v]) in outlines.iter().zip(points) {
            let square = outline.map(|[a, b]| [(a - u) / half, (b - v) / half]);
            for (corner, expected) in [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]]
                .iter()
                .enumerate()
            {
                let found = square[corner * PLACES];
                assert!((0..2).all(|k| (found[k] - expected[k]).abs() < 1e-9));
            }
            let next = square.iter().cycle().skip(1);
            for (a, b) in square.iter().zip(next) {
                assert!((a[0].abs().max(a[1].abs()) - 1.0).abs() < 1e-9);
                let apart = (a[0] - b[0]).hypot(a[1] - b[1]);
                assert!((apart - 2.0 / PLACES as f64).abs() < 1e-9);
            }
        }
        let points = Scene::parse(scene::PAPER_ROBOT, "robot").unwrap();
        assert_eq!(super::outlines(&points, &goal).count(), 0);
    }

    #[test]
    fn a_point_behind_the_camera_is_named() {
        let scene = Scene::parse(scene::PAPER_SIM, "sim").unwrap();
        let mut camera = FreeCamera::new(&scene, &scene.goal);
        camera.advance(&[0.0, 0.0, 1.0, 0.0, 0.0, 0.0], 1.0);
        assert_eq!(camera.features(), Err(Hidden { point: 0 }));
    }
}
