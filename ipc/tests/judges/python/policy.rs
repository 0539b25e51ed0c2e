//! `policy.py`: what it publishes of lines and of a gamepad, and what it refuses.

use std::io::Write;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use ipc::{Domain, now_ns};
use messages::{DesiredTwist, Reply};
use testkit::python::Environment;
use testkit::{Ended, Place, Running};

use super::{script, sources};

/// How long the input stays open.
const REST: Duration = Duration::from_secs(1);

/// The program.
fn policy(python: &Path) -> Command {
    let mut policy = script(python, "clients/python/policy.py");
    policy.env("PYTHONPATH", sources("clients/python"));
    policy
}

/// Runs it with these arguments on this input; its end, and what it wanted.
fn wanted(python: &Path, arguments: &[&str], input: &[u8]) -> (Ended, Vec<DesiredTwist>) {
    let place = Place::new();
    let domain = Domain::join(&place.domain()).unwrap();
    let mut controller = domain.subscriber::<DesiredTwist>(64).unwrap();
    let _replies = domain.publisher::<Reply>().unwrap();
    let mut policy = policy(python);
    policy.arg("--domain").arg(place.domain()).args(arguments);
    policy.stdout(Stdio::piped()).stderr(Stdio::piped());
    let (reader, mut writer) = std::io::pipe().unwrap();
    let running = Running::start(policy.stdin(reader));
    writer.write_all(input).unwrap();
    // A gamepad that rests tells nothing, and its twist counts on.
    let (begin, mut seen) = (Instant::now(), Vec::new());
    while begin.elapsed() < REST {
        let messages = std::iter::from_fn(|| controller.oldest().unwrap());
        seen.extend(messages.map(|desired| desired.message));
        std::thread::sleep(Duration::from_millis(1));
    }
    drop((policy, writer));
    let ended = running.ended();
    let rest = std::iter::from_fn(|| controller.oldest().unwrap());
    seen.extend(rest.map(|desired| desired.message));
    (ended, seen)
}

/// An event of a gamepad.
fn event(value: i16, kind: u8, number: u8) -> [u8; 8] {
    let mut event = [0; 8];
    event[4..6].copy_from_slice(&value.to_ne_bytes());
    (event[6], event[7]) = (kind, number);
    event
}

#[test]
fn a_policy_in_python_says_what_it_wants() {
    let Some(python) = Environment::JUDGES.python("a_policy_in_python_says_what_it_wants") else {
        return;
    };
    let place = Place::new();
    let mut alone = policy(&python);
    alone.arg("--domain").arg(place.domain());
    let alone = Running::start(alone.stderr(Stdio::piped())).ended();
    assert_eq!(alone.code, Some(1), "{alone:?}");
    assert!(
        alone.stderr.contains("start vpcd in this domain"),
        "{alone:?}"
    );
    let (ended, seen) = wanted(&python, &[], b"0.1 0 -0.2 0 0 0.5\n1 2 3 4 5 6\n");
    assert_eq!(ended.code, Some(0), "{ended:?}");
    let twists: Vec<_> = seen.iter().map(|desired| desired.twist).collect();
    assert_eq!(
        twists,
        [
            [0.1, 0.0, -0.2, 0.0, 0.0, 0.5],
            [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]
        ]
    );
    for desired in &seen {
        let valid_ns = desired.valid_until_ns - desired.stamp.published_ns;
        assert!((1..=200_000_000).contains(&valid_ns), "{valid_ns}");
        assert!(desired.stamp.published_ns < now_ns());
    }
    for (line, word) in [("1 2 3\n", "line 1 is '1 2 3'"), ("1 2 3 4 5 nan\n", "nan")] {
        let (ended, seen) = wanted(&python, &[], line.as_bytes());
        assert_eq!((ended.code, seen.len()), (Some(1), 0), "{ended:?}");
        assert!(ended.stderr.contains(word), "{ended:?}");
    }
    let (ended, _) = wanted(&python, &["--valid", "0.6"], b"");
    assert_eq!(ended.code, Some(2), "{ended:?}");
    assert!(
        ended.stderr.contains("allowed: above 0, up to 0.5"),
        "{ended:?}"
    );
    // The left stick to the right, the right trigger pulled, a shoulder button; then it rests.
    let events = [event(32767, 2, 0), event(32767, 2, 5), event(1, 1, 5)].concat();
    let pad = ["--pad", "/dev/stdin", "--linear", "0.2", "--angular", "0.4"];
    let (ended, seen) = wanted(&python, &pad, &events);
    assert_eq!(ended.code, Some(0), "{ended:?}");
    let last = seen.last().unwrap();
    assert_eq!(last.twist, [0.2, 0.0, 0.2, 0.0, 0.0, 0.4]);
    assert!(seen.len() > 10, "{}", seen.len());
}
