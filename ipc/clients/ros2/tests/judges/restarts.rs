//! Each process is killed in turn while the camera moves, and comes back.

use std::time::Duration;

use rustix::process::Signal;
use serde_json::json;

use crate::bench::{Bench, Via};

/// The peer stands by its own time-out after this; twice it, on a loaded machine.
const STANDS: Duration = Duration::from_millis(250);

#[test]
#[ignore = "long: a run in real time beside another team's middleware"]
fn who_is_killed_and_comes_back_is_armed_again_and_arrives() {
    let Some(mut bench) = Bench::new("restarts", Via::Dds, false) else {
        return;
    };
    // The gateway: silence, and vpcd disarms.
    if !bench.peer.set_off(1) {
        return;
    }
    bench.gateway.signal(Signal::KILL);
    std::thread::sleep(STANDS);
    let status = bench.peer.status();
    assert_eq!(status["speed"], json!(0.0), "{status}");
    bench.restart_gateway();
    let disarmed = |status: &serde_json::Value| {
        let message = status["message"].as_str().unwrap_or_default();
        message.starts_with("disarmed: ") && status["level"] == json!(2)
    };
    bench.diagnosed("vpcd", disarmed);
    bench.peer.arrives(1);

    // Camera and robot: vpcd disarms, and the gateway says what is missing.
    if !bench.peer.set_off(2) {
        return;
    }
    bench.peer.signal(Signal::KILL);
    std::thread::sleep(Duration::from_secs(1));
    bench.restart_peer();
    bench.diagnosed("vpcd", disarmed);
    bench.peer.arrives(2);

    // vpcd: zeros, then silence; the next one begins disarmed.
    if !bench.peer.set_off(3) {
        return;
    }
    let zeros = bench.peer.status()["zeros"].as_u64().unwrap();
    bench.vpcd.signal(Signal::KILL);
    std::thread::sleep(STANDS);
    let status = bench.peer.status();
    assert_eq!(status["speed"], json!(0.0), "{status}");
    assert!(status["zeros"].as_u64().unwrap() >= zeros + 3, "{status}");
    std::thread::sleep(Duration::from_secs(1));
    let status = bench.peer.status();
    assert!(status["silent_s"].as_f64().unwrap() > 0.5, "{status}");
    bench.diagnosed("vpcd", |status| status["level"] == json!(3));
    bench.restart_vpcd();
    bench.diagnosed("vpcd", |status| {
        status["message"] == "disarmed: unclean end of the last vpcd"
    });
    bench.peer.arrives(3);
}
