//! The service stop, while something goes on commanding motion.

use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use ipc::{Domain, StopFile};
use messages::{TwistCommand, TwistState};
use rustix::process::Signal;
use serde_json::{Value, json};
use testkit::eventually;

use crate::bench::{Bench, Peer, Via};

/// Between two commands, and how long each is in force.
const PERIOD: Duration = Duration::from_millis(20);
const VALID_NS: u64 = 80_000_000;

/// In the place of a vpcd that obeys nothing: commands motion until the end.
fn command(domain: &Path, is_over: &AtomicBool) {
    let domain = Domain::join(domain).unwrap();
    let mut port = eventually("the place of vpcd", || {
        domain.publisher::<TwistCommand>().ok()
    });
    while !is_over.load(Ordering::Relaxed) {
        let mut twist =
            TwistCommand::zero(TwistState::Moving).valid_until(ipc::now_ns() + VALID_NS);
        twist.twist[0] = 0.01;
        port.publish(&twist).unwrap();
        port.refresh().unwrap();
        std::thread::sleep(PERIOD);
    }
}

fn moves(peer: &mut Peer) {
    eventually("motion", || {
        (peer.status()["speed"] != json!(0.0)).then_some(())
    });
}

fn stands(bench: &mut Bench) {
    let only_zeros = |status: &Value| {
        let message = status["message"].as_str().unwrap_or_default();
        message.contains("a stop is in force: only zeros are sent")
    };
    bench.diagnosed("gateway", only_zeros);
    for _ in 0..20 {
        let status = bench.peer.status();
        assert_eq!(status["speed"], json!(0.0), "{status}");
    }
}

#[test]
fn only_zeros_go_out_until_a_stop_is_obeyed() {
    let Some(mut bench) = Bench::new("stop", Via::Dds, false) else {
        return;
    };
    // vpcd itself, while it moves and while it is flooded with other requests.
    if !bench.peer.set_off(7) {
        return;
    }
    for _ in 0..30 {
        bench.peer.ask("flood disarm");
    }
    let stopped = bench.peer.ask("call stop");
    assert_eq!(stopped["success"], json!(true), "{stopped}");
    if !bench.peer.set_off(7) {
        return;
    }
    let stopped = bench.peer.ask("call stop");
    assert_eq!(stopped["message"], json!("stopped"));
    assert!(stopped["seconds"].as_f64().unwrap() < 1.0, "{stopped}");
    bench.diagnosed("vpcd", |status| status["message"] == "disarmed: operator");

    bench.vpcd.signal(Signal::KILL);
    let domain = bench.place.domain();
    let is_over = AtomicBool::new(false);
    std::thread::scope(|scope| {
        scope.spawn(|| command(&domain, &is_over));
        let result = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| {
            moves(&mut bench.peer);
            let stop = bench.peer.ask("call stop");
            assert_eq!(stop["success"], json!(false), "{stop}");
            stands(&mut bench);
            let mut file = StopFile::open(&domain).unwrap();
            assert!(file.is_asked());
            file.obey();
            moves(&mut bench.peer);
            // A request that cannot be read, as of a client of another middleware.
            bench.peer.ask("raw_stop");
            bench
                .gateway
                .line("a stop cannot be answered: its request is of another middleware");
            stands(&mut bench);
            assert!(file.is_asked());
        }));
        is_over.store(true, Ordering::Relaxed);
        if let Err(panic) = result {
            std::panic::resume_unwind(panic);
        }
    });
}
