//! The bridge at work: it looks without moving, carries out twists without allocating, and ends with
//! an arm that stands.

use std::time::Duration;

use ipc::{Domain, Publisher, RobotMode, RobotState, Subscriber, TwistCommand, TwistState, now_ns};
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
fn twists_are_carried_out_without_an_allocation_and_sigterm_brings_the_arm_to_rest() {
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
