//! `status` and `watch`. What they say of each state, `controller/vpcctl/src/status/mod.rs` tests.

use ipc::{Domain, RecorderPort};
use messages::{Action, Request};
use program::Exit;
use vpcctl::status::Status;
use vpcctl::watcher::Watcher;

use crate::stand_in::{Law, Manner, StandIn};
use crate::{stderr, stdout, vpcctl};

#[test]
fn status_tells_what_the_daemon_does_in_text_and_in_json() {
    let directory = tempfile::tempdir().unwrap();
    let domain = Domain::join(directory.path()).unwrap();
    let mut port = RecorderPort::open(&domain).unwrap();
    let mut watcher = Watcher::open(directory.path()).unwrap();
    let (mut status, mut law) = (Status::new(&watcher), Law::default());
    let mut watch = |law: &mut Law, status: &mut Status| {
        for _ in 0..20 {
            port.cycles.publish(&law.cycle()).unwrap();
        }
        status.update(&mut watcher).unwrap();
    };
    watch(&mut law, &mut status);
    assert_eq!(status.exit(), Exit::Disarmed);
    let text = status.text(false);
    for words in [
        "state     disarmed: not armed\n",
        "step      30.0 us",
        "2 overruns, 0 records lost",
        "4 points, 33.0 ms old, error 120.2 px, clearance 25.5 px",
        "real time not asked for; 0 page faults",
        "robot     says nothing",
    ] {
        assert!(text.contains(words), "{words} is missing:\n{text}");
    }
    assert!(!text.contains('\x1b'), "colours:\n{text}");

    law.answer(&Request::new(1, Action::Arm));
    watch(&mut law, &mut status);
    assert_eq!(status.exit(), Exit::Ok);
    let json = status.json();
    assert_eq!(json["state"], "moving");
    // Its cycles told all: an operator would have cost its loop a connection.
    assert!(json["answered"].is_null(), "{json}");
    assert_eq!(json["cycles"]["watched"], 40);
    assert_eq!(json["cycles"]["total"]["p50_ns"], 35_000);
    assert_eq!(json["cycles"]["twist"][1], -0.2);
    assert!(json["cycles"]["rate_hz"].as_f64().unwrap() > 0.0, "{json}");
}

#[test]
fn lockstep_without_features_answers_without_a_cycle() {
    let reply = Law::default().answer(&Request::new(1, Action::Status));
    let mut status = Status::default();
    (status.answered, status.reply) = (Some(true), Some(reply));
    assert_eq!(status.exit(), Exit::Disarmed);
    let text = status.text(false);
    assert!(
        text.contains("disarmed: not armed") && text.contains("none came"),
        "{text}"
    );
}

#[test]
fn a_hanging_daemon_is_seen() {
    let directory = tempfile::tempdir().unwrap();
    let manner = Manner {
        answers: false,
        cycles: false,
    };
    let _daemon = StandIn::start(directory.path(), manner);
    let output = vpcctl(directory.path(), &["status", "--watch", "0.1"]);
    let text = stdout(&output);
    assert_eq!(output.status.code(), Some(4), "{text}");
    let process = format!("process {}", std::process::id());
    assert!(
        text.contains("does not answer") && text.contains(&process),
        "{text}"
    );
}

#[test]
fn without_a_terminal_status_is_recommended() {
    let directory = tempfile::tempdir().unwrap();
    let _daemon = StandIn::sound(directory.path());
    let output = vpcctl(directory.path(), &["watch"]);
    assert_eq!(output.status.code(), Some(64));
    assert!(
        stderr(&output).contains("vpcctl status"),
        "{}",
        stderr(&output)
    );
}
