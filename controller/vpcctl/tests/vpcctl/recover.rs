//! `recover`, against a bridge that clears its robot's errors when it is asked, one that cannot,
//! and none.

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use ipc::{Domain, RobotPorts, Subscriber, now_ns};
use messages::{Action, Request, RobotMode, RobotState};

use crate::{stderr, stdout, vpcctl};

/// What `recover` says of a robot in this mode, whose errors `can` be cleared, and its exit code;
/// how often the bridge was asked.
fn said(mode: RobotMode, can: bool) -> (String, Option<i32>, u32) {
    let directory = tempfile::tempdir().unwrap();
    let end = AtomicBool::new(false);
    std::thread::scope(|scope| {
        let bridge = scope.spawn(|| {
            let domain = Domain::join(directory.path()).unwrap();
            let mut ports = RobotPorts::open(&domain).unwrap();
            let mut requests: Subscriber<Request> = domain.subscriber(16).unwrap();
            let (mut mode, mut asked) = (mode, 0);
            while !end.load(Ordering::Relaxed) {
                while let Some(request) = requests.oldest().unwrap() {
                    if request.action() == Some(Action::Recover) {
                        asked += 1;
                        mode = if can { RobotMode::Idle } else { mode };
                    }
                }
                let mut state = RobotState::free_camera([0.0; 3], [0.0; 3], now_ns());
                state.mode = mode.code();
                ports.robot.publish(&state).unwrap();
                std::thread::sleep(Duration::from_millis(5));
            }
            asked
        });
        let domain = directory.path();
        let said = vpcctl(domain, &["recover", "--timeout", "1"]);
        end.store(true, Ordering::Relaxed);
        let text = stdout(&said) + &stderr(&said);
        (text, said.status.code(), bridge.join().unwrap())
    })
}

#[test]
fn what_counts_is_what_the_robot_then_tells() {
    let (text, exit, asked) = said(RobotMode::Fault, true);
    assert_eq!(
        text,
        "recover: done; the robot is idle; arm when it may move\n"
    );
    assert_eq!((exit, asked), (Some(0), 1));
    let (text, exit, asked) = said(RobotMode::Fault, false);
    assert!(text.contains("still at fault after 1 s"), "{text}");
    assert_eq!((exit, asked), (Some(2), 1));
}

#[test]
fn a_robot_without_errors_is_left_alone() {
    let (text, exit, asked) = said(RobotMode::Moving, true);
    assert_eq!(text, "recover: nothing to clear; the robot is moving\n");
    assert_eq!((exit, asked), (Some(0), 0));
}

#[test]
fn where_no_robot_tells_its_state_it_is_said() {
    let directory = tempfile::tempdir().unwrap();
    let domain = directory.path();
    let said = vpcctl(domain, &["recover", "--timeout", "0.2"]);
    assert_eq!(said.status.code(), Some(4));
    assert!(stderr(&said).contains("nothing on vpc/robot"));
}
