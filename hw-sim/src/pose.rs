//! The pose of the object in the camera frame, and its motion while the camera moves.

use nalgebra::{Rotation3, Translation3, Vector3};
use scene::Pose;

/// A rigid pose: X_camera = R X_object + t, m.
pub type RigidPose = panda::Pose;

/// The pose of a scene or a start file.
pub fn from_scene(pose: &Pose) -> RigidPose {
    RigidPose::from_parts(
        Translation3::from(pose.translation),
        Rotation3::new(Vector3::from(pose.rotation)),
    )
}

/// As a scene or a start file has it: translation (m) and rotation vector (rad).
pub fn to_scene(pose: &RigidPose) -> Pose {
    Pose {
        translation: pose.translation.vector.into(),
        rotation: panda::kinematics::rotation_vector(&pose.rotation).into(),
    }
}

/// The pose after the camera has moved with a constant twist (m/s, rad/s; camera frame) for `dt`
/// seconds.
///
/// In its own moving frame the camera travels along a screw: after `dt` its new frame is turned by
/// C = exp(w dt) and displaced by d = (integral of exp(w s) ds) v, both in the old frame. Points
/// therefore change to C^T (X - d).
pub fn seen_after(pose: &RigidPose, twist: &[f64; 6], dt: f64) -> RigidPose {
    let [vx, vy, vz, wx, wy, wz] = *twist;
    let (v, w) = (Vector3::new(vx, vy, vz), Vector3::new(wx, wy, wz));
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
    let moved = RigidPose::from_parts(Translation3::from(displacement), Rotation3::new(w * dt));
    moved.inverse() * pose
}

#[cfg(test)]
mod tests {
    use nalgebra::Point3;

    use super::*;

    fn start() -> RigidPose {
        from_scene(&Pose {
            translation: [0.1, -0.2, 0.9],
            rotation: [0.3, -0.4, 1.2],
        })
    }

    #[test]
    fn a_step_agrees_with_fine_integration_of_the_point_velocity() {
        let twist = [0.4, -0.3, 0.2, 0.8, -0.5, 0.9];
        let (v, w) = (Vector3::new(0.4, -0.3, 0.2), Vector3::new(0.8, -0.5, 0.9));
        let rate = |x: Vector3<f64>| -v - w.cross(&x);
        let point = Point3::new(0.15, -0.15, 0.0);
        let mut x = (start() * point).coords;
        let h = 0.5 / 5000.0;
        for _ in 0..5000 {
            let k1 = rate(x);
            let k2 = rate(x + k1 * (0.5 * h));
            let k3 = rate(x + k2 * (0.5 * h));
            let k4 = rate(x + k3 * h);
            x += (k1 + (k2 + k3) * 2.0 + k4) * (h / 6.0);
        }
        let exact = seen_after(&start(), &twist, 0.5) * point;
        assert!((exact.coords - x).norm() < 1e-12);
    }

    #[test]
    fn there_and_back_is_nowhere() {
        let twist = [0.4, -0.3, 0.2, 0.8, -0.5, 0.9];
        let there = seen_after(&start(), &twist, 0.7);
        let back = seen_after(&there, &twist.map(|x| -x), 0.7);
        assert!((back.translation.vector - start().translation.vector).norm() < 1e-12);
        assert!(back.rotation.angle_to(&start().rotation) < 1e-7);
    }

    #[test]
    fn slow_turns_meet_the_limit_of_no_turn() {
        let slow = seen_after(&start(), &[0.4, -0.3, 0.2, 1e-8, 0.0, 0.0], 0.5);
        let none = seen_after(&start(), &[0.4, -0.3, 0.2, 0.0, 0.0, 0.0], 0.5);
        assert!((slow.translation.vector - none.translation.vector).norm() < 1e-7);
    }
}
