//! A user's own robot: the bridge of `hw-sim/examples/own_robot`, which users copy, takes the
//! emulated robot to the goal with the real `vpcd`, on the fixed clock; and `vpcctl check-bridge`
//! finds no fault in it, nor in `hw-sim`.

use std::process::Stdio;

use testkit::{Place, Running, ended, eventually, program, root, scene_file, starts_file, turn};

#[test]
fn the_bridge_to_copy_reaches_the_goal_without_a_reflex() {
    let _turn = turn();
    let place = Place::new();
    // Built first: an armed start waits 5 s for its robot.
    let bridge = program("examples/own_robot");
    let mut vpcd = testkit::command(program("vpcd"));
    vpcd.arg("--scene")
        .arg(root().join("ipc/scene/scenes/paper-robot.toml"));
    vpcd.arg("--arm").arg("--domain").arg(place.domain());
    let vpcd = Running::start(vpcd.stdout(Stdio::null()).stderr(Stdio::null()));
    let mut bridge = testkit::command(bridge);
    let said = ended(bridge.arg(place.domain()).arg("60"));
    drop(vpcd);

    let told: serde_json::Value = serde_json::from_str(&said.stdout).expect(&said.stderr);
    assert!(told["first_px"].as_f64().unwrap() > 30.0, "{told}");
    assert!(told["error_px"].as_f64().unwrap() <= 5.0, "{told}");
    assert_eq!(told["mode"], "move", "{told}");
    assert_eq!(said.code, Some(0), "{said:?}");
}

#[test]
fn check_bridge_finds_no_fault_in_our_bridges() {
    let _turn = turn();
    let check = |place: &Place, scene: &str| {
        let scene = root().join("ipc/scene/scenes").join(scene);
        // The bridge has made its ports when it tells its state.
        let said = eventually("a state", || {
            let mut check = testkit::command(program("vpcctl"));
            check.arg("--domain").arg(place.domain());
            check.arg("check-bridge").arg("--scene").arg(&scene);
            let said = ended(check);
            (!said.stdout.contains("nothing on vpc/robot")).then_some(said)
        });
        assert_eq!(said.code, Some(0), "{said:?}");
    };
    let place = Place::new();
    let mut bridge = testkit::command(program("examples/own_robot"));
    bridge.arg(place.domain()).arg("60");
    let bridge = Running::start(bridge.stdout(Stdio::null()));
    check(&place, "paper-robot.toml");
    drop(bridge);
    let place = Place::new();
    let mut emulator = testkit::command(program("hw-sim"));
    emulator
        .arg("--scene")
        .arg(scene_file())
        .arg("--starts")
        .arg(starts_file());
    emulator.args(["--start", "0", "--clock", "fixed", "--domain"]);
    emulator.arg(place.domain()).stdout(Stdio::null());
    let emulator = Running::start(emulator);
    check(&place, "paper-sim.toml");
    drop(emulator);
}
