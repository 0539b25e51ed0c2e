//! Late and lost commands.

use panda::{Command, Errors, Flag, Mode, Motion, MotionKind, Twist};

use crate::rig::{answer, moving, ready, speed_up, watch_stop};

#[test]
fn a_lost_command_is_extrapolated_at_constant_acceleration() {
    let mut robot = moving(ready());
    speed_up(&mut robot, 1, 1.0, 0.02);
    let before = *robot.state();
    let after = *robot.step(&[]);
    let expected = before.o_dp_ee_c + before.o_ddp_ee_c * 1e-3;
    assert!((after.o_dp_ee_c - expected).norm() < 1e-15);
    assert!(before.o_ddp_ee_c[1] > 0.9);
    assert!(after.control_command_success_rate < 1.0);
}

#[test]
fn a_late_command_is_not_executed() {
    let mut robot = moving(ready());
    speed_up(&mut robot, 1, 1.0, 0.02);
    let old = robot.state().id;
    answer(&mut robot, Twist::zeros() + Twist::y() * 0.021);
    let before = *robot.state();
    let late = Command {
        id: old,
        motion: Motion::Cartesian(Twist::zeros()),
        elbow: None,
        finished: false,
    };
    let after = *robot.step(&[late]);
    assert!(after.o_dp_ee_c[1] > before.o_dp_ee_c[1]);
    assert_eq!(after.robot_mode, Mode::Move);
}

#[test]
fn after_nineteen_lost_commands_the_motion_goes_on() {
    let mut robot = moving(ready());
    speed_up(&mut robot, 1, 1.0, 0.02);
    for _ in 0..19 {
        robot.step(&[]);
    }
    let state = *robot.state();
    assert_eq!(state.robot_mode, Mode::Move);
    // Where the robot extrapolated to is where a good client goes on.
    for _ in 0..50 {
        let twist = robot.state().o_dp_ee_c;
        answer(&mut robot, twist + Twist::y() * 1e-3);
    }
    assert_eq!(robot.state().robot_mode, Mode::Move);
    let executed = robot.state().control_command_success_rate;
    assert!((0.7..0.9).contains(&executed), "{executed}");
}

#[test]
fn after_twenty_lost_commands_the_robot_stops_by_itself() {
    let mut robot = moving(ready());
    speed_up(&mut robot, 1, 1.0, 0.02);
    for _ in 0..20 {
        assert_eq!(robot.state().robot_mode, Mode::Move);
        robot.step(&[]);
    }
    let state = *robot.state();
    let lost = Errors::from(Flag::CommunicationConstraintsViolation);
    assert_eq!(state.robot_mode, Mode::Reflex);
    assert_eq!(
        (state.current_errors, state.last_motion_errors),
        (lost, lost)
    );
    assert_eq!(state.control_command_success_rate, 0.0);
    assert!(watch_stop(&mut robot) > 0);
}

#[test]
fn a_motion_that_waits_goes_on_where_it_was() {
    let mut robots = [moving(ready()), moving(ready())];
    let [waits, goes_on] = &mut robots;
    for robot in [&mut *waits, &mut *goes_on] {
        speed_up(robot, 1, 1.0, 0.02);
    }
    // Longer than until a robot stops by itself.
    for _ in 0..50 {
        waits.wait();
    }
    assert_eq!(waits.state().id, goes_on.state().id + 50);
    for _ in 0..50 {
        let twist = goes_on.state().o_dp_ee_c + Twist::y() * 1e-3;
        answer(waits, twist);
        answer(goes_on, twist);
    }
    assert_eq!(waits.state().robot_mode, Mode::Move);
    assert_eq!(waits.state().q, goes_on.state().q);
    assert_eq!(waits.state().o_dp_ee_c, goes_on.state().o_dp_ee_c);
}

#[test]
fn commands_without_a_motion_move_nothing() {
    let mut robot = ready();
    let before = robot.state().q;
    for _ in 0..50 {
        answer(&mut robot, Twist::x() * 0.01);
    }
    assert_eq!(robot.state().q, before);
    assert_eq!(robot.state().robot_mode, Mode::Idle);
    // A motion must be started, and of the kind that is commanded.
    robot.start(MotionKind::Joint).expect("idle");
    for _ in 0..20 {
        answer(&mut robot, Twist::zeros());
    }
    assert_eq!(robot.state().robot_mode, Mode::Reflex);
}
