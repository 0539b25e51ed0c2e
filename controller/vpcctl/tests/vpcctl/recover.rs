//! `recover`, against a bridge that clears its robot's errors when it is asked, one that cannot,
//! and none. Bridge and command take turns on a clock that no machine delays.

use std::path::Path;
use std::time::Duration;

use ipc::{Domain, RobotPorts, Subscriber};
use messages::{Action, Request, RobotMode, RobotState};
use program::Exit;
use vpcctl::clock::Clock;
use vpcctl::recover::recover;

/// A bridge, and the clock: it does its work while the command waits.
struct Bridge {
    ports: RobotPorts,
    requests: Subscriber<Request>,
    mode: RobotMode,
    /// Whether its robot's errors can be cleared.
    can: bool,
    /// How often it was asked.
    asked: u32,
    now_ns: u64,
}

impl Bridge {
    fn join(directory: &Path, mode: RobotMode, can: bool) -> Self {
        let domain = Domain::join(directory).unwrap();
        Self {
            ports: RobotPorts::open(&domain).unwrap(),
            requests: domain.subscriber(4).unwrap(),
            mode,
            can,
            asked: 0,
            now_ns: ipc::now_ns(),
        }
    }
}

impl Clock for Bridge {
    fn now_ns(&self) -> u64 {
        self.now_ns
    }

    fn pause(&mut self, time: Duration) {
        self.now_ns += time.as_nanos() as u64;
        while let Some(request) = self.requests.oldest().unwrap() {
            if request.action() == Some(Action::Recover) {
                self.asked += 1;
                self.mode = if self.can { RobotMode::Idle } else { self.mode };
            }
        }
        let mut state = RobotState::free_camera([0.0; 3], [0.0; 3], self.now_ns);
        state.mode = self.mode.code();
        self.ports.robot.publish(&state).unwrap();
    }
}

/// What `recover` says of a robot in this mode, and its exit code; how often the bridge was asked.
fn said(mode: RobotMode, can: bool) -> (String, Exit, u32) {
    let directory = tempfile::tempdir().unwrap();
    let mut bridge = Bridge::join(directory.path(), mode, can);
    let time = Duration::from_secs(1);
    let (text, exit) = recover(directory.path(), time, &mut bridge).unwrap();
    (text, exit, bridge.asked)
}

#[test]
fn what_counts_is_what_the_robot_then_tells() {
    let (text, exit, asked) = said(RobotMode::Fault, true);
    assert_eq!(
        text,
        "recover: done; the robot is idle; arm when it may move\n"
    );
    assert_eq!((exit, asked), (Exit::Ok, 1));
    let (text, exit, asked) = said(RobotMode::Fault, false);
    assert!(text.contains("still at fault after 1 s"), "{text}");
    assert_eq!((exit, asked), (Exit::Refused, 1));
}

#[test]
fn a_robot_without_errors_is_left_alone() {
    let (text, exit, asked) = said(RobotMode::Moving, true);
    assert_eq!(text, "recover: nothing to clear; the robot is moving\n");
    assert_eq!((exit, asked), (Exit::Ok, 0));
}

#[test]
fn where_no_robot_tells_its_state_it_is_said() {
    let directory = tempfile::tempdir().unwrap();
    let words = ["recover", "--timeout", "0.1"];
    let said = crate::vpcctl(directory.path(), &words);
    assert_eq!(said.status.code(), Some(4));
    assert!(crate::stderr(&said).contains("nothing on vpc/robot"));
}
