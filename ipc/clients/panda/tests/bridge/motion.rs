//! The bridge at work: it looks without moving, carries out twists without allocating, and ends
//! with an arm that stands.

use std::process::Stdio;
use std::time::Duration;

use ipc::{Domain, Publisher, Subscriber, now_ns};
use messages::{RobotState, TwistCommand, TwistState};
use testkit::{Running, ended, eventually};

use crate::robot::Robot;

#[test]
fn a_dry_run_and_a_preflight_look_and_move_nothing() {
    let robot = Robot::start("lockstep", 5, "");
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
    let robot = Robot::start("lockstep", 5, "");
    let said = ended(&mut robot.bridge("fr3"));
    assert_eq!(said.code, Some(69), "{said:?}");
    let words = "server version: 5, library version: 10";
    assert!(said.stderr.contains(words), "{said:?}");
}

#[test]
fn twists_are_carried_out_without_an_allocation() {
    for (version, name, interface) in [(5, "panda", "joint"), (10, "fr3", "cartesian")] {
        let robot = Robot::start("lockstep", version, "");
        let domain = Domain::join(&robot.place.domain()).unwrap();
        let mut twists: Publisher<TwistCommand> = domain.publisher().unwrap();
        let mut states: Subscriber<RobotState> = domain.subscriber(1).unwrap();
        let mut bridge = robot.bridge(name);
        bridge.args(["--interface", interface]);
        let mut bridge = Running::start(bridge.stderr(Stdio::piped()));
        bridge.line("the robot follows vpc/twist");
        let mut command = TwistCommand::zero(TwistState::Moving);
        command.twist = [0.008, -0.006, 0.0, 0.0, 0.0, 0.03];
        // The arm moves as commanded once its ramps are over, however late either process is.
        eventually("the motion that is commanded", || {
            command.valid_until_ns = now_ns() + 100_000_000;
            twists.publish(&command).unwrap();
            std::thread::sleep(Duration::from_millis(1));
            let told = states.latest().unwrap()?;
            let apart = std::iter::zip(told.twist, command.twist).map(|(a, b)| (a - b).abs());
            (apart.fold(0.0, f64::max) < 1e-3).then_some(())
        });
        let said = bridge.terminated();
        assert_eq!(said.code, Some(0), "{said:?}");
        assert!(said.stderr.contains("allocations=0"), "{said:?}");
        assert!(said.stderr.contains("lost=0"), "{said:?}");
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
