//! What is wrong in a configuration is named, with what is allowed.

use std::collections::BTreeMap;

use testkit::{Ended, Place, ended, root};

/// Runs the bridge with what it needs, and these flags in the place of some.
fn said(place: &Place, flags: &[(&'static str, &str)]) -> Ended {
    let file = |path: &str| root().join(path).display().to_string();
    let mut all = BTreeMap::from([
        ("--robot", "panda:127.0.0.254".to_owned()),
        ("--hand-eye", file("ipc/clients/panda/hand-eye.toml")),
        ("--scene", file("ipc/scene/scenes/paper-robot.toml")),
        ("--domain", place.domain().display().to_string()),
    ]);
    all.extend(
        flags
            .iter()
            .map(|(flag, value)| (*flag, (*value).to_owned())),
    );
    all.retain(|_, value| !value.is_empty());
    let mut bridge = testkit::command(env!("CARGO_BIN_EXE_vpc-panda"));
    for (flag, value) in all {
        bridge.args([flag, &value]);
    }
    ended(bridge)
}

#[test]
fn a_bad_configuration_is_refused_by_name() {
    let place = Place::new();
    let file = |name: &str, text: &str| place.file(name, text).display().to_string();
    let walls = "[workspace]\nlower = [0.9, 0, 0]\nupper = [0.8, 0.1, 0.1]\n";
    let walls = file("walls.toml", walls);
    let fast = file("fast.toml", "linear = 2.0\n");
    let odd = file("odd.toml", "speed = 2.0\n");
    let broken = file("hand-eye.yaml", "camera: 1\n");
    for (flag, value, code, words) in [
        ("--robot", "", 78, "robot"),
        (
            "--robot",
            "ur5:10.0.0.2",
            78,
            "panda:ADDRESS or fr3:ADDRESS",
        ),
        ("--robot", "10.0.0.2", 78, "10.0.0.2"),
        ("--robot", "panda:", 78, "panda:ADDRESS"),
        ("--hand-eye", "", 78, "hand_eye"),
        (
            "--hand-eye",
            "/nowhere.toml",
            66,
            "/nowhere.toml: cannot read",
        ),
        ("--hand-eye", &broken, 78, "no hand-eye calibration"),
        ("--scene", "", 78, "scene"),
        ("--scene", "/nowhere.toml", 66, "/nowhere.toml: cannot read"),
        ("--config", &walls, 78, "workspace.lower[0] = 0.9"),
        ("--config", &fast, 78, "linear = 2"),
        ("--config", &odd, 78, "speed"),
        ("--interface", "torque", 64, "joint, cartesian"),
    ] {
        let said = said(&place, &[(flag, value)]);
        assert_eq!(said.code, Some(code), "{flag} {value}: {said:?}");
        assert!(said.stderr.contains(words), "{flag} {value}: {said:?}");
    }
}

#[test]
fn what_contradicts_the_arm_of_the_scene_is_refused() {
    let place = Place::new();
    let shipped = |name: &str| std::fs::read(root().join("ipc/scene/scenes").join(name)).unwrap();
    for name in ["panda.toml", "panda.urdf"] {
        place.file(name, shipped(name));
    }
    let file = |name: &str, text: &str| place.file(name, text).display().to_string();
    let text = String::from_utf8(shipped("paper-robot.toml")).unwrap();
    let scene = file("scene.toml", &format!("arm = \"panda.toml\"\n{text}"));
    let aside = "translation = [0.02, -0.05, 0.04]\nrotation_deg = [0.0, 0.0, 45.0]\n";
    let turned = "translation = [0.04949747468305833, -0.04949747468305833, 0.04]\n\
        rotation_deg = [0.0, 0.0, 46.0]\n";
    for (flag, text, code, words) in [
        ("--config", "", 69, "robot 127.0.0.254: "),
        (
            "--config",
            "hand_eye_frame = 'ee'",
            78,
            "flange, where the scene names an arm",
        ),
        ("--hand-eye", aside, 78, "29.5 mm and 0.000 rad from there"),
        ("--hand-eye", turned, 78, "0.0 mm and 0.017 rad from there"),
        (
            "--config",
            "joint_margin = 0.3",
            78,
            "at most 0.2, the margin",
        ),
        (
            "--config",
            "joint_speed = 0.2",
            78,
            "at least 0.25, the speed",
        ),
        (
            "--config",
            "interface = 'cartesian'",
            78,
            "interface = cartesian; allowed: joint: the elbow",
        ),
    ] {
        let value = file("changed.toml", text);
        let said = said(&place, &[("--scene", &scene), (flag, &value)]);
        assert_eq!(said.code, Some(code), "{text}: {said:?}");
        assert!(said.stderr.contains(words), "{text}: {said:?}");
    }
}

#[test]
fn the_arm_of_the_scene_mounts_the_camera_if_it_is_a_franka() {
    let place = Place::new();
    let scenes = root().join("ipc/scene/scenes");
    let read = |name: &str| std::fs::read_to_string(scenes.join(name)).unwrap();
    let (arm, urdf) = (read("panda.toml"), read("panda.urdf"));
    let text = format!("arm = 'arm.toml'\n{}", read("paper-robot.toml"));
    let scene = place.file("scene.toml", text).display().to_string();
    let shipped = "xyz=\"0.0825 0 0\"";
    for (urdf, code, words) in [
        (urdf.clone(), 69, "robot 127.0.0.254: "),
        (
            urdf.replacen(shipped, "xyz=\"0.0925 0 0\"", 1),
            78,
            "an arm whose joint 4 is another's; allowed: a scene whose arm file is of a Panda or FR3",
        ),
    ] {
        place.file("panda.urdf", &urdf);
        place.file("arm.toml", &arm);
        let said = said(&place, &[("--scene", &scene), ("--hand-eye", "")]);
        assert_eq!(said.code, Some(code), "{said:?}");
        assert!(said.stderr.contains(words), "{said:?}");
    }
}

#[test]
fn a_robot_that_does_not_answer_is_named() {
    let place = Place::new();
    let said = said(&place, &[("--robot", "fr3:127.0.0.254")]);
    assert_eq!(said.code, Some(69), "{said:?}");
    assert!(said.stderr.contains("robot 127.0.0.254: "), "{said:?}");
}
