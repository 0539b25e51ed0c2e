//! The bridge at work: it looks without moving, carries out twists without allocating, and ends
//! with an arm that stands.

use std::process::Stdio;
use std::time::Duration;

use ipc::{Domain, Publisher, Subscriber, now_ns};
use messages::{Action, Request, RobotMode, RobotState, TwistCommand, TwistState};
use rustix::process::Signal;
use testkit::{Running, ended, eventually};

use crate::Robot;

#[test]
fn a_dry_run_and_a_preflight_look_and_move_nothing() {
    let robot = Robot::start(5, "");
    let said = ended(robot.bridge("panda").arg("--dry-run"));
    assert_eq!(said.code, Some(0), "{said:?}");
    for words in [
        "O_T_EE",
        "F_T_camera",
        "would be sent: joint velocities",
        "nothing was sent",
    ] {
        assert!(said.stdout.contains(words), "{words}: {said:?}");
    }
    let said = ended(robot.bridge("panda").arg("--preflight"));
    for words in [
        "kernel",
        "priority",
        "states",
        "commands in time",
        "filter",
        "load",
    ] {
        assert!(said.stdout.contains(words), "{words}: {said:?}");
    }
    // A zero velocity, for two seconds.
    assert!(robot.report().contains("\"joint_velocity\":0.0"));
}

#[test]
fn another_version_is_refused_by_name() {
    let robot = Robot::start(5, "");
    let said = ended(&mut robot.bridge("fr3"));
    assert_eq!(said.code, Some(69), "{said:?}");
    assert!(
        said.stderr
            .contains("server version: 5, library version: 10"),
        "{said:?}"
    );
}

#[test]
fn twists_are_carried_out_without_an_allocation() {
    for (version, name, interface) in [(5, "panda", "joint"), (10, "fr3", "cartesian")] {
        let robot = Robot::start(version, "");
        let domain = Domain::join(&robot.place.domain()).unwrap();
        let mut twists: Publisher<TwistCommand> = domain.publisher().unwrap();
        let mut states: Subscriber<RobotState> = domain.subscriber(1).unwrap();
        let mut bridge = robot.bridge(name);
        bridge.args(["--interface", interface]);
        let bridge = Running::start(bridge.stderr(std::process::Stdio::piped()));
        eventually("a state", || states.latest().unwrap());
        let mut command = TwistCommand::zero(TwistState::Moving);
        command.twist = [0.008, -0.006, 0.0, 0.0, 0.0, 0.03];
        let mut say = |command: &TwistCommand| {
            let until = now_ns() + 100_000_000;
            twists
                .publish(&TwistCommand {
                    valid_until_ns: until,
                    ..*command
                })
                .unwrap();
            std::thread::sleep(Duration::from_millis(33));
        };
        // The arm stands until it hears of a zero twist.
        (0..20).for_each(|_| say(&TwistCommand::zero(TwistState::Stopped)));
        (0..90).for_each(|_| say(&command));
        let told = states.latest().unwrap().unwrap();
        assert_eq!(told.mode(), Some(RobotMode::Moving), "{told:?}");
        let apart = std::iter::zip(told.twist, command.twist).map(|(a, b)| (a - b).abs());
        assert!(
            apart.fold(0.0, f64::max) < 1e-3,
            "{interface}: {:?}",
            told.twist
        );
        let said = bridge.terminated();
        assert_eq!(said.code, Some(0), "{said:?}");
        assert!(said.stderr.contains("allocations=0"), "{said:?}");
        assert!(said.stderr.contains("the arm stands"), "{said:?}");
        let report = robot.report();
        for words in [
            "\"reflexes\":0",
            "\"limit_violations\":0",
            "\"discontinuities\":0",
        ] {
            assert!(report.contains(words), "{interface}: {report}");
        }
    }
}

/// A bridge, and who commands it.
struct Bench {
    bridge: Running,
    twists: Publisher<TwistCommand>,
    states: Subscriber<RobotState>,
    requests: Publisher<Request>,
    command: TwistCommand,
}

impl Bench {
    /// The bridge listens for 100 ms before its motion begins: the first commands are heard by
    /// then.
    fn new(robot: &Robot, twist: [f64; 6]) -> Self {
        let domain = Domain::join(&robot.place.domain()).unwrap();
        let mut bridge = robot.bridge("panda");
        let bridge = Running::start(bridge.stderr(Stdio::piped()));
        let mut bench = Self {
            bridge,
            twists: domain.publisher().unwrap(),
            states: domain.subscriber(1).unwrap(),
            requests: domain.publisher().unwrap(),
            command: TwistCommand::zero(TwistState::Moving),
        };
        bench.command.twist = twist;
        bench
    }

    /// The newest state after so many frames with this command.
    fn after(&mut self, frames: u32) -> RobotState {
        for _ in 0..frames {
            self.command.valid_until_ns = now_ns() + 100_000_000;
            self.twists.publish(&self.command).unwrap();
            std::thread::sleep(Duration::from_millis(33));
        }
        eventually("a state", || self.states.latest().unwrap()).message
    }

    fn ask(&mut self, action: Action) {
        self.requests.publish(&Request::new(7, action)).unwrap();
    }

    /// The bridge hangs for so long that the robot stops itself.
    fn hang(&self) {
        self.bridge.signal(Signal::STOP);
        std::thread::sleep(Duration::from_millis(100));
        self.bridge.signal(Signal::CONT);
    }
}

const WAY: [f64; 6] = [0.0, 0.0, 0.0, 0.0, 0.0, 0.02];

#[test]
fn a_command_in_force_at_the_start_waits_for_a_zero() {
    let robot = Robot::start(5, "");
    let mut bench = Bench::new(&robot, WAY);
    let told = bench.after(60);
    assert_eq!(told.mode(), Some(RobotMode::Stale));
    assert!(told.dq.iter().all(|v| v.abs() < 1e-6), "{told:?}");
    bench.command.twist = [0.0; 6];
    bench.after(5);
    bench.command.twist = WAY;
    let told = bench.after(30);
    assert!(told.dq[6].abs() > 0.005, "{told:?}");
}

#[test]
fn a_recovery_counts_only_after_the_reflex() {
    let robot = Robot::start(5, "");
    let mut bench = Bench::new(&robot, [0.0; 6]);
    bench.after(30);
    bench.command.twist = WAY;
    bench.after(10);
    // In the motion, long before, and right before.
    bench.ask(Action::Recover);
    bench.after(45);
    bench.ask(Action::Recover);
    bench.hang();
    let told = bench.after(60);
    assert_eq!(told.mode(), Some(RobotMode::Fault), "{told:?}");
    bench.ask(Action::Recover);
    let told = bench.after(60);
    // The command stood all the time: it is not obeyed.
    assert_eq!(told.mode(), Some(RobotMode::Stale), "{told:?}");
    assert!(told.dq[6].abs() < 1e-6, "{told:?}");

    // SIGTERM at a robot with errors is no clean end.
    bench.hang();
    assert_eq!(bench.after(30).mode(), Some(RobotMode::Fault));
    let said = bench.bridge.terminated();
    assert_eq!(said.code, Some(1), "{said:?}");
    assert!(said.stderr.contains("mode Reflex"), "{said:?}");
}
