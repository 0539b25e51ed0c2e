//! Programs in C, compiled with the header and linked with the shared library: layouts, and the
//! examples.

use std::fmt::Write as _;
use std::mem::offset_of;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use ipc::{ControllerPorts, Domain, RecorderPort};
use messages::{
    Action, CycleRecord, DesiredTwist, Encoding, Hold, ImageHeader, Outcome, RealTime, Reply,
    RobotFaults, SERVICES, Stamp, StrategyCode, Struct, TwistCommand, TwistState,
};
use testkit::{Ended, Place, Running, eventually};
use vpcclient::camera::Sent;

/// Steps in which the camera is driven to its goal.
const STEPS: u32 = 30;

/// The shared library, beside this executable.
pub fn library() -> PathBuf {
    let tests = std::env::current_exe().unwrap();
    tests.with_file_name("libvpcclient.so")
}

/// Compiles a source; warnings are errors. With `VPC_LONG=1` it runs under
/// valgrind, which checks each access to memory, those of the library too.
fn compiled(place: &Place, source: &Path) -> Command {
    let library = library();
    assert!(library.exists(), "{} is missing", library.display());
    let program = testkit::c::compiled(place, source, &library);
    let is_checked =
        testkit::is_long() && testkit::are_installed("C programs under valgrind", &["valgrind"]);
    let mut command = match is_checked {
        true => {
            let mut valgrind = testkit::command("valgrind");
            valgrind.args([
                "-q",
                "--error-exitcode=9",
                "--leak-check=full",
                "--show-leak-kinds=definite",
            ]);
            valgrind
                .arg("--errors-for-leak-kinds=definite")
                .arg(program);
            valgrind
        }
        false => testkit::command(program),
    };
    command.stdout(Stdio::piped());
    command
}

fn example(place: &Place, name: &str) -> Command {
    let source = testkit::root().join("ipc/clients/c/examples").join(name);
    let mut command = compiled(place, &source);
    command.arg(place.domain());
    command
}

/// Whether there is a compiler.
fn compiler(test: &str) -> bool {
    testkit::are_installed(test, &["cc=gcc"])
}

/// `RobotState` as `robot_state`.
fn snake(name: &str) -> String {
    let letters = name.char_indices();
    let parts = letters.map(|(i, letter)| match (i, letter.is_uppercase()) {
        (0, _) | (_, false) => letter.to_lowercase().to_string(),
        (_, true) => format!("_{}", letter.to_lowercase()),
    });
    parts.collect()
}

#[test]
fn the_compiler_of_c_has_the_layouts_of_rust() {
    if !compiler("the_compiler_of_c_has_the_layouts_of_rust") {
        return;
    }
    let mut source =
        "#include <stdalign.h>\n#include <stdio.h>\n#include \"vpc.h\"\nint main(void) {\n"
            .to_owned();
    let mut expected = String::new();
    let messages = SERVICES.iter().map(|service| service.message);
    for message in messages.chain([Struct::of::<Stamp>()]) {
        let (name, size) = (format!("vpc_{}", snake(message.name)), message.size);
        let _ = writeln!(
            source,
            "printf(\"{name} %zu %zu\\n\", sizeof({name}), alignof({name}));"
        );
        // Every message has a field of eight bytes.
        let _ = writeln!(expected, "{name} {size} 8");
        for field in message.fields {
            let (field, offset, size) = (field.name, field.offset, field.size);
            let _ = writeln!(
                source,
                "printf(\"{field} %zu %zu\\n\", offsetof({name}, {field}), sizeof((({name} *)0)->{field}));"
            );
            let _ = writeln!(expected, "{field} {offset} {size}");
        }
    }
    source += "printf(\"sent %zu %zu %zu\\n\", sizeof(vpc_sent), offsetof(vpc_sent, sequence), \
               offsetof(vpc_sent, published_ns));\n";
    let (sequence, published_ns) = (offset_of!(Sent, sequence), offset_of!(Sent, published_ns));
    let _ = writeln!(
        expected,
        "sent {} {sequence} {published_ns}",
        size_of::<Sent>()
    );
    for (bits, expected_bits) in [
        ("VPC_ROBOT_FAULTS_PATTERN_LOST", RobotFaults::PATTERN_LOST.0),
        ("VPC_REALTIME_NO_LOCK", RealTime::NO_LOCK.0),
        ("VPC_HOLD_STANDSTILL", Hold::Standstill.code()),
        ("VPC_OUTCOME_SHUTDOWN", Outcome::Shutdown.code()),
    ] {
        let _ = writeln!(source, "printf(\"{bits} %d\\n\", (int){bits});");
        let _ = writeln!(expected, "{bits} {expected_bits}");
    }
    source += "return 0;\n}\n";
    let place = Place::new();
    let source = place.file("layouts.c", source);
    let Ended { code, stdout, .. } = testkit::ended(compiled(&place, &source));
    assert_eq!(code, Some(0));
    for (found, expected) in stdout.lines().zip(expected.lines()) {
        assert_eq!(found, expected, "C first, then Rust");
    }
    assert_eq!(stdout.lines().count(), expected.lines().count());
}

#[test]
fn a_camera_in_c_closes_the_loop() {
    if !compiler("a_camera_in_c_closes_the_loop") {
        return;
    }
    // Straight to the goal, which is at 0.6 m; rolling on the way; along a screw. A twist held for
    // a second.
    for (start, twist) in [
        (
            [0.2, 0.0, 0.7, 0.0, 0.0, 0.0],
            [0.2, 0.0, 0.1, 0.0, 0.0, 0.0],
        ),
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
        closes_the_loop(&place, example(&place, "camera.c"), start, twist);
    }
}

/// `camera.c` starts `start` away from its goal, which a constant twist reaches in [`STEPS`].
pub fn closes_the_loop(place: &Place, mut camera: Command, start: [f64; 6], twist: [f64; 6]) {
    let domain = Domain::join(&place.domain()).unwrap();
    let mut controller = ControllerPorts::open(&domain).unwrap();
    camera
        .arg((STEPS + 1).to_string())
        .args(start.map(|x| x.to_string()));
    let mut camera = Running::start(camera);
    let mut answered = 0;
    eventually("the end of the camera", || {
        if let Some(features) = controller.features.latest().unwrap() {
            // An answer to something else first: the camera must pass over it.
            let other = Stamp {
                published_ns: features.stamp.published_ns - 1,
                ..features.stamp
            };
            let wrong = TwistCommand::answer_to(&other, [9.0; 6], TwistState::Holding);
            controller.twist.publish(&wrong).unwrap();
            let answer = TwistCommand::answer(&features, twist, TwistState::Moving);
            controller.twist.publish(&answer).unwrap();
            answered += 1;
        }
        (!camera.is_running()).then_some(())
    });
    let Ended {
        code, stdout: text, ..
    } = camera.ended();
    let arrived = text.strip_prefix(&format!("{answered} steps, final error "));
    let arrived = arrived.unwrap_or_else(|| panic!("{answered} answers: {text}"));
    let error: f64 = arrived.split(' ').next().unwrap().parse().unwrap();
    // It stops where it is within 2 px, which is at most two steps early.
    assert!(code == Some(0) && error <= 2.0, "{text}");
    assert!((STEPS - 2..=STEPS).contains(&answered), "{text}");
    assert!(text.trim().ends_with("controller moving"), "{text}");
}

#[test]
fn an_observer_in_c_hears_every_cycle() {
    if !compiler("an_observer_in_c_hears_every_cycle") {
        return;
    }
    let place = Place::new();
    let domain = Domain::join(&place.domain()).unwrap();
    let mut recorder = RecorderPort::open(&domain).unwrap();
    let mut command = example(&place, "observer.c");
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
    let mut command = example(&place, "policy.c");
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
    let mut command = example(&place, "image.c");
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
    let mut command = example(&place, "image.c");
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
        let mut command = example(&place, "operator.c");
        command.args(words);
        let operator = Running::start(command);
        let request = eventually("a request", || controller.requests.oldest().unwrap());
        assert_eq!(
            (
                request.action(),
                request.strategy,
                request.neighbours + request.stops
            ),
            (Some(action), strategy, number)
        );
        assert_eq!(request.stops > 0, words == ["arm", "3"]);
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
