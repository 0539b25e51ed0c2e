//! `check-bridge`, against bridges that keep the rules and bridges that break one each. Bridge and
//! check take turns on a clock that no machine delays.

use std::path::Path;
use std::time::Duration;

use ipc::{Domain, Publisher, Subscriber};
use messages::{RobotState, TwistCommand};
use program::Exit;
use vpcctl::check_bridge::{CheckBridgeArguments, check};
use vpcctl::clock::Clock;

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

/// A bridge, and the clock: it does its work while the check waits.
struct Bridge {
    sin: Sin,
    twists: Subscriber<TwistCommand>,
    states: Publisher<RobotState>,
    newest: TwistCommand,
    sequence: u64,
    now_ns: u64,
}

/// Between two states of the robot, ns.
const PERIOD_NS: u64 = 4_000_000;

impl Bridge {
    fn join(directory: &Path, sin: Sin) -> Self {
        let domain = Domain::join(directory).unwrap();
        Self {
            sin,
            twists: domain.subscriber(4).unwrap(),
            states: domain.publisher().unwrap(),
            newest: TwistCommand::zero(messages::TwistState::Stopped),
            sequence: 0,
            now_ns: ipc::now_ns(),
        }
    }

    /// Carries out the newest command, and tells so.
    fn work(&mut self) {
        if let Some(command) = self.twists.latest().unwrap() {
            self.newest = command.message;
        }
        let (newest, now) = (&self.newest, self.now_ns);
        let is_forever = newest.valid_until_ns == u64::MAX;
        let obeys = match self.sin {
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
        if self.sin != Sin::Unlimited {
            twist[0] = twist[0].clamp(-LIMIT, LIMIT);
        }
        let mut state = RobotState::free_camera([0.0, 0.0, 0.5], [0.0; 3], now);
        state.twist = twist;
        self.sequence += 1;
        (state.stamp.sequence, state.stamp.published_ns) = (self.sequence, now);
        if self.sin != Sin::Mute {
            self.states.publish_verbatim(&state).unwrap();
        }
    }
}

impl Clock for Bridge {
    fn now_ns(&self) -> u64 {
        self.now_ns
    }

    fn pause(&mut self, time: Duration) {
        let end_ns = self.now_ns + time.as_nanos() as u64;
        while self.now_ns < end_ns {
            let next_ns = (self.now_ns + 1).next_multiple_of(PERIOD_NS);
            self.now_ns = next_ns.min(end_ns);
            if self.now_ns == next_ns {
                self.work();
            }
        }
    }
}

/// What `check-bridge` says of such a bridge.
fn checked(sin: Sin) -> (String, Exit) {
    let directory = tempfile::tempdir().unwrap();
    let scene = directory.path().join("scene.toml");
    std::fs::write(&scene, scene::PAPER_SIM).unwrap();
    let domain = directory.path().join("domain");
    let mut bridge = Bridge::join(&domain, sin);
    let arguments = CheckBridgeArguments {
        scene,
        speed: 0.1,
        stopping: Duration::from_millis(300),
    };
    check(&domain, &arguments, &mut bridge).unwrap()
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
    for (sin, names) in expected {
        let (text, exit) = checked(sin);
        assert_eq!(failing(&text), names, "{sin:?}:\n{text}");
        let expected = if names.is_empty() {
            Exit::Ok
        } else {
            Exit::Attention
        };
        assert_eq!(exit, expected, "{sin:?}");
    }
}
