//! Programs in C, compiled with the header and linked with the shared library: layouts, and the three examples.

use std::fmt::Write as _;
use std::io::{BufRead, BufReader, Read, Write as _};
use std::mem::offset_of;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use ipc::{
    Action, ControllerPorts, CycleRecord, Domain, Hold, Outcome, RealTime, RecorderPort, Reply,
    RobotFaults, SERVICES, Stamp, StrategyCode, Struct, TwistCommand, TwistState,
};
use vpcclient::camera::Sent;

/// Steps in which the camera is driven to its goal.
const STEPS: u32 = 30;
/// Longest wait for anything.
const PATIENCE: Duration = Duration::from_secs(20);

/// A process that ends with its owner.
struct Running(Child);

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

impl Running {
    fn start(mut command: Command) -> Self {
        Self(command.stdout(Stdio::piped()).spawn().unwrap())
    }

    /// What it says until it ends, and whether it ended well.
    fn ended(mut self) -> (String, bool) {
        let mut text = String::new();
        let mut output = self.0.stdout.take().unwrap();
        output.read_to_string(&mut text).unwrap();
        (text, self.0.wait().unwrap().success())
    }
}

/// A place for programs and a domain; joining and leaving at the end clears away what killed programs left.
struct Place(tempfile::TempDir);

impl Place {
    fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    fn domain(&self) -> PathBuf {
        self.0.path().join("domain")
    }

    /// Compiles a source; warnings are errors.
    fn compiled(&self, source: &Path) -> Command {
        let program = self.0.path().join(source.file_stem().unwrap());
        // The shared library is beside this executable.
        let tests = std::env::current_exe().unwrap();
        let libraries = tests.parent().unwrap();
        assert!(
            libraries.join("libvpcclient.so").exists(),
            "no libvpcclient.so in {}",
            libraries.display()
        );
        let mut cc = Command::new("cc");
        cc.args(["-std=c11", "-pedantic", "-Wall", "-Wextra", "-Werror", "-I"]);
        cc.arg(root().join("ipc/c/include"))
            .arg(source)
            .arg("-o")
            .arg(&program);
        cc.arg("-L").arg(libraries).arg("-lvpcclient").arg("-lm");
        cc.arg(format!("-Wl,-rpath,{}", libraries.display()));
        assert!(
            cc.status().unwrap().success(),
            "{} does not compile",
            source.display()
        );
        Command::new(program)
    }

    fn example(&self, name: &str) -> Command {
        let mut command = self.compiled(&root().join("ipc/c/examples").join(name));
        command.arg(self.domain());
        command
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        if self.domain().exists() {
            let _ = Domain::join(&self.domain());
        }
    }
}

/// Whether there is a compiler; says past the capture of the harness that a test did nothing.
fn compiler(test: &str) -> bool {
    let found = Command::new("cc")
        .arg("--version")
        .stdout(Stdio::null())
        .status();
    if found.is_ok_and(|status| status.success()) {
        return true;
    }
    let _ = writeln!(std::io::stderr(), "{test}: skipped: no C compiler (cc)");
    assert!(
        std::env::var_os("VPC_REQUIRE_PYTHON").is_none(),
        "no C compiler (cc)"
    );
    false
}

fn eventually<T>(what: &str, mut attempt: impl FnMut() -> Option<T>) -> T {
    let start = Instant::now();
    while start.elapsed() < PATIENCE {
        if let Some(value) = attempt() {
            return value;
        }
        std::thread::sleep(Duration::from_micros(200));
    }
    panic!("{what}: did not happen");
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

/// The root of the repository.
fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
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
        ("VPC_OUTCOME_NO_RECORD", Outcome::NoRecord.code()),
    ] {
        let _ = writeln!(source, "printf(\"{bits} %d\\n\", (int){bits});");
        let _ = writeln!(expected, "{bits} {expected_bits}");
    }
    source += "return 0;\n}\n";
    let place = Place::new();
    let path = place.0.path().join("layouts.c");
    std::fs::write(&path, source).unwrap();
    let (found, well) = Running::start(place.compiled(&path)).ended();
    assert!(well);
    for (found, expected) in found.lines().zip(expected.lines()) {
        assert_eq!(found, expected, "C first, then Rust");
    }
    assert_eq!(found.lines().count(), expected.lines().count());
}

#[test]
fn a_camera_in_c_closes_the_loop() {
    if !compiler("a_camera_in_c_closes_the_loop") {
        return;
    }
    // Straight to the goal, which is at 0.6 m; rolling on the way; along a screw. A twist held for a second.
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
        let domain = Domain::join(&place.domain()).unwrap();
        let mut controller = ControllerPorts::open(&domain).unwrap();
        let mut command = place.example("camera.c");
        command
            .arg((STEPS + 1).to_string())
            .args(start.map(|x| x.to_string()));
        let mut camera = Running::start(command);
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
            camera.0.try_wait().unwrap()
        });
        let (text, well) = camera.ended();
        let arrived = text.strip_prefix(&format!("{answered} steps, final error "));
        let arrived = arrived.unwrap_or_else(|| panic!("{answered} answers: {text}"));
        let error: f64 = arrived.split(' ').next().unwrap().parse().unwrap();
        // It stops where it is within 2 px, which is at most two steps early.
        assert!(well && error <= 2.0, "{text}");
        assert!((STEPS - 2..=STEPS).contains(&answered), "{text}");
        assert!(text.trim().ends_with("controller moving"), "{text}");
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
    let mut command = place.example("observer.c");
    command.args(["3", "20"]);
    let mut observer = Running::start(command);
    let mut lines = BufReader::new(observer.0.stdout.take().unwrap()).lines();
    assert_eq!(lines.next().unwrap().unwrap(), "watching");
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
    let said: Vec<String> = lines.map(Result::unwrap).collect();
    assert_eq!(
        said[1],
        "cycle 8: braking, robot silent, gpr, law 12.0 us, error 12.25 px, twist 0.5 -0.25 0 1 0 0.001"
    );
    assert_eq!(said[3], "3 cycles, 1 missed, slowest law 13.5 us");
    assert!(observer.0.wait().unwrap().success());
}

#[test]
fn an_operator_in_c_is_heard_and_told() {
    if !compiler("an_operator_in_c_is_heard_and_told") {
        return;
    }
    let place = Place::new();
    let domain = Domain::join(&place.domain()).unwrap();
    let mut controller = ControllerPorts::open(&domain).unwrap();
    for (words, action, strategy, neighbours, outcome) in [
        (&["arm"][..], Action::Arm, 0, 0, Outcome::NoFeatures),
        (&["stop"], Action::Stop, 0, 0, Outcome::Done),
        (
            &["knn", "5"],
            Action::Strategy,
            StrategyCode::Knn.code(),
            5,
            Outcome::Done,
        ),
    ] {
        let mut command = place.example("operator.c");
        command.args(words);
        let operator = Running::start(command);
        let request = eventually("a request", || controller.requests.oldest().unwrap());
        assert_eq!(
            (request.action(), request.strategy, request.neighbours),
            (Some(action), strategy, neighbours)
        );
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
        };
        controller.replies.publish(&reply).unwrap();
        let (id, outcome_code) = (request.id, outcome.code());
        let reply = Reply {
            id,
            outcome: outcome_code,
            ..reply
        };
        controller.replies.publish(&reply).unwrap();
        let (text, well) = operator.ended();
        assert_eq!(
            text.trim(),
            format!("{outcome}; now disarmed (not armed), gpr")
        );
        assert_eq!(well, outcome == Outcome::Done);
    }
}
