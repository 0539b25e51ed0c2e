//! `--first-motion`, with each mistake made on purpose.

use std::path::Path;
use std::process::Stdio;
use std::time::Duration;

use rustix::process::Signal;
use testkit::{Ended, Running, ended, root, tell};

use crate::Robot;

/// What a robot says that hears nothing for 20 ms, as a busy machine brings about.
const LATE: &str = "communication_constraints_violation";
/// Robots at once: each answers its bridge a thousand times a second.
const AT_ONCE: usize = 3;
/// Most tries of a motion that such a machine ends.
const TRIES: usize = 4;

fn first_motion(robot: &Robot, hand_eye: &Path) -> Ended {
    let mut bridge = robot.bridge_with("panda", hand_eye);
    ended(bridge.args(["--first-motion", "--yes"]))
}

/// What is wrong in the world, or in the hand-eye file, and what is to be said of it.
const MISTAKES: [(&str, Option<&str>, &[&str]); 9] = [
    ("", None, &[]),
    // As a real desk has it.
    ("desk_decimals = 4", None, &[]),
    ("focal = 0.15", None, &["focal length"]),
    ("depth = 0.25", None, &["pattern"]),
    (
        "hand_eye_deg = [0.0, 8.0, 6.0]",
        None,
        &["hand-eye", "turned by"],
    ),
    (
        "hand_eye_m = [0.06, 0.0, 0.05]",
        None,
        &["hand-eye", "cm from where"],
    ),
    // By a quarter turn; the inverse; and what is right about the end effector.
    (
        "",
        Some("translation = [0.05, -0.05, 0.04]\nrotation_deg = [0, 0, 135]"),
        &["axes", "turned by"],
    ),
    (
        "",
        Some("translation = [0.0, 0.07, -0.04]\nrotation_deg = [0, 0, -45]"),
        &["axes", "the inverse"],
    ),
    (
        "",
        Some("translation = [0.07, 0.0, -0.0634]\nrotation_deg = [0, 0, 90]"),
        &["axes", "hand_eye_frame = \"ee\""],
    ),
];

/// The first motion of a robot with these mistakes, and what is said of it.
fn in_time(truth: &str, hand_eye: Option<&str>) -> (Robot, Ended) {
    for _ in 0..TRIES {
        let robot = Robot::start(5, truth);
        let file = match hand_eye {
            Some(text) => robot.place.file("hand-eye.toml", text),
            None => root().join("ipc/clients/panda/hand-eye.toml"),
        };
        let said = first_motion(&robot, &file);
        if !said.stderr.contains(LATE) {
            return (robot, said);
        }
        tell(format_args!("tried again: {}", said.stderr.trim()));
    }
    panic!("{LATE}, {TRIES} times");
}

/// Checks what is said of these mistakes: each of `words`, and nothing without one.
fn check(truth: &str, hand_eye: Option<&str>, words: &[&str]) {
    let (robot, said) = in_time(truth, hand_eye);
    let mistakes: Vec<_> = said
        .stdout
        .lines()
        .filter(|line| line.starts_with("LIKELY MISTAKE"))
        .collect();
    assert_eq!(mistakes.len(), usize::from(!words.is_empty()), "{said:?}");
    for word in words {
        assert!(mistakes[0].contains(word), "{truth} {hand_eye:?}: {said:?}");
    }
    let is_recommended = said.stdout.contains("vpcctl arm");
    assert_eq!(is_recommended, words.is_empty(), "{said:?}");
    assert_eq!(said.code, Some(i32::from(!words.is_empty())));
    let report = robot.report();
    assert!(report.contains("\"reflexes\":0"), "{report}");
}

#[test]
fn each_mistake_is_named_and_only_a_right_camera_recommended() {
    for some in MISTAKES.chunks(AT_ONCE) {
        std::thread::scope(|scope| {
            for (truth, hand_eye, words) in some {
                scope.spawn(move || check(truth, *hand_eye, words));
            }
        });
    }
}

#[test]
fn nothing_moves_without_a_yes() {
    let robot = Robot::start(10, "");
    let mut bridge = robot.bridge("fr3");
    bridge.arg("--first-motion");
    let said = ended(bridge.stdin(std::process::Stdio::null()));
    assert_eq!(said.code, Some(1), "{said:?}");
    assert!(said.stderr.contains("not confirmed; nothing moved"));
    assert!(said.stdout.contains("F_T_EE") && said.stdout.contains("workspace"));
    assert!(robot.report().contains("\"joint_velocity\":0.0"));
}

#[test]
fn a_reflex_in_the_middle_ends_it_and_is_named() {
    let robot = Robot::start(5, "");
    let mut bridge = robot.bridge("panda");
    bridge.args(["--first-motion", "--yes"]);
    let bridge = Running::start(bridge.stdout(Stdio::piped()).stderr(Stdio::piped()));
    std::thread::sleep(Duration::from_secs(3));
    bridge.signal(Signal::STOP);
    std::thread::sleep(Duration::from_millis(100));
    bridge.signal(Signal::CONT);
    let said = bridge.ended();
    assert_eq!(said.code, Some(69), "{said:?}");
    assert!(said.stderr.contains(LATE), "{said:?}");
    assert!(!said.stdout.contains("vpcctl arm"), "{said:?}");
}
