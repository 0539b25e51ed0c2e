//! What trips the robot: every flag, by the way that leads to it.

use nalgebra::Vector3;
use panda::limits::{Model, PERIOD};
use panda::{
    Command, Errors, Flag, Joints, Mode, Motion, MotionKind, READY, Robot, RobotSettings, Twist,
    Walls,
};

use crate::rig::{answer, at, moving, ready, ready_but, speed_up};

fn one(flag: Flag) -> Errors {
    flag.into()
}

fn joint_motion(mut robot: Robot, velocity: impl Fn(u64) -> Joints) -> Errors {
    robot.start(MotionKind::Joint).expect("idle");
    for tick in 1..5000 {
        let command = Command {
            id: robot.state().id,
            motion: Motion::Joint(velocity(tick)),
            elbow: None,
            finished: false,
        };
        if robot.step(&[command]).robot_mode == Mode::Reflex {
            break;
        }
    }
    robot.state().current_errors
}

/// Joint 2 (number from 1) of a smooth start at 2 rad/s^2.
fn gently(joint: usize, tick: u64) -> Joints {
    let mut dq = Joints::zeros();
    dq[joint - 1] = 2.0 * tick as f64 * PERIOD;
    dq
}

fn pushed(mut robot: Robot, joint: usize, acceleration: f64) -> Errors {
    let mut push = Joints::zeros();
    push[joint - 1] = acceleration;
    robot.push(push);
    for _ in 0..1000 {
        robot.step(&[]);
    }
    assert_eq!(robot.state().robot_mode, Mode::Reflex);
    robot.state().current_errors
}

fn step_of(axis: usize, speed: f64) -> Errors {
    let mut robot = moving(ready());
    let mut twist = Twist::zeros();
    twist[axis] = speed;
    answer(&mut robot, twist);
    let state = robot.state();
    assert_eq!(
        state.robot_mode == Mode::Reflex,
        !state.current_errors.is_empty()
    );
    assert_eq!(state.current_errors, state.last_motion_errors);
    state.current_errors
}

fn walled() -> Errors {
    let middle = Vector3::new(0.3069, 0.0, 0.5903);
    let settings = RobotSettings {
        walls: Some(Walls {
            lower: middle - Vector3::repeat(0.02),
            upper: middle + Vector3::repeat(0.02),
        }),
        ..RobotSettings::default()
    };
    let mut robot = moving(Robot::new(settings, Joints::from(READY)).expect("in range"));
    speed_up(&mut robot, 1, 0.5, 0.1);
    for _ in 0..1000 {
        let twist = robot.state().o_dp_ee_c;
        answer(&mut robot, twist);
    }
    let y = robot.state().o_t_ee.translation.y;
    assert!((0.02..0.03).contains(&y), "{y}");
    robot.state().current_errors
}

/// Turns the flange about its axis until joint 7 is at the end of its range.
fn into_the_end_of_a_joint() -> Errors {
    let mut robot = moving(ready_but(7, 2.0));
    speed_up(&mut robot, 5, -1.0, 0.3);
    for _ in 0..8000 {
        let twist = robot.state().o_dp_ee_c;
        answer(&mut robot, twist);
    }
    let state = robot.state();
    let most = Model::Panda.limits().joints[6].upper;
    assert!(
        state.q_d[6] > most - 0.1 && state.q_d[6] <= most,
        "{}",
        state.q_d[6]
    );
    assert!(state.q[6] <= most);
    state.current_errors
}

/// Forward at a third of the speed that the end effector may have; joints 2 and 4 may not.
fn too_fast_for_the_joints() -> Errors {
    let mut robot = moving(ready());
    speed_up(&mut robot, 0, 1.0, 1.6);
    robot.state().current_errors
}

fn lost() -> Errors {
    let mut robot = moving(ready());
    for _ in 0..20 {
        robot.step(&[]);
    }
    robot.state().current_errors
}

#[test]
fn measured_joints_out_of_range_trip() {
    let errors = pushed(ready_but(4, -0.0708), 4, 50.0);
    assert_eq!(errors, one(Flag::JointPositionLimitsViolation));
}

#[test]
fn measured_joints_that_are_too_fast_trip() {
    assert!(pushed(ready(), 7, 900.0).contains(Flag::JointVelocityViolation));
}

#[test]
fn an_end_effector_that_is_measured_too_fast_trips() {
    let errors = pushed(at([0.0, 1.2, 0.0, -0.3, 0.0, 1.5, 0.0]), 1, 550.0);
    assert!(
        errors.contains(Flag::CartesianVelocityViolation),
        "{errors}"
    );
}

#[test]
fn a_virtual_wall_trips() {
    assert_eq!(walled(), one(Flag::CartesianPositionLimitsViolation));
}

#[test]
fn joint_commands_trip_by_each_of_their_limits() {
    let position = joint_motion(ready_but(2, 1.5), |tick| gently(2, tick.min(200)));
    assert_eq!(
        position,
        one(Flag::JointMotionGeneratorPositionLimitsViolation)
    );
    let velocity = joint_motion(ready_but(1, -2.5), |tick| gently(1, tick));
    assert_eq!(
        velocity,
        one(Flag::JointMotionGeneratorVelocityLimitsViolation)
    );
    // 3 rad/s^3 a period, without end.
    let acceleration = joint_motion(ready(), |tick| {
        Joints::x() * (0.0015 * (tick * tick) as f64)
    });
    assert_eq!(
        acceleration,
        one(Flag::JointMotionGeneratorAccelerationDiscontinuity)
    );
    let jerk = joint_motion(ready(), |_| Joints::x() * 0.01);
    assert_eq!(
        jerk,
        one(Flag::JointMotionGeneratorAccelerationDiscontinuity)
    );
}

#[test]
fn a_step_of_the_command_trips_by_all_that_it_breaks() {
    use Flag::*;
    let joints = one(CartesianMotionGeneratorJointAccelerationDiscontinuity);
    assert_eq!(step_of(0, 0.0005), Errors::NONE);
    assert_eq!(step_of(0, 0.002), joints);
    // 5 m/s^2 and 5000 m/s^3 are allowed to the end effector, not to the joints that make it.
    assert_eq!(step_of(0, 0.005), joints);
    let both = joints.union(CartesianMotionGeneratorAccelerationDiscontinuity.into());
    assert_eq!(step_of(0, 0.01), both);
    let all = both
        .union(CartesianMotionGeneratorVelocityLimitsViolation.into())
        .union(CartesianMotionGeneratorJointVelocityLimitsViolation.into())
        .union(CartesianMotionGeneratorJointPositionLimitsViolation.into());
    assert_eq!(step_of(0, 3.0), all);
}

#[test]
fn a_command_into_the_end_of_a_joint_trips_in_front_of_it() {
    let errors = into_the_end_of_a_joint();
    assert_eq!(
        errors,
        one(Flag::CartesianMotionGeneratorJointPositionLimitsViolation)
    );
}

#[test]
fn a_command_within_bounds_trips_by_joint_speed() {
    let errors = too_fast_for_the_joints();
    assert_eq!(
        errors,
        one(Flag::CartesianMotionGeneratorJointVelocityLimitsViolation)
    );
}

#[test]
fn a_motion_near_a_joint_end_does_not_trip_by_its_elbow() {
    let mut robot = moving(ready_but(7, 2.85));
    for _ in 0..2000 {
        let state = answer(&mut robot, Twist::zeros());
        assert_eq!(state.robot_mode, Mode::Move, "{}", state.current_errors);
    }
    assert!(robot.state().q_d[6] < 2.83, "{}", robot.state().q_d);
}

#[test]
fn every_flag_can_be_reached() {
    let gentle = |joint: usize, from: f64| {
        joint_motion(ready_but(joint, from), move |tick| gently(joint, tick))
    };
    let all = [
        pushed(ready_but(4, -0.0708), 4, 50.0),
        pushed(ready(), 7, 900.0),
        pushed(at([0.0, 1.2, 0.0, -0.3, 0.0, 1.5, 0.0]), 1, 550.0),
        walled(),
        gentle(2, 1.5),
        gentle(1, -2.5),
        joint_motion(ready(), |_| Joints::x() * 0.1),
        step_of(0, 3.0),
        lost(),
    ];
    let reached = all.iter().fold(Errors::NONE, |a, &b| a.union(b));
    for &flag in Flag::ALL {
        assert!(reached.contains(flag), "{}", flag.name());
    }
}
