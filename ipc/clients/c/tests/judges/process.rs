//! The examples in C, under valgrind.

use std::path::Path;
use std::process::{Command, Stdio};

use ipc::{ControllerPorts, Domain, RecorderPort};
use messages::{
    Action, CycleRecord, DesiredTwist, Encoding, Hold, ImageHeader, Outcome, Reply, Stamp,
    StrategyCode, TwistState,
};
use testkit::{Ended, Place, Running, eventually};

use crate::program::{closes_the_loop, compiler, example};

/// Runs a program under valgrind, which checks each access to memory, those of the library too.
fn checked(program: &Path) -> Command {
    if !testkit::are_installed("C programs under valgrind", &["valgrind"]) {
        return testkit::command(program);
    }
    let mut valgrind = testkit::command("valgrind");
    valgrind.args([
        "-q",
        "--error-exitcode=9",
        "--leak-check=full",
        "--show-leak-kinds=definite",
        "--errors-for-leak-kinds=definite",
    ]);
    valgrind.arg(program);
    valgrind
}

/// An example in the domain of a place.
fn talking(place: &Place, name: &str) -> Command {
    let mut command = checked(&example(place, name));
    command.arg(place.domain()).stdout(Stdio::piped());
    command
}

#[test]
fn a_camera_in_c_rolls_and_follows_a_screw() {
    if !compiler("a_camera_in_c_rolls_and_follows_a_screw") {
        return;
    }
    // Rolling on the way to the goal, which is at 0.6 m; along a screw. A twist held for a second.
    for (start, twist) in [
        (
            [0.0, 0.0, 0.7, 0.0, 0.0, 0.5],
            [0.0, 0.0, 0.1, 0.0, 0.0, 0.5],
        ),
        // Sideways while it rolls, fast enough that a motion which is exact for neither is told.
        (
            [
                0.5 * 1_f64.sin(),
                0.5 * (1.0 - 1_f64.cos()),
                0.6,
                0.0,
                0.0,
                1.0,
            ],
            [0.5, 0.0, 0.0, 0.0, 0.0, 1.0],
        ),
    ] {
        let place = Place::new();
        closes_the_loop(&place, checked(&example(&place, "camera.c")), start, twist);
    }
}

#[test]
fn an_observer_in_c_hears_every_cycle() {
    if !compiler("an_observer_in_c_hears_every_cycle") {
        return;
    }
    let place = Place::new();
    let domain = Domain::join(&place.domain()).unwrap();
    let mut recorder = RecorderPort::open(&domain).unwrap();
    let mut command = talking(&place, "observer.c");
    command.args(["3", "20"]);
    let mut observer = Running::start(command);
    observer.line("watching");
    let record = |cycle: u64| CycleRecord {
        cycle,
        state: TwistState::Braking.code(),
        hold: Hold::RobotLost.code(),
        strategy: StrategyCode::Gpr.code(),
        step_ns: 1500 * cycle,
        error_px: 12.25,
        twist: [0.5, -0.25, 0.0, 1.0, 0.0, 1e-3],
        ..CycleRecord::default()
    };
    for cycle in [7, 8, 9] {
        if cycle == 9 {
            recorder.cycles.skip();
        }
        recorder.cycles.publish(&record(cycle)).unwrap();
    }
    let Ended { code, stdout, .. } = observer.ended();
    let said: Vec<&str> = stdout.lines().collect();
    assert_eq!(
        said[2],
        "cycle 8: braking, robot silent, gpr, law 12.0 us, error 12.25 px, twist 0.5 -0.25 0 1 0 0.001"
    );
    assert_eq!(said[4], "3 cycles, 1 missed, slowest law 13.5 us");
    assert_eq!(code, Some(0));
}

#[test]
fn a_policy_in_c_wants_twists() {
    if !compiler("a_policy_in_c_wants_twists") {
        return;
    }
    let place = Place::new();
    let domain = Domain::join(&place.domain()).unwrap();
    let mut controller = domain.subscriber::<DesiredTwist>(8).unwrap();
    let mut command = talking(&place, "policy.c");
    command.arg("0.5");
    let policy = Running::start(command);
    let mut seen = Vec::new();
    for number in 0..5 {
        let next = || controller.oldest().unwrap();
        let desired = eventually("a wanted twist", next).message;
        let valid_ns = desired.valid_until_ns - desired.stamp.published_ns;
        assert!((1..=200_000_000).contains(&valid_ns), "{valid_ns}");
        let expected = 0.05 * (0.1 * f64::from(number)).sin();
        assert!((desired.twist[0] - expected).abs() < 1e-12, "{desired:?}");
        seen.push(desired.stamp.published_ns);
    }
    assert!(seen.is_sorted());
    let Ended { code, stdout, .. } = policy.ended();
    assert_eq!((code, &*stdout), (Some(0), "5 twists were wanted\n"));
}

#[test]
fn images_go_from_c_to_rust_and_back() {
    if !compiler("images_go_from_c_to_rust_and_back") {
        return;
    }
    let place = Place::new();
    let domain = Domain::join(&place.domain()).unwrap();
    let mut subscriber = domain.image_subscriber().unwrap();
    let mut command = talking(&place, "image.c");
    command.args(["send", "20"]);
    let mut camera = Running::start(command);
    let mut images = 0;
    eventually("the end of the camera", || {
        if let Some(image) = subscriber.latest().unwrap() {
            let ImageHeader {
                stamp,
                exposure_begin_ns,
                exposure_ns,
                ..
            } = *image.header();
            assert_eq!(stamp.data_ns, exposure_begin_ns + exposure_ns / 2);
            let left = 8 * (stamp.sequence as usize - 1);
            for row in image.rows() {
                let white = row.iter().enumerate().filter(|(_, grey)| **grey == 255);
                assert!(white.map(|(k, _)| k).eq(left..left + 32));
            }
            images += 1;
        }
        (!camera.is_running()).then_some(())
    });
    let Ended { code, stdout, .. } = camera.ended();
    assert_eq!((code, stdout.trim()), (Some(0), "20 images sent"));
    assert!(images > 10, "{images}");

    let mut publisher = domain.image_publisher(48).unwrap();
    let mut command = talking(&place, "image.c");
    command.args(["watch", "2", "20"]);
    let mut observer = Running::start(command);
    observer.line("watching");
    let mut header = ImageHeader::new(3, 4, Encoding::Rgb8, 5);
    (header.stride, header.exposure_ns) = (12, 5_500_000);
    let mut send = |grey, sequence| {
        let mut image = publisher.loan(&header).unwrap();
        image.fill(200);
        image.chunks_mut(12).for_each(|row| row[..9].fill(grey));
        image.header_mut().stamp.sequence = sequence;
        publisher.publish_verbatim(image).unwrap();
    };
    send(7, 1);
    observer.line("image 1: 3 x 4 rgb8, exposed for 5.5 ms, mean 7.00");
    send(9, 4);
    observer.line("image 4: 3 x 4 rgb8, exposed for 5.5 ms, mean 9.00");
    let Ended { code, stdout, .. } = observer.ended();
    assert_eq!(code, Some(0));
    assert_eq!(stdout.lines().last(), Some("2 images, 2 missed"));
}

#[test]
fn an_operator_in_c_is_heard_and_told() {
    if !compiler("an_operator_in_c_is_heard_and_told") {
        return;
    }
    let place = Place::new();
    let domain = Domain::join(&place.domain()).unwrap();
    let mut controller = ControllerPorts::open(&domain).unwrap();
    for (words, action, strategy, number, outcome) in [
        (&["arm"][..], Action::Arm, 0, 0, Outcome::NoFeatures),
        (&["arm", "3"], Action::Arm, 0, 3, Outcome::Done),
        (&["stop"], Action::Stop, 0, 0, Outcome::Done),
        (
            &["knn", "5"],
            Action::Strategy,
            StrategyCode::Knn.code(),
            5,
            Outcome::Done,
        ),
    ] {
        let mut command = talking(&place, "operator.c");
        command.args(words);
        let operator = Running::start(command);
        let request = eventually("a request", || controller.requests.oldest().unwrap());
        assert_eq!(
            (
                request.action(),
                request.strategy,
                request.neighbours + request.veto
            ),
            (Some(action), strategy, number)
        );
        assert_eq!(request.veto > 0, words == ["arm", "3"]);
        let reply = Reply {
            stamp: Stamp::default(),
            // To somebody else first: it must be passed over.
            id: !request.id,
            cycle: 0,
            action: request.action,
            outcome: Outcome::Shutdown.code(),
            state: TwistState::Disarmed.code(),
            hold: Hold::NotArmed.code(),
            strategy: StrategyCode::Gpr.code(),
            neighbours: 0,
            ..Reply::default()
        };
        controller.replies.publish(&reply).unwrap();
        let (id, outcome_code) = (request.id, outcome.code());
        let reply = Reply {
            id,
            outcome: outcome_code,
            ..reply
        };
        controller.replies.publish(&reply).unwrap();
        let Ended {
            code, stdout: text, ..
        } = operator.ended();
        assert_eq!(
            text.trim(),
            format!("{outcome}; now disarmed (not armed), gpr")
        );
        assert_eq!(code == Some(0), outcome == Outcome::Done);
    }
}
