//! From the camera's velocity to the robot's command: the hand-eye calibration and its lever arm.
//!
//! A Cartesian velocity interface such as the Panda's takes the velocity of the end effector's origin along base axes.
//! The law speaks of the camera's origin along camera axes. With the camera at (R_fc, t_fc) in the flange and the flange
//! at R_bf in the base:
//!
//! omega_b = R_bf R_fc omega_c, v_b = R_bf R_fc v_c - omega_b x (R_bf t_fc).
//!
//! The end effector is the flange here. Where the robot is told of another, give its frame in place of the flange's.

use nalgebra::{Matrix3, Vector3};

use crate::Twist;

/// How far R^T R may be from the identity (any entry): what a calibration written with seven digits keeps.
const ORTHOGONAL: f64 = 1e-6;

/// The camera in the flange frame: x_flange = R x_camera + t.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HandEye {
    rotation: Matrix3<f64>,
    translation: Vector3<f64>,
}

impl HandEye {
    /// The camera is the flange.
    pub const IDENTITY: Self = Self {
        rotation: Matrix3::new(1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0),
        translation: Vector3::new(0.0, 0.0, 0.0),
    };

    /// A calibration from its rotation matrix and translation (m). `None` unless the matrix is a rotation to 1e-6 and
    /// everything is finite.
    pub fn new(rotation: Matrix3<f64>, translation: Vector3<f64>) -> Option<Self> {
        // NaN compares as not orthogonal.
        let orthogonal = (rotation.transpose() * rotation - Matrix3::identity())
            .iter()
            .all(|x| x.abs() < ORTHOGONAL);
        let finite = translation.iter().all(|x| x.is_finite());
        (orthogonal && rotation.determinant() > 0.0 && finite).then_some(Self {
            rotation,
            translation,
        })
    }

    /// Rotation from the camera frame to the flange frame.
    pub fn rotation(&self) -> &Matrix3<f64> {
        &self.rotation
    }

    /// Origin of the camera in the flange frame, m.
    pub fn translation(&self) -> &Vector3<f64> {
        &self.translation
    }

    /// The velocity of the end effector's origin along base axes (m/s, rad/s) that moves the camera at `camera_twist`
    /// (camera frame). `base_from_flange` is the rotation from the flange frame to the base frame.
    pub fn to_base(&self, base_from_flange: &Matrix3<f64>, camera_twist: &Twist) -> Twist {
        let base_from_camera = base_from_flange * self.rotation;
        let [vx, vy, vz, wx, wy, wz] = *camera_twist;
        let angular = base_from_camera * Vector3::new(wx, wy, wz);
        let lever = base_from_flange * self.translation;
        let linear = base_from_camera * Vector3::new(vx, vy, vz) - angular.cross(&lever);
        [
            linear.x, linear.y, linear.z, angular.x, angular.y, angular.z,
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::{Motion, rotation};

    fn calibration() -> HandEye {
        let turn = rotation([0.2, -0.4, 1.1]);
        HandEye::new(turn, Vector3::new(0.08, -0.05, 0.06)).unwrap()
    }

    #[test]
    fn a_twist_at_the_flange_is_the_derivative_of_its_pose_when_the_camera_moves() {
        let hand_eye = calibration();
        let base_from_flange = rotation([-0.7, 2.1, 0.4]);
        let position = Vector3::new(0.4, -0.1, 0.5);
        let twist = [0.3, -0.2, 0.5, 0.7, -0.9, 0.4];
        // The flange (rotation, origin in the base) after the camera moved for a time t.
        let flange = |t: f64| {
            // What a fixed point does in the camera's frame; the camera itself moves the other way.
            let seen = Motion::of_camera(&twist, t);
            let turn = seen.rotation.transpose();
            let shift = -(turn * seen.translation);
            let base_from_camera = base_from_flange * hand_eye.rotation * turn;
            let camera =
                position + base_from_flange * (hand_eye.translation + hand_eye.rotation * shift);
            let flange = base_from_camera * hand_eye.rotation.transpose();
            (flange, camera - flange * hand_eye.translation)
        };
        let h = 1e-6;
        let ((before, from), (after, to)) = (flange(-h), flange(h));
        let linear = (to - from) / (2.0 * h);
        let spin = (after - before) * base_from_flange.transpose() / (2.0 * h);
        let numeric = [
            linear.x,
            linear.y,
            linear.z,
            spin[(2, 1)],
            spin[(0, 2)],
            spin[(1, 0)],
        ];
        let exact = hand_eye.to_base(&base_from_flange, &twist);
        for k in 0..6 {
            assert!((numeric[k] - exact[k]).abs() < 1e-8, "component {k}");
        }
    }

    #[test]
    fn a_turn_about_a_mounted_camera_carries_the_flange_round_it() {
        // The camera sits 0.1 m along the flange's x axis and turns about its own z axis at 1 rad/s: the flange's
        // origin, at x = -0.1 seen from the camera, moves along -y.
        let hand_eye = HandEye::new(Matrix3::identity(), Vector3::new(0.1, 0.0, 0.0)).unwrap();
        let twist = hand_eye.to_base(&Matrix3::identity(), &[0.0, 0.0, 0.0, 0.0, 0.0, 1.0]);
        assert_eq!(twist, [0.0, -0.1, 0.0, 0.0, 0.0, 1.0]);
    }

    #[test]
    fn what_is_not_a_rotation_is_refused() {
        let zero = Vector3::zeros();
        assert!(HandEye::new(Matrix3::identity() * 1.001, zero).is_none());
        assert!(HandEye::new(-Matrix3::identity(), zero).is_none());
        assert!(HandEye::new(Matrix3::identity() * f64::NAN, zero).is_none());
        assert!(HandEye::new(Matrix3::identity(), Vector3::new(f64::NAN, 0.0, 0.0)).is_none());
        assert!(HandEye::new(Matrix3::identity(), zero) == Some(HandEye::IDENTITY));
    }
}
