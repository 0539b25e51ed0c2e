//! What is wrong in a configuration is named, with what is allowed.

use std::process::Command;

use testkit::{Place, ended, root};

fn said(arguments: &[&str]) -> (Option<i32>, String) {
    let mut bridge = Command::new(env!("CARGO_BIN_EXE_vpc-panda"));
    let ended = ended(bridge.args(arguments));
    (ended.code, ended.stderr)
}

#[test]
fn a_bad_configuration_is_refused_by_name() {
    let place = Place::new();
    let hand_eye = root().join("ipc/panda/hand-eye.toml");
    let hand_eye = hand_eye.to_str().unwrap();
    let robot = "panda:127.0.0.1";
    let file = |name: &str, text: &str| place.file(name, text).to_str().unwrap().to_owned();
    let walls = file(
        "walls.toml",
        "[workspace]\nlower = [0.9, 0, 0]\nupper = [0.8, 0.1, 0.1]\n",
    );
    let fast = file("fast.toml", "linear = 2.0\n");
    let odd = file("odd.toml", "speed = 2.0\n");
    let broken = file("hand-eye.yaml", "camera: 1\n");
    for (arguments, code, words) in [
        (vec!["--hand-eye", hand_eye], 78, "robot"),
        (
            vec!["--robot", "ur5:10.0.0.2", "--hand-eye", hand_eye],
            78,
            "panda:ADDRESS or fr3:ADDRESS",
        ),
        (
            vec!["--robot", "10.0.0.2", "--hand-eye", hand_eye],
            78,
            "10.0.0.2",
        ),
        (vec!["--robot", robot], 78, "hand_eye"),
        (
            vec!["--robot", robot, "--hand-eye", "/nowhere.toml"],
            66,
            "/nowhere.toml: cannot read",
        ),
        (
            vec!["--robot", robot, "--hand-eye", &broken],
            78,
            "no hand-eye calibration",
        ),
        (
            vec!["--robot", robot, "--hand-eye", hand_eye, "--config", &walls],
            78,
            "workspace.lower[0] = 0.9",
        ),
        (
            vec!["--robot", robot, "--hand-eye", hand_eye, "--config", &fast],
            78,
            "linear = 2",
        ),
        (
            vec!["--robot", robot, "--hand-eye", hand_eye, "--config", &odd],
            78,
            "speed",
        ),
        (
            vec![
                "--robot",
                robot,
                "--hand-eye",
                hand_eye,
                "--interface",
                "torque",
            ],
            64,
            "joint, cartesian",
        ),
    ] {
        let (found, text) = said(&arguments);
        assert_eq!(found, Some(code), "{arguments:?}: {text}");
        assert!(text.contains(words), "{arguments:?}: {text}");
    }
}

#[test]
fn a_robot_that_does_not_answer_is_named() {
    let place = Place::new();
    let hand_eye = root().join("ipc/panda/hand-eye.toml");
    let domain = place.domain();
    let (code, text) = said(&[
        "--robot",
        "fr3:127.0.0.254",
        "--hand-eye",
        hand_eye.to_str().unwrap(),
        "--domain",
        domain.to_str().unwrap(),
    ]);
    assert_eq!(code, Some(69), "{text}");
    assert!(text.contains("robot 127.0.0.254: "), "{text}");
}
