//! `status`.

use crate::stand_in::{Manner, StandIn};
use crate::{stderr, stdout, vpcctl};

#[test]
fn status_tells_what_the_daemon_does_in_text_and_in_json() {
    let directory = tempfile::tempdir().unwrap();
    let _daemon = StandIn::sound(directory.path());
    let output = vpcctl(directory.path(), &["status", "--watch", "0.5"]);
    let text = stdout(&output);
    assert_eq!(output.status.code(), Some(5), "{text}{}", stderr(&output));
    for words in [
        &format!("process {}", std::process::id()),
        "state     disarmed: not armed\n",
        "step      30.0 us",
        "2 overruns, 0 records lost",
        "4 points, 33.0 ms old, error 120.2 px, clearance 25.5 px",
        "real time not asked for; 0 page faults",
        "robot     says nothing",
    ] {
        assert!(text.contains(words), "{words} is missing:\n{text}");
    }
    assert!(
        !text.contains('\x1b'),
        "colours without a terminal:\n{text}"
    );

    vpcctl(directory.path(), &["arm"]);
    let output = vpcctl(directory.path(), &["status", "--json", "--watch", "0.5"]);
    assert_eq!(output.status.code(), Some(0));
    let json: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(json["process"], std::process::id());
    assert_eq!(json["state"], "moving");
    // Its cycles told all: an operator would have cost its loop a connection.
    assert!(json["answered"].is_null(), "{json}");
    assert_eq!(json["cycles"]["total"]["p50_ns"], 35_000);
    assert_eq!(json["cycles"]["twist"][1], -0.2);
    // At most the 100 Hz that its sleeps allow.
    let rate = json["cycles"]["rate_hz"].as_f64().unwrap();
    assert!(rate > 0.0 && rate < 100.5, "{rate}");
}

#[test]
fn lockstep_without_features_answers_without_a_cycle() {
    let directory = tempfile::tempdir().unwrap();
    let manner = Manner {
        answers: true,
        cycles: false,
    };
    let _daemon = StandIn::start(directory.path(), manner);
    let output = vpcctl(directory.path(), &["status", "--watch", "0.3"]);
    let text = stdout(&output);
    assert_eq!(output.status.code(), Some(5), "{text}");
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
    let output = vpcctl(directory.path(), &["status", "--watch", "0.3"]);
    assert_eq!(output.status.code(), Some(4), "{}", stdout(&output));
    assert!(
        stdout(&output).contains("does not answer"),
        "{}",
        stdout(&output)
    );
}
