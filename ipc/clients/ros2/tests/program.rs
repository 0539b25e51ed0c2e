//! The program: its configuration, its places.

use std::process::Command;

use testkit::{Place, Running, ended, program, root, scene_file};

/// A ROS domain of this process: another checkout's tests are in another one.
fn ros_domain_id() -> u32 {
    1 + std::process::id() % 100
}

fn gateway(place: &Place, keys: &str) -> Command {
    let scene = scene_file();
    let text = format!(
        "scene = {scene:?}\nros_domain_id = {}\ninterfaces = [\"127.0.0.1\"]\n{keys}",
        ros_domain_id()
    );
    let mut command = testkit::command(program("vpc-ros2"));
    command
        .arg("--config")
        .arg(place.file("vpc-ros2.toml", text));
    command.arg("--domain").arg(place.domain());
    command
}

#[test]
fn the_file_that_ships_shows_the_defaults_and_is_valid() {
    let file = root().join("ipc/clients/ros2/vpc-ros2.toml");
    let mut command = testkit::command(program("vpc-ros2"));
    command
        .arg("--config")
        .arg(file)
        .args(["--preflight", "--ros-domain-id"])
        .arg(ros_domain_id().to_string());
    let ended = ended(command);
    assert_eq!(ended.code, Some(1), "{}", ended.stderr);
    for topic in ["/detections", "/camera/camera_info", "/vpcd/executed_twist"] {
        let line = format!("FAIL  {topic}: nothing came: ");
        assert!(ended.stdout.contains(&line), "{}", ended.stdout);
    }
}

#[test]
fn keys_that_contradict_each_other_are_refused() {
    let place = Place::new();
    for (keys, words) in [
        (
            "[camera]\ntags = [1, 2]",
            "camera.tags = [1, 2]; allowed: 4 different numbers",
        ),
        (
            "[camera]\ntopic = \"detections\"",
            "camera.topic = detections; allowed: an absolute name",
        ),
        (
            "[camera]\nfeatures = \"none\"\n[robot]\nexecuted = \"none\"",
            "unless the robot is played",
        ),
        (
            "[robot]\ncommand_frame = \"base\"",
            "robot.pose = ; allowed: a topic",
        ),
        (
            "[robot]\njoints = [\"a\", \"a\"]",
            "at most 7 different names",
        ),
        ("[robot]\ntool = \"base_link\"", "three different names"),
        (
            "[robot]\ntwist = \"/servo_node/delta_twist_cmds\"",
            "robot.twist = /servo_node/delta_twist_cmds; allowed: a topic of the robot",
        ),
        (
            "[policy]\ndesired = \"/servo_node/delta_twist_cmds\"",
            "policy.desired = /servo_node/delta_twist_cmds; allowed: a topic of the policy",
        ),
        ("node = \"vpcd\"", "node = vpcd; allowed: an absolute name"),
        ("[robot]\nspeed = 1.0", "speed"),
        ("[camera]\nmax_age_ms = 1.0", "max_age_ms"),
    ] {
        let ended = ended(gateway(&place, keys));
        assert_eq!(ended.code, Some(78), "{keys}: {}", ended.stderr);
        assert!(ended.stderr.contains(words), "{keys}: {}", ended.stderr);
    }
}

#[test]
fn another_scene_than_that_of_vpcd_ends_it() {
    let place = Place::new();
    let mut vpcd = testkit::command(program("vpcd"));
    vpcd.arg("--scene").arg(scene_file());
    vpcd.arg("--memory").arg(testkit::memory_file());
    vpcd.arg("--domain").arg(place.domain());
    let vpcd = Running::start(vpcd.stderr(std::process::Stdio::null()));
    let text = std::fs::read_to_string(scene_file()).unwrap();
    let scene = place.file("other.toml", text.replace("fx = 800.0", "fx = 600.0"));
    let mut command = gateway(&place, "");
    command.arg("--scene").arg(scene);
    let ended = ended(command);
    assert_eq!(ended.code, Some(78), "{}", ended.stderr);
    let words = "vpcd's scene has camera Camera {";
    assert!(ended.stderr.contains(words), "{}", ended.stderr);
    drop(vpcd);
}

#[test]
fn a_second_camera_of_the_domain_is_refused() {
    let place = Place::new();
    let mut first = Running::start(
        gateway(&place, "[robot]\nexecuted = \"none\"").stderr(std::process::Stdio::piped()),
    );
    first.line(&format!("in ROS domain {}", ros_domain_id()));
    let domain = ipc::Domain::join(&place.domain()).unwrap();
    testkit::eventually("the camera's place", || {
        domain
            .publisher::<messages::Features>()
            .is_err()
            .then_some(())
    });
    let second = ended(gateway(&place, ""));
    assert_eq!(second.code, Some(69), "{}", second.stderr);
    assert!(
        second
            .stderr
            .contains("vpc/features: another publisher is at work"),
        "{}",
        second.stderr
    );
    // The robot's place is free: it plays the camera only.
    assert!(domain.publisher::<messages::RobotState>().is_ok());
    assert_eq!(first.terminated().code, Some(0));
}
