//! vpcd hangs, receivers hang, the gateway ends: the robot stands, and nothing old moves it.

use std::time::{Duration, Instant};

use rustix::process::Signal;
use serde_json::{Value, json};
use testkit::eventually;

use crate::bench::{Bench, Via};

fn count(status: &Value, key: &str) -> u64 {
    status[key].as_u64().unwrap()
}

#[test]
fn when_vpcd_hangs_zeros_go_out_and_then_silence() {
    let Some(mut bench) = Bench::new("dead man", Via::Dds, false) else {
        return;
    };
    if !bench.peer.set_off(4) {
        return;
    }
    let before = bench.peer.status();
    bench.vpcd.signal(Signal::STOP);
    let hung = Instant::now();
    let peer = &mut bench.peer;
    eventually("zeros", || {
        let status = peer.status();
        (status["speed"] == json!(0.0) && count(&status, "zeros") > count(&before, "zeros"))
            .then_some(())
    });
    assert!(hung.elapsed() < Duration::from_millis(300), "{hung:?}");
    std::thread::sleep(Duration::from_millis(900));
    let silent = bench.peer.status();
    let zeros = count(&silent, "zeros") - count(&before, "zeros");
    // Half a second of zeros, one in 20 ms.
    assert!((15..=30).contains(&zeros), "{zeros} zeros");
    assert!(silent["silent_s"].as_f64().unwrap() > 0.25, "{silent}");
    // Whoever floods it with requests keeps no stop waiting; and the stop is obeyed once vpcd goes on.
    for _ in 0..30 {
        bench.peer.send("flood arm");
        bench.peer.answer();
    }
    let stop = bench.peer.ask("call stop");
    assert_eq!(stop["success"], json!(false));
    assert!(
        stop["message"]
            .as_str()
            .unwrap()
            .contains("no vpcd obeyed within 1 s"),
        "{stop}"
    );
    bench.vpcd.signal(Signal::CONT);
    bench.diagnosed("vpcd", |status| {
        let message = status["message"].as_str().unwrap_or_default();
        message.starts_with("disarmed: ")
    });
    std::thread::sleep(Duration::from_millis(200));
    assert_eq!(bench.peer.status()["speed"], json!(0.0));

    // A receiver that hung sees by their stamps what is old when it goes on.
    if !bench.peer.set_off(5) {
        return;
    }
    bench.peer.signal(Signal::STOP);
    std::thread::sleep(Duration::from_millis(1500));
    bench.peer.signal(Signal::CONT);
    std::thread::sleep(Duration::from_millis(300));
    let status = bench.peer.status();
    assert!(count(&status, "late") > 0, "{status}");
    assert_eq!(status["speed"], json!(0.0), "{status}");

    // Ended, the gateway sends zeros first, however often it is told so.
    if !bench.peer.set_off(6) {
        return;
    }
    let before = bench.peer.status();
    for signal in [Signal::HUP, Signal::TERM, Signal::INT] {
        bench.gateway.signal(signal);
        std::thread::sleep(Duration::from_millis(20));
    }
    std::thread::sleep(Duration::from_millis(400));
    let after = bench.peer.status();
    assert_eq!(after["speed"], json!(0.0), "{after}");
    assert!(
        count(&after, "zeros") >= count(&before, "zeros") + 5,
        "{after}"
    );
    let ended = bench.gateway.ended();
    assert_eq!(ended.code, Some(0), "{}", ended.stderr);
}
