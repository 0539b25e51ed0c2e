//! A user's own robot: the bridge of `hw-sim/examples/own_robot.rs`, which users copy, takes the
//! emulated robot to the goal with the real `vpcd`, on the fixed clock.

use std::process::{Command, Stdio};

use crate::fixture::{Place, Running, ended, program, root, turn};

#[test]
fn the_bridge_to_copy_takes_the_robot_to_the_goal_without_a_reflex() {
    let _turn = turn();
    let place = Place::new();
    let mut vpcd = Command::new(program("vpcd"));
    vpcd.arg("--scene")
        .arg(root().join("ipc/scene/scenes/paper-robot.toml"));
    vpcd.arg("--arm").arg("--domain").arg(place.domain());
    let vpcd = Running::start(vpcd.stdout(Stdio::null()).stderr(Stdio::null()));
    let mut bridge = Command::new(program("examples/own_robot"));
    let said = ended(bridge.arg(place.domain()).arg("60"));
    drop(vpcd);

    let told: serde_json::Value = serde_json::from_str(&said.stdout).expect(&said.stderr);
    assert!(told["first_px"].as_f64().unwrap() > 30.0, "{told}");
    assert!(told["error_px"].as_f64().unwrap() <= 5.0, "{told}");
    assert_eq!(told["mode"], "move", "{told}");
    assert_eq!(said.code, Some(0), "{said:?}");
}
