//! A bridge that hangs, and commands in force when it begins: a robot in real time stops by itself.

use std::process::Stdio;
use std::time::Duration;

use ipc::{Domain, Publisher, Subscriber, now_ns};
use messages::{Action, Request, RobotMode, RobotState, TwistCommand, TwistState};
use rustix::process::Signal;
use testkit::{Running, eventually};

use crate::robot::Robot;

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
    let robot = Robot::start("fixed", 5, "");
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
    let robot = Robot::start("fixed", 5, "");
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

#[test]
fn a_reflex_in_a_first_motion_ends_it_and_is_named() {
    let robot = Robot::start("fixed", 5, "");
    let mut bridge = robot.bridge("panda");
    bridge.args(["--first-motion", "--yes"]);
    let bridge = Running::start(bridge.stdout(Stdio::piped()).stderr(Stdio::piped()));
    std::thread::sleep(Duration::from_secs(3));
    bridge.signal(Signal::STOP);
    std::thread::sleep(Duration::from_millis(100));
    bridge.signal(Signal::CONT);
    let said = bridge.ended();
    assert_eq!(said.code, Some(69), "{said:?}");
    let lost = "communication_constraints_violation";
    assert!(said.stderr.contains(lost), "{said:?}");
    assert!(!said.stdout.contains("vpcctl arm"), "{said:?}");
}
