//! A robot of any arm file: kinematic, with the file's joints, their limits, and a Panda's lag.

use nalgebra::{Matrix3, Rotation3, RowVector3, Translation3, Vector3};
use panda::kinematics::{Frame, Frames};
use panda::{Chain, Described, JOINTS, Joints, Limits, Model, Pose, RobotSettings};

use super::arm::{ArmSettings, base_from_object};
use super::calibration::HandEye;
use crate::pose::from_scene;

/// Settings of a robot that an arm file describes; its flange is where the file has the camera. The
/// pattern lies where the camera sees it at `goal` with the joints at the file's `goal`, if it tells
/// them.
///
/// The description lives as long as the process: call this once.
pub fn settings(arm: &scene::Arm, goal: &scene::Pose) -> ArmSettings {
    let rows = arm.rotation.map(RowVector3::from);
    let rotation = Rotation3::from_matrix_unchecked(Matrix3::from_rows(&rows));
    let camera = Pose::from_parts(Translation3::from(arm.translation), rotation);
    let none = Frame {
        rotation: Matrix3::identity(),
        origin: Vector3::zeros(),
        slides: false,
    };
    let (mut joints, mut last) = ([none; JOINTS], Pose::identity());
    for (to, joint) in joints.iter_mut().zip(&arm.joints) {
        let axis = Vector3::from(joint.axis);
        // Its x and y axes may point anywhere across.
        let across = match axis.x.abs() < 0.9 {
            true => Vector3::x(),
            false => Vector3::y(),
        };
        let turn = Rotation3::face_towards(&axis, &across);
        let at = Pose::from_parts(Translation3::from(joint.point), turn);
        let step = last.inverse() * at;
        *to = Frame {
            rotation: step.rotation.into_inner(),
            origin: step.translation.vector,
            slides: joint.slides,
        };
        last = at;
    }
    let limits = arm.joints.iter();
    let limits = limits.map(|joint| (joint.range, joint.velocity, joint.acceleration));
    let described = Described {
        frames: Frames {
            joints,
            count: arm.joints.len(),
            flange: last.inverse() * camera,
        },
        limits: Limits::of_joints(limits),
    };
    let end_effector = camera.inverse() * nalgebra::Point3::from(arm.end_effector);
    let described: &'static Described = Box::leak(Box::new(described));
    let base_from_object = match arm.goal.is_empty() {
        true => base_from_object(),
        false => {
            let mut q = Joints::zeros();
            q.iter_mut()
                .zip(&arm.goal)
                .for_each(|(to, from)| *to = *from);
            let camera = Chain::of(&described.frames, Pose::identity()).pose(&q);
            camera * from_scene(goal)
        }
    };
    ArmSettings {
        base_from_object,
        hand_eye: HandEye::NONE,
        robot: RobotSettings {
            model: Model::Other(described),
            flange_from_ne: Translation3::from(end_effector.coords).into(),
            ..RobotSettings::default()
        },
        ..ArmSettings::default()
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use panda::{Command, Flag, Mode, Motion, MotionKind, Robot};
    use scene::Scene;

    use super::*;
    use crate::cell::Cell;
    use crate::rig::{Rig, RigSettings};

    fn scene() -> Scene {
        Scene::parse(scene::PAPER_ROBOT, "robot").unwrap()
    }

    fn ur5e() -> ArmSettings {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
        let arm = scene::Arm::read(&root.join("tests/arms/ur5e.toml")).unwrap();
        settings(&arm, &scene().goal)
    }

    /// The errors of a UR5e whose joint 3, at this position, is commanded to gain so much speed in
    /// each millisecond, rad/s, up to a speed.
    fn errors(from: f64, gain: f64, speed: f64) -> Robot {
        let mut q = Joints::zeros();
        q[2] = from;
        let mut robot = Robot::new(ur5e().robot, q).unwrap();
        robot.start(MotionKind::Joint).unwrap();
        for tick in 1..=2000 {
            let mut dq = Joints::zeros();
            dq[2] = (gain * f64::from(tick)).min(speed);
            let (id, motion) = (robot.state().id, Motion::Joint(dq));
            robot.step(&[Command {
                id,
                motion,
                elbow: None,
                finished: false,
            }]);
        }
        robot
    }

    #[test]
    fn each_limit_of_a_joint_trips_the_robot_and_within_them_it_moves() {
        // A UR5e: ends at half a turn, 3.14 rad/s, 3.14 rad/s^2.
        let fine = errors(-3.0, 3e-3, 2.0);
        assert_eq!(fine.state().robot_mode, Mode::Move);
        assert!(fine.state().q[2] > 0.3, "{}", fine.state().q);
        // It lags a little behind.
        let lag = fine.state().q_d[2] - fine.state().q[2];
        assert!((0.002..0.02).contains(&lag), "{lag}");
        for (from, gain, speed, flag) in [
            (
                0.0,
                4e-3,
                1.0,
                Flag::JointMotionGeneratorAccelerationDiscontinuity,
            ),
            (
                -3.0,
                3e-3,
                4.0,
                Flag::JointMotionGeneratorVelocityLimitsViolation,
            ),
            (
                2.0,
                3e-3,
                1.0,
                Flag::JointMotionGeneratorPositionLimitsViolation,
            ),
        ] {
            let robot = errors(from, gain, speed);
            assert_eq!(robot.state().robot_mode, Mode::Reflex, "{flag:?}");
            assert!(robot.state().current_errors.contains(flag), "{flag:?}");
            // It stood still before the end of the range.
            assert!(robot.state().q[2] < std::f64::consts::PI);
        }
    }

    #[test]
    fn it_carries_the_camera_to_a_start_and_tells_of_six_joints() {
        let scene = scene();
        let mut settings = RigSettings::new(&scene);
        settings.arm = ur5e();
        let rig = Rig::new(&scene, &scene.goal, &settings).unwrap();
        let state = rig.state();
        assert_eq!(state.joints, 6);
        assert!(state.q[..6].iter().all(|q| *q != 0.0) && state.q[6] == 0.0);
        let seen = Vector3::from(state.translation);
        assert!((seen - Vector3::from(scene.goal.translation)).norm() < 1e-9);
    }
}
