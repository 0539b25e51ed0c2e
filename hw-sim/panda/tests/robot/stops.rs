//! Ends of motions: finished, stopped, tripped, recovered.

use arm::{Shaper, ShaperSettings};
use panda::limits::PERIOD;
use panda::{Command, Errors, Flag, Mode, Motion, MotionKind, RequestError, Robot, Twist};

use crate::rig::{answer, echo, moving, ready, ready_but, speed_up, watch_stop};

fn fast() -> Robot {
    let mut robot = moving(ready());
    speed_up(&mut robot, 1, 2.0, 0.3);
    assert_eq!(robot.state().robot_mode, Mode::Move);
    robot
}

fn finish(robot: &mut Robot) {
    let last = Command {
        id: robot.state().id,
        motion: Motion::Cartesian(robot.state().o_dp_ee_c),
        elbow: None,
        finished: true,
    };
    robot.step(&[last]);
}

#[test]
fn finishing_while_moving_is_a_reflex_that_brakes() {
    let mut robot = fast();
    finish(&mut robot);
    assert_eq!(robot.state().robot_mode, Mode::Reflex);
    let jump = Flag::CartesianMotionGeneratorAccelerationDiscontinuity;
    assert!(robot.state().last_motion_errors.contains(jump));
    assert!(robot.state().o_dp_ee_d.norm() > 0.2);
    let steps = watch_stop(&mut robot);
    assert!(steps > 10 && steps < 300, "{steps}");
}

#[test]
fn a_motion_that_is_finished_at_rest_ends_without_an_error() {
    let mut robot = fast();
    let shaper = Shaper::new(ShaperSettings::default()).expect("good settings");
    while robot.state().o_dp_ee_c != Twist::zeros() {
        let twist = shaper.step(&echo(robot.state()), 1);
        answer(&mut robot, twist);
    }
    finish(&mut robot);
    watch_stop(&mut robot);
    assert_eq!(robot.state().robot_mode, Mode::Idle);
    assert_eq!(robot.state().last_motion_errors, Errors::NONE);
}

/// libfranka's low-pass (`franka::lowpassFilter`), which is on by default at 100 Hz.
fn low_pass(twist: Twist, last: Twist, cutoff_hz: f64) -> Twist {
    let gain = PERIOD / (PERIOD + 1.0 / (std::f64::consts::TAU * cutoff_hz));
    twist * gain + last * (1.0 - gain)
}

#[test]
fn behind_the_vendors_low_pass_a_stop_takes_eight_times_as_long() {
    // From 0.1 m/s: milliseconds, and metres.
    let stop = |cutoff_hz: Option<f64>| {
        let mut robot = moving(ready());
        let mut shaper = Shaper::new(ShaperSettings::default()).expect("good settings");
        shaper.aim(&(Twist::y() * 0.1), 5_000);
        let step = |robot: &mut Robot, now_ns| {
            let echo = echo(robot.state());
            let twist = shaper.step(&echo, now_ns);
            let twist = cutoff_hz.map_or(twist, |hz| low_pass(twist, echo.twist, hz));
            answer(robot, twist);
        };
        for now_ns in 0..5_000 {
            step(&mut robot, now_ns);
        }
        let begin = robot.state().o_t_ee_d.translation.y;
        let (mut ms, mut stood) = (5_000, 0);
        while stood < 10 {
            step(&mut robot, ms);
            ms += 1;
            stood = if robot.state().o_dp_ee_c[1].abs() < 1e-4 {
                stood + 1
            } else {
                0
            };
        }
        (
            ms - 5_000 - 10,
            robot.state().o_t_ee_d.translation.y - begin,
        )
    };
    let (plain, filtered) = (stop(None), stop(Some(100.0)));
    println!("{plain:?} {filtered:?}");
    assert!(
        (190..220).contains(&plain.0) && plain.1 < 0.011,
        "{plain:?}"
    );
    assert!(
        filtered.0 > 7 * plain.0 && filtered.1 > 0.07,
        "{filtered:?}"
    );
}

#[test]
fn a_reflex_brakes_within_the_bounds() {
    let mut robot = fast();
    answer(&mut robot, Twist::zeros());
    assert_eq!(robot.state().robot_mode, Mode::Reflex);
    assert!(robot.state().o_dp_ee_d.norm() > 0.2);
    let steps = watch_stop(&mut robot);
    assert!(steps > 10 && steps < 300, "{steps}");
    assert_eq!(robot.state().robot_mode, Mode::Reflex);
}

#[test]
fn recovery_leads_from_reflex_to_idle() {
    let mut robot = fast();
    answer(&mut robot, Twist::zeros());
    let errors = robot.state().current_errors;
    assert!(!errors.is_empty());
    let mode = Mode::Reflex;
    assert_eq!(robot.recover(), Err(RequestError::Moving { mode }));
    watch_stop(&mut robot);
    let needed = Mode::Idle;
    assert_eq!(
        robot.start(MotionKind::Cartesian),
        Err(RequestError::Mode { mode, needed })
    );
    robot.recover().expect("in reflex, at rest");
    assert_eq!(robot.state().robot_mode, Mode::AutomaticErrorRecovery);
    assert_eq!(robot.state().current_errors, errors);
    for _ in 0..600 {
        robot.step(&[]);
    }
    assert_eq!(robot.state().robot_mode, Mode::Idle);
    assert_eq!(robot.state().current_errors, Errors::NONE);
    assert_eq!(robot.state().last_motion_errors, errors);
    robot.start(MotionKind::Cartesian).expect("idle");
    answer(&mut robot, Twist::zeros());
    assert_eq!(robot.state().robot_mode, Mode::Move);
}

#[test]
fn recovery_fails_as_long_as_the_cause_stands() {
    let mut robot = ready_but(4, -0.0708);
    let mut push = panda::Joints::zeros();
    push[3] = 50.0;
    robot.push(push);
    for _ in 0..300 {
        robot.step(&[]);
    }
    for expected in [Mode::Reflex, Mode::Idle] {
        robot.recover().expect("in reflex, at rest");
        for _ in 0..600 {
            robot.step(&[]);
        }
        assert_eq!(robot.state().robot_mode, expected);
        robot.push(panda::Joints::zeros());
    }
}

#[test]
fn the_users_stop_brakes_and_holds_until_it_is_released() {
    let mut robot = fast();
    robot.press_user_stop();
    assert_eq!(robot.state().robot_mode, Mode::UserStopped);
    let mode = Mode::UserStopped;
    assert_eq!(
        robot.release_user_stop(),
        Err(RequestError::Moving { mode })
    );
    watch_stop(&mut robot);
    answer(&mut robot, Twist::x() * 1e-4);
    assert_eq!(robot.state().dq_d.norm(), 0.0);
    robot.release_user_stop().expect("pressed, at rest");
    assert_eq!(robot.state().robot_mode, Mode::Idle);
}

#[test]
fn a_users_stop_in_reflex_does_not_wash_the_errors_away() {
    let mut robot = fast();
    answer(&mut robot, Twist::zeros());
    robot.press_user_stop();
    watch_stop(&mut robot);
    robot.release_user_stop().expect("pressed, at rest");
    assert_eq!(robot.state().robot_mode, Mode::Reflex);
    assert!(!robot.state().current_errors.is_empty());
}

#[test]
fn a_stop_from_outside_ends_the_motion_without_an_error() {
    let mut robot = fast();
    robot.stop().expect("a motion runs");
    watch_stop(&mut robot);
    assert_eq!(robot.state().robot_mode, Mode::Idle);
    assert_eq!(robot.state().last_motion_errors, Errors::NONE);
}

#[test]
fn measured_joints_lag_behind_and_arrive() {
    let mut robot = fast();
    let lag = (robot.state().q_d - robot.state().q).norm();
    assert!((1e-4..1e-2).contains(&lag), "{lag}");
    robot.stop().expect("a motion runs");
    for _ in 0..1000 {
        robot.step(&[]);
    }
    assert!((robot.state().q_d - robot.state().q).norm() < 1e-9);
}
