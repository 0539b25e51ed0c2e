//! Version 10 of the interface, judged by the vendor's library for the FR3 (libfranka 0.21, as
//! `pylibfranka` has it): `fr3.py` acts and sees, the tests here judge.

use serde_json::{Value, json};
use testkit::tell;

use super::robot::{OF_FR3, OF_PANDA, Robot};
use super::{assert_clean, assert_moved, assert_near, contains, number};

fn start(test: &str) -> Option<Robot> {
    Robot::judged_by(&OF_FR3, 10, test)
}

#[test]
fn the_newer_library_connects_and_sees_an_fr3_with_its_hand() {
    let Some(robot) = start("the FR3's handshake") else {
        return;
    };
    let seen = robot.seen("handshake");
    assert_eq!(seen["connection"], Value::Null);
    assert_eq!(seen["mode"], "Idle");
    assert_eq!(seen["errors"]["now"], json!([]));
    assert_eq!(seen["rises"], true);
    // 45 degrees and 103.4 mm, column by column.
    let half = std::f64::consts::FRAC_1_SQRT_2;
    let hand = [
        half, -half, 0.0, 0.0, half, half, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.1034, 1.0,
    ];
    let unit = std::array::from_fn::<f64, 16, _>(|k| f64::from(u8::from(k % 5 == 0)));
    assert_near(&seen["F_T_NE"], &hand, 1e-6);
    assert_near(&seen["NE_T_EE"], &unit, 0.0);
    assert_near(&seen["F_T_EE"], &hand, 1e-6);
    // It makes its model from our description of the robot.
    assert_eq!(seen["model"], Value::Null);
    assert_clean(robot, 0);
}

#[test]
fn an_fr3_follows_velocities_and_echoes_them_as_sent() {
    let Some(robot) = start("the FR3's velocities") else {
        return;
    };
    let seen = robot.seen("waves");
    assert_moved("an FR3's joint 7", &seen["joint"]);
    assert_moved("an FR3, Cartesian", &seen["cartesian"]);
    assert_clean(robot, 0);
}

#[test]
fn a_step_is_a_reflex_of_an_fr3_until_recovery() {
    let Some(robot) = start("a step of an FR3") else {
        return;
    };
    let seen = robot.seen("reflex");
    let name = "cartesian_motion_generator_acceleration_discontinuity";
    let words = "motion aborted by reflex!";
    tell(format_args!("a step of an FR3: {}", seen["step"]));
    assert!(
        contains(&seen["step"], words) && contains(&seen["step"], name),
        "{seen}"
    );
    assert_eq!(seen["then"]["mode"], "Reflex");
    for errors in ["now", "last_motion"] {
        assert!(contains(&seen["then"]["errors"][errors], name), "{seen}");
    }
    let words = "command not possible in the current mode (\"Reflex\")!";
    assert!(contains(&seen["refused"], words), "{seen}");
    assert_eq!(seen["recovery"], Value::Null);
    assert_eq!(seen["recovered"]["mode"], "Idle");
    assert_eq!(seen["recovered"]["errors"]["now"], json!([]));
    assert_moved("an FR3 after a reflex", &seen["wave"]);
    assert_clean(robot, 1);
}

#[test]
fn near_the_end_of_its_range_a_joint_of_an_fr3_may_not_be_fast() {
    let Some(robot) = start("a joint near its end") else {
        return;
    };
    let seen = robot.seen("taper");
    tell(format_args!("a joint near its end: {seen}"));
    let name = "joint_motion_generator_velocity_limits_violation";
    assert!(contains(&seen["error"], name), "{seen}");
    // Joint 6 from 0.54092 rad upwards: sqrt(2 * 5.5 d) - 0.35 rad/s. One state has less than 2 ms
    // to go until the robot found it too fast.
    let (q, dq) = (number(&seen["q"]), number(&seen["dq"]));
    let room = (0.35 - dq).powi(2) / 11.0;
    assert!((dq + 1.5).abs() < 1e-6, "{seen}");
    assert!((q - 0.54092 - room).abs() < 0.01, "{seen}");
    assert_eq!(seen["recovery"], Value::Null);
    assert_clean(robot, 1);
}

#[test]
fn a_library_of_the_other_version_is_refused_with_both_versions() {
    // The second is of panda-python, which puts it into its own words.
    let ours = "(server version: 5, library version: 10)";
    let theirs = "version 10, but this panda-py was built with a libfranka that speaks version 5";
    let other = [
        (&OF_FR3, 5, "waves", ours),
        (&OF_PANDA, 10, "one_wave", theirs),
    ];
    for (library, version, case, words) in other {
        let Some(robot) = Robot::judged_by(library, version, "another version") else {
            return;
        };
        let seen = robot.seen(case);
        tell(format_args!("another version: {}", seen["connection"]));
        assert!(contains(&seen["connection"], words), "{seen}");
        assert_clean(robot, 0);
    }
}
