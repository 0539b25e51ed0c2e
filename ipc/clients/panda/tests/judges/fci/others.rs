//! Version 10 of the interface, used by libraries of other teams: franky-control plans velocities
//! with Ruckig at 1 kHz, aiofranka has the arm's kinematics from a MuJoCo model.

use serde_json::{Value, json};
use testkit::tell;

use super::robot::{Library, Robot};
use super::{assert_clean, contains, number};

const OTHERS: Library = Library("others.py");
/// How far the motions of `others.py` go: what they lack at their beginning, they have at their
/// end. m, rad.
const WAYS: [f64; 2] = [0.04 * 0.8, 0.1 * 0.8];
/// What single precision and the start of the stop leave of a way, m or rad.
const NEAR: f64 = 1e-3;
/// States hold numbers of 32 bits.
const SINGLE: f64 = 1e-6;
/// The answer to a motion that is not emulated.
const REJECTED: &str =
    "Move command rejected: command not possible in the current mode (\"Idle\")!";

#[test]
fn franky_control_moves_an_fr3_as_far_as_it_planned() {
    let Some(robot) = Robot::judged_by(&OTHERS, 10, "franky-control") else {
        return;
    };
    let seen = robot.seen("waves");
    tell(format_args!("franky-control: {seen}"));
    assert_eq!(seen["connection"], Value::Null);
    for (motion, way) in ["cartesian", "joint"].into_iter().zip(WAYS) {
        assert_eq!(seen[motion]["error"], Value::Null, "{seen}");
        assert_eq!(seen[motion]["has_errors"], json!(false), "{seen}");
        assert!((number(&seen[motion]["way"]) - way).abs() < NEAR, "{seen}");
    }
    assert!(contains(&seen["position"], REJECTED), "{seen}");
    assert_clean(robot, 0);
}

#[test]
fn aiofranka_has_the_flange_of_an_fr3_where_its_states_say() {
    let Some(robot) = Robot::judged_by(&OTHERS, 10, "aiofranka") else {
        return;
    };
    let seen = robot.seen("model");
    tell(format_args!("aiofranka: {seen}"));
    assert_eq!(seen["connection"], Value::Null);
    assert_eq!(number(&seen["joints_differ"]), 0.0, "{seen}");
    assert!(number(&seen["differ"]) < SINGLE, "{seen}");
    // It steers by torques.
    assert!(contains(&seen["torque"], REJECTED), "{seen}");
    assert_clean(robot, 0);
}
