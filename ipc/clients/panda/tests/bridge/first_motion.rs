//! `--first-motion` of a right camera and of a wrong one; the library's tests make each mistake.

use std::path::Path;
use std::process::Stdio;

use testkit::{Ended, ended, root};

use crate::robot::Robot;

fn first_motion(robot: &Robot, hand_eye: &Path) -> Ended {
    let mut bridge = robot.bridge_with("panda", hand_eye);
    ended(bridge.args(["--first-motion", "--yes"]))
}

/// Moves a robot for the first time, with this hand-eye file; `mistake` is what is said to be wrong.
fn check(hand_eye: Option<&str>, mistake: Option<&str>) {
    let robot = Robot::start("lockstep", 5, "");
    let file = match hand_eye {
        Some(text) => robot.place.file("hand-eye.toml", text),
        None => root().join("ipc/clients/panda/hand-eye.toml"),
    };
    let said = first_motion(&robot, &file);
    let lines = said.stdout.lines();
    let mistakes: Vec<_> = lines
        .filter(|line| line.starts_with("LIKELY MISTAKE"))
        .collect();
    assert_eq!(mistakes.len(), usize::from(mistake.is_some()), "{said:?}");
    for (line, words) in mistakes.iter().zip(mistake) {
        assert!(line.contains(words), "{said:?}");
    }
    let is_recommended = said.stdout.contains("vpcctl arm");
    assert_eq!(is_recommended, mistake.is_none(), "{said:?}");
    assert_eq!(said.code, Some(i32::from(mistake.is_some())), "{said:?}");
    let report = robot.report();
    assert!(report.contains("\"reflexes\":0"), "{report}");
}

#[test]
fn a_right_camera_is_recommended() {
    check(None, None);
}

#[test]
fn a_mistake_is_named_and_nothing_recommended() {
    let inverse = "translation = [0.0, 0.07, -0.04]\nrotation_deg = [0, 0, -45]";
    check(Some(inverse), Some("the inverse"));
}

#[test]
fn nothing_moves_without_a_yes() {
    let robot = Robot::start("lockstep", 10, "");
    let mut bridge = robot.bridge("fr3");
    bridge.arg("--first-motion");
    let said = ended(bridge.stdin(Stdio::null()));
    assert_eq!(said.code, Some(1), "{said:?}");
    assert!(said.stderr.contains("not confirmed; nothing moved"));
    assert!(said.stdout.contains("F_T_EE") && said.stdout.contains("workspace"));
    assert!(robot.report().contains("\"joint_velocity\":0.0"));
}
