//! Commands at 30 Hz, as the controller sends them: with the shaper and without.

use arm::{Mount, Shaper, ShaperSettings};
use nalgebra::{Rotation3, Translation3, Vector3};
use panda::{Chain, Joints, Mode, Model, Pose, READY, Robot, RobotSettings, Twist, place};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::rig::{answer, echo, moving, ready};

/// The scene `paper-robot`: m/s and rad/s.
const LINEAR: f64 = 0.01;
const ANGULAR: f64 = 0.03;

/// A camera 7 cm in front of the flange and 5 cm beside it, looking along its axis.
fn mount() -> Mount {
    Mount {
        flange_from_camera: Pose::from_parts(
            Translation3::new(0.05, 0.0, 0.07),
            Rotation3::new(Vector3::z() * std::f64::consts::FRAC_PI_4),
        ),
    }
}

/// A robot whose camera looks down on a table, somewhere in front of it.
fn somewhere(random: &mut ChaCha8Rng) -> Robot {
    let mut draw = |most: f64| random.random_range(-most..most);
    let down = Rotation3::new(Vector3::x() * std::f64::consts::PI);
    let turn = Rotation3::new(Vector3::new(draw(0.2), draw(0.2), draw(0.6)));
    let at = Translation3::new(0.45 + draw(0.1), draw(0.15), 0.4 + draw(0.1));
    let flange = mount().flange(&Pose::from_parts(at, down * turn));
    let q = place(&Chain::default(), Model::Panda.limits(), &flange).expect("within reach");
    Robot::new(RobotSettings::default(), q).expect("in range")
}

/// A command as far from the last one as the scene allows, or anywhere between.
fn command(random: &mut ChaCha8Rng) -> Twist {
    let extreme = random.random_bool(0.5);
    Twist::from_fn(|axis, _| {
        let limit = if axis < 3 { LINEAR } else { ANGULAR };
        let share = random.random_range(-1.0..1.0f64);
        limit * if extreme { share.signum() } else { share }
    })
}

/// Drives for `ticks` ms; whether the robot is still in motion. Every frame brings a command, every
/// 33.3 ms.
fn drive(robot: &mut Robot, shaped: bool, ticks: u64, loss: f64, random: &mut ChaCha8Rng) -> bool {
    let mut shaper = Shaper::new(ShaperSettings::default()).expect("good settings");
    let mut frame = 0;
    let mut target = Twist::zeros();
    for tick in 0..ticks {
        let state = *robot.state();
        let now = tick * 1_000_000;
        if tick * 30 / 1000 >= frame {
            frame += 1;
            target = mount().to_base(&state.o_t_ee.rotation, &state.f_t_ee, &command(random));
            shaper.aim(&target, now + 100_000_000);
        }
        let twist = if shaped {
            shaper.step(&echo(&state), now)
        } else {
            target
        };
        let after = if random.random_bool(loss) {
            *robot.step(&[])
        } else {
            answer(robot, twist)
        };
        if after.robot_mode != Mode::Move {
            return false;
        }
    }
    true
}

#[test]
fn without_the_shaper_a_staircase_trips_the_robot_everywhere() {
    let mut random = ChaCha8Rng::seed_from_u64(10);
    for place in 0..40 {
        let mut robot = moving(somewhere(&mut random));
        assert!(
            !drive(&mut robot, false, 500, 0.0, &mut random),
            "place {place}"
        );
    }
}

#[test]
fn with_the_shaper_a_staircase_never_trips_the_robot() {
    let mut random = ChaCha8Rng::seed_from_u64(11);
    for place in 0..40 {
        let mut robot = moving(somewhere(&mut random));
        let going = drive(&mut robot, true, 3000, 0.0, &mut random);
        assert!(going, "place {place}: {}", robot.state().current_errors);
    }
}

#[test]
fn with_the_shaper_lost_commands_do_not_trip_the_robot_either() {
    let mut random = ChaCha8Rng::seed_from_u64(12);
    for place in 0..20 {
        let mut robot = moving(somewhere(&mut random));
        let going = drive(&mut robot, true, 3000, 0.2, &mut random);
        assert!(going, "place {place}: {}", robot.state().current_errors);
    }
}

#[test]
fn five_mm_a_second_trip_only_without_the_shaper() {
    let mut robot = moving(ready());
    assert_eq!(
        answer(&mut robot, Twist::x() * 0.005).robot_mode,
        Mode::Reflex
    );
    let mut robot = moving(ready());
    let mut shaper = Shaper::new(ShaperSettings::default()).expect("good settings");
    shaper.aim(&(Twist::x() * 0.005), u64::MAX);
    for _ in 0..100 {
        let twist = shaper.step(&echo(robot.state()), 0);
        assert_eq!(answer(&mut robot, twist).robot_mode, Mode::Move);
    }
    assert!((robot.state().o_dp_ee_d[0] - 0.005).abs() < 1e-6);
}

#[test]
fn the_camera_arrives_at_the_velocity_that_was_commanded() {
    let twist = Twist::new(0.01, -0.005, 0.008, 0.02, -0.03, 0.01);
    let hand = RobotSettings::with_hand();
    let mut robot = moving(Robot::new(hand, Joints::from(READY)).expect("ok"));
    let mut shaper = Shaper::new(ShaperSettings::default()).expect("good settings");
    let mut before = mount().camera(&robot.state().flange());
    for tick in 0..600 {
        let state = *robot.state();
        before = mount().camera(&state.flange());
        if tick % 33 == 0 {
            let base = mount().to_base(&state.o_t_ee.rotation, &state.f_t_ee, &twist);
            shaper.aim(&base, u64::MAX);
        }
        answer(&mut robot, shaper.step(&echo(&state), 0));
    }
    // From measured poses: the servo's lag is a delay, no error of a steady velocity.
    let after = mount().camera(&robot.state().flange());
    let seen = panda::kinematics::difference(&after, &before) * 1000.0;
    let back = before.rotation.inverse();
    let linear = back * Vector3::new(seen[0], seen[1], seen[2]);
    let angular = back * Vector3::new(seen[3], seen[4], seen[5]);
    for k in 0..3 {
        assert!((linear[k] - twist[k]).abs() < 2e-5, "{linear}");
        assert!((angular[k] - twist[k + 3]).abs() < 2e-4, "{angular}");
    }
}
