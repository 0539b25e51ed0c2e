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
    let camera = &scene.camera;
    let pixel = |(point, p): (usize, &[f64; 3])| {
        let x = object * Point3::from(*p);
        let in_front = x.z >= 1e-6;
        in_front
            .then(|| {
                [
                    camera.fx * x.x / x.z + camera.cx,
                    camera.fy * x.y / x.z + camera.cy,
                ]
            })
            .ok_or(Hidden { point })
    };
    scene.pattern.iter().enumerate().map(pixel).collect()
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
    fn a_point_behind_the_camera_is_named() {
        let scene = Scene::parse(scene::PAPER_SIM, "sim").unwrap();
        let mut camera = FreeCamera::new(&scene, &scene.goal);
        camera.advance(&[0.0, 0.0, 1.0, 0.0, 0.0, 0.0], 1.0);
        assert_eq!(camera.features(), Err(Hidden { point: 0 }));
    }
}
