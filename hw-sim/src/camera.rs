//! The paper's free-flying camera: it moves exactly as told and projects the pattern.

use scene::{Camera, MAX_POINTS, Pose, Scene};

use crate::pose::RigidPose;

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
    camera: Camera,
    pattern: heapless::Vec<[f64; 3], MAX_POINTS>,
    pose: RigidPose,
}

impl FreeCamera {
    /// A camera that sees the object at `start`.
    pub fn new(scene: &Scene, start: &Pose) -> Self {
        Self {
            camera: scene.camera,
            pattern: scene.pattern.clone(),
            pose: RigidPose::new(start),
        }
    }

    /// The pose of the object in the camera frame.
    pub fn pose(&self) -> &RigidPose {
        &self.pose
    }

    /// The true features, px.
    ///
    /// # Errors
    /// [`Hidden`] where a point is behind the camera.
    pub fn features(&self) -> Result<Points, Hidden> {
        projected(&self.camera, &self.pattern, &self.pose)
    }

    /// Moves the camera with a constant twist (vx vy vz m/s, wx wy wz rad/s; camera frame) for `dt` seconds.
    pub fn advance(&mut self, twist: &[f64; 6], dt: f64) {
        self.pose = self.pose.seen_after(twist, dt);
    }
}

/// The pattern of a scene as its camera sees the object at a pose, px.
///
/// # Errors
/// [`Hidden`] where a point is behind the camera.
pub fn project(scene: &Scene, object: &RigidPose) -> Result<Points, Hidden> {
    projected(&scene.camera, &scene.pattern, object)
}

fn projected(camera: &Camera, pattern: &[[f64; 3]], pose: &RigidPose) -> Result<Points, Hidden> {
    let mut points = Points::new();
    for (point, p) in pattern.iter().enumerate() {
        let x = pose.transform(p);
        if x.z < 1e-6 {
            return Err(Hidden { point });
        }
        let pixel = [
            camera.fx * x.x / x.z + camera.cx,
            camera.fy * x.y / x.z + camera.cy,
        ];
        points.push(pixel).map_err(|_| Hidden { point })?;
    }
    Ok(points)
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
