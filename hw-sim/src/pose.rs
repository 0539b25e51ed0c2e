//! The pose of the object in the camera frame, and its motion while the camera moves.

use nalgebra::{Rotation3, UnitQuaternion, Vector3};
use scene::Pose;

/// A rigid pose: X_camera = R X_object + t.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RigidPose {
    /// R.
    pub rotation: Rotation3<f64>,
    /// t, m.
    pub translation: Vector3<f64>,
}

impl RigidPose {
    /// The pose of a scene or a start file.
    pub fn new(pose: &Pose) -> Self {
        Self {
            rotation: Rotation3::new(Vector3::from(pose.rotation)),
            translation: Vector3::from(pose.translation),
        }
    }

    /// A point of the object frame in the camera frame, m.
    pub fn transform(&self, point: &[f64; 3]) -> Vector3<f64> {
        self.rotation * Vector3::from(*point) + self.translation
    }

    /// Rotation vector, rad.
    pub fn rotation_vector(&self) -> [f64; 3] {
        // That of the matrix itself comes from the cosine alone: near zero it is wrong by 1e-8, or NaN.
        UnitQuaternion::from_rotation_matrix(&self.rotation)
            .scaled_axis()
            .into()
    }

    /// The pose after the camera has moved with the constant twist (m/s, rad/s; camera frame) for `dt` seconds.
    ///
    /// In its own moving frame the camera travels along a screw: after `dt` its new frame is turned by
    /// C = exp(w dt) and displaced by d = (integral of exp(w s) ds) v, both in the old frame. Points therefore
    /// change to C^T (X - d).
    pub fn seen_after(&self, twist: &[f64; 6], dt: f64) -> Self {
        let v = Vector3::new(twist[0], twist[1], twist[2]);
        let w = Vector3::new(twist[3], twist[4], twist[5]);
        let turn = Rotation3::new(w * dt);
        let speed = w.norm();
        let displacement = if speed * dt.abs() < 1e-9 {
            v * dt + w.cross(&v) * (0.5 * dt * dt)
        } else {
            // Along the axis at the axial speed; across it on a circle about the axis.
            let axis = w / speed;
            let along = axis * axis.dot(&v);
            let across = v - along;
            let angle = speed * dt;
            let half = 2.0 * (0.5 * angle).sin().powi(2);
            along * dt + (across * angle.sin() + axis.cross(&across) * half) / speed
        };
        let back = turn.inverse();
        Self {
            rotation: back * self.rotation,
            translation: back * (self.translation - displacement),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn start() -> RigidPose {
        RigidPose::new(&Pose {
            translation: [0.1, -0.2, 0.9],
            rotation: [0.3, -0.4, 1.2],
        })
    }

    #[test]
    fn a_step_agrees_with_fine_integration_of_the_point_velocity() {
        let twist = [0.4, -0.3, 0.2, 0.8, -0.5, 0.9];
        let (v, w) = (Vector3::new(0.4, -0.3, 0.2), Vector3::new(0.8, -0.5, 0.9));
        let rate = |x: Vector3<f64>| -v - w.cross(&x);
        let point = [0.15, -0.15, 0.0];
        let mut x = start().transform(&point);
        let h = 0.5 / 5000.0;
        for _ in 0..5000 {
            let k1 = rate(x);
            let k2 = rate(x + k1 * (0.5 * h));
            let k3 = rate(x + k2 * (0.5 * h));
            let k4 = rate(x + k3 * h);
            x += (k1 + (k2 + k3) * 2.0 + k4) * (h / 6.0);
        }
        let exact = start().seen_after(&twist, 0.5).transform(&point);
        assert!((exact - x).norm() < 1e-12);
    }

    #[test]
    fn there_and_back_is_nowhere() {
        let twist = [0.4, -0.3, 0.2, 0.8, -0.5, 0.9];
        let back = start()
            .seen_after(&twist, 0.7)
            .seen_after(&twist.map(|x| -x), 0.7);
        assert!((back.translation - start().translation).norm() < 1e-12);
        assert!(back.rotation.angle_to(&start().rotation) < 1e-7);
    }

    #[test]
    fn slow_turns_meet_the_limit_of_no_turn() {
        let slow = start().seen_after(&[0.4, -0.3, 0.2, 1e-8, 0.0, 0.0], 0.5);
        let none = start().seen_after(&[0.4, -0.3, 0.2, 0.0, 0.0, 0.0], 0.5);
        assert!((slow.translation - none.translation).norm() < 1e-7);
    }
}
