//! A policy in ROS 2, guarded by vpcd.

use std::time::Duration;

use serde_json::{Value, json};
use testkit::{eventually, tell};

use crate::bench::{Bench, Peer};

/// Wanted in turn, far beyond the scene's limits; the camera would lose the pattern within 1 s.
const TWISTS: [&str; 4] = [
    "[3, 0, 0, 0, 0, 0]",
    "[0, -3, 0, 0, 0, 2]",
    "[-3, 0, 0, 0, 1, 0]",
    "[0, 3, 0, -1, 0, 0]",
];

fn is_still(status: &Value) -> Option<()> {
    (status["speed"] == json!(0.0)).then_some(())
}

/// Follows each twist, stands when nothing is wanted any more, and follows again; `false` where
/// the machine was late.
fn follows(peer: &mut Peer) -> bool {
    peer.ask("wish null");
    peer.place(0);
    // Armed, it waits.
    eventually("standstill", || is_still(&peer.status()));
    for twist in TWISTS {
        peer.ask(&format!("wish {twist}"));
        if !peer.moves(0.02) {
            return false;
        }
        std::thread::sleep(Duration::from_millis(1500));
        let status = peer.status();
        tell(format_args!("{twist}: {} twists", status["twists"]));
        assert_eq!(status["violation"], Value::Null, "{twist}: {status}");
    }
    peer.ask("wish null");
    eventually("standstill", || is_still(&peer.status()));
    // Silent, it stays armed, and follows again.
    peer.ask(&format!("wish {}", TWISTS[0]));
    peer.moves(0.02)
}

#[test]
#[ignore = "long: a run in real time beside another team's middleware"]
fn what_a_policy_in_ros_wants_loses_no_point_and_its_silence_brakes() {
    let Some(mut bench) = Bench::guarded("a policy in ROS") else {
        return;
    };
    if !follows(&mut bench.peer) {
        return;
    }
    let gateway = bench.diagnosed("gateway", |status| status["level"] == json!(0));
    let values = gateway["values"].as_object().unwrap();
    assert!(values.keys().any(|key| key.contains("/wish")), "{gateway}");
}
