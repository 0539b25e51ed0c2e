//! `check-bridge`, against bridges that keep the rules and bridges that break one each.

use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use ipc::{Domain, Publisher, Subscriber, now_ns};
use messages::{RobotState, TwistCommand};

use crate::{stderr, stdout, vpcctl};

/// The limit of vx in the paper's scene, m/s.
const LIMIT: f64 = 0.5;

/// What is wrong with a bridge.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Sin {
    None,
    /// It tells nothing.
    Mute,
    /// It carries out nothing.
    Deaf,
    /// It goes on with the last command.
    Forever,
    /// It goes on while the command says that it is valid.
    Trusting,
    /// It obeys commands of lockstep.
    Lockstep,
    /// It obeys commands from the future.
    Future,
    /// It does not cut to the limits.
    Unlimited,
}

/// Carries out commands until `end`.
fn bridge(directory: &Path, sin: Sin, end: &AtomicBool) {
    let domain = Domain::join(directory).unwrap();
    let mut twists: Subscriber<TwistCommand> = domain.subscriber(4).unwrap();
    let mut states: Publisher<RobotState> = domain.publisher().unwrap();
    let mut newest = TwistCommand::zero(messages::TwistState::Stopped);
    while !end.load(Ordering::Relaxed) {
        if let Some(command) = twists.latest().unwrap() {
            newest = command.message;
        }
        let now = now_ns();
        let is_forever = newest.valid_until_ns == u64::MAX;
        let obeys = match sin {
            Sin::Forever => true,
            Sin::Trusting => {
                !is_forever && newest.is_valid_at(now) && newest.stamp.published_ns <= now
            }
            Sin::Lockstep => is_forever || newest.in_force(now) != [0.0; 6],
            Sin::Future => newest.stamp.published_ns > now || newest.in_force(now) != [0.0; 6],
            Sin::Deaf => false,
            _ => newest.in_force(now) != [0.0; 6],
        };
        let mut twist = if obeys { newest.twist } else { [0.0; 6] };
        if sin != Sin::Unlimited {
            twist[0] = twist[0].clamp(-LIMIT, LIMIT);
        }
        let mut state = RobotState::free_camera([0.0, 0.0, 0.5], [0.0; 3], now);
        state.twist = twist;
        if sin != Sin::Mute {
            states.publish(&state).unwrap();
        }
        std::thread::sleep(Duration::from_millis(4));
    }
}

/// What `check-bridge` says of such a bridge.
fn checked(sin: Sin) -> (String, Option<i32>) {
    let directory = tempfile::tempdir().unwrap();
    let scene = directory.path().join("scene.toml");
    std::fs::write(&scene, scene::PAPER_SIM).unwrap();
    let domain = directory.path().join("domain");
    let end = AtomicBool::new(false);
    std::thread::scope(|threads| {
        threads.spawn(|| bridge(&domain, sin, &end));
        let scene = scene.to_str().unwrap();
        let said = vpcctl(&domain, &["check-bridge", "--scene", scene]);
        end.store(true, Ordering::Relaxed);
        assert_eq!(stderr(&said), "");
        (stdout(&said), said.status.code())
    })
}

#[test]
fn each_broken_rule_of_a_bridge_is_named() {
    let failing = |text: &str| -> Vec<String> {
        let lines = text.lines().filter_map(|line| line.strip_prefix("FAIL  "));
        lines
            .map(|line| line.split(' ').next().unwrap().to_owned())
            .collect()
    };
    let expected: [(Sin, &[&str]); 8] = [
        (Sin::None, &[]),
        (Sin::Mute, &["state"]),
        (Sin::Deaf, &["motion", "back"]),
        (
            Sin::Forever,
            &["silence", "long", "expired", "lockstep", "future"],
        ),
        (Sin::Trusting, &["long"]),
        (Sin::Lockstep, &["lockstep"]),
        (Sin::Future, &["future"]),
        (Sin::Unlimited, &["limits"]),
    ];
    let found: Vec<_> = std::thread::scope(|threads| {
        let checks = expected.map(|(sin, _)| threads.spawn(move || checked(sin)));
        checks
            .into_iter()
            .map(|check| check.join().unwrap())
            .collect()
    });
    for ((sin, names), (text, code)) in expected.into_iter().zip(found) {
        assert_eq!(failing(&text), names, "{sin:?}:\n{text}");
        assert_eq!(code, Some(i32::from(!names.is_empty())), "{sin:?}");
    }
}
