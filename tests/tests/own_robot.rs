//! A robot of one's own: the bridge of `hw-sim/examples/own_robot.rs`, which is there to be copied, takes the emulated
//! robot to the goal of the real `vpcd`, on the fixed clock.

use std::path::Path;
use std::process::{Child, Command, Stdio};

struct Running(Child);

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

#[test]
fn the_bridge_to_copy_takes_the_robot_to_the_goal_without_a_reflex() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let mut build = Command::new(std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into()));
    build.current_dir(&root).args(["build", "--quiet"]);
    build.args(["-p", "controller", "-p", "hw-sim", "--bins"]);
    build.args(["--example", "own_robot"]);
    if !cfg!(debug_assertions) {
        build.arg("--release");
    }
    assert!(build.status().unwrap().success(), "the build failed");
    // target/debug/deps/own_robot-...: two up are the programs.
    let tests = std::env::current_exe().unwrap();
    let programs = tests.ancestors().nth(2).unwrap();

    let place = tempfile::tempdir().unwrap();
    let domain = place.path().join("domain");
    let mut vpcd = Command::new(programs.join("vpcd"));
    vpcd.arg("--scene")
        .arg(root.join("ipc/scene/scenes/paper-robot.toml"));
    vpcd.arg("--arm").arg("--domain").arg(&domain);
    vpcd.stdout(Stdio::null()).stderr(Stdio::null());
    let vpcd = Running(vpcd.spawn().unwrap());
    let mut bridge = Command::new(programs.join("examples/own_robot"));
    let said = bridge.arg(&domain).arg("60").output().unwrap();
    drop(vpcd);
    // What a killed daemon leaves in /dev/shm is cleared away by who joins next.
    let _ = ipc::Domain::join(&domain);

    let text = String::from_utf8_lossy(&said.stdout).into_owned();
    let complaint = String::from_utf8_lossy(&said.stderr).into_owned();
    let told: serde_json::Value = serde_json::from_str(&text).expect(&complaint);
    assert!(told["first_px"].as_f64().unwrap() > 30.0, "{text}");
    assert!(told["error_px"].as_f64().unwrap() <= 5.0, "{text}");
    assert_eq!(told["mode"], "move", "{text}");
    assert!(said.status.success(), "{text}");
}
