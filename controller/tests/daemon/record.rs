//! The flight record of the real daemon: asked for, written, replayed by the real binary.

use std::path::{Path, PathBuf};
use std::process::Command;

use ipc::{CameraPorts, Domain, OperatorPorts};
use messages::{Action, CycleRecord, Features, Outcome, Request, StrategyCode};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use recording::{Recording, RecordingFile, Sink};
use rustix::process::Signal;
use scene::Scene;
use serde_json::Value;

use crate::fixture::{Place, Running, eventually, scene_file, square, vpcd, vpcd_in, write_memory};

/// A daemon in lockstep with a memory, a camera, and an operator.
struct Bench {
    scene: Scene,
    camera: CameraPorts,
    operator: OperatorPorts,
    random: ChaCha8Rng,
    daemon: Option<Running>,
    place: Place,
}

impl Bench {
    fn new(flight: &str) -> Self {
        let place = Place::new();
        let scene = Scene::read(&scene_file()).unwrap();
        let mut random = ChaCha8Rng::seed_from_u64(4);
        let memory = place.path("m.vpcmem");
        write_memory(&scene, &memory, &mut random);
        let text = format!("[flight]\ndirectory = 'records'\n{flight}");
        let config = place.file("v.toml", text);
        let domain = Domain::join(&place.domain()).unwrap();
        let camera = CameraPorts::open(&domain).unwrap();
        let operator = OperatorPorts::open(&domain).unwrap();
        let mut command = vpcd_in(&place);
        command.arg("--config").arg(config);
        command.arg("--memory").arg(memory);
        command.args(["--strategy", "knn3", "--clock", "lockstep"]);
        Self {
            scene,
            camera,
            operator,
            random,
            daemon: Some(Running::start(command)),
            place,
        }
    }

    fn show(&mut self, change: impl FnOnce(&mut Features)) {
        let points = square(&self.scene, &mut self.random);
        let mut features = Features::new(&points, ipc::now_ns());
        change(&mut features);
        let sent = self.camera.features.publish(&features).unwrap();
        let answer = self
            .camera
            .wait_for_answer(&sent, testkit::PATIENCE)
            .unwrap();
        answer.expect("an answer in time");
    }

    fn ask(&mut self, request: &Request) -> Outcome {
        let reply = self.operator.ask(request, testkit::PATIENCE).unwrap();
        reply.expect("a reply in time").outcome().unwrap()
    }

    fn signal(&self, signal: Signal) {
        self.daemon.as_ref().unwrap().signal(signal);
    }

    fn files(&self) -> Vec<PathBuf> {
        let Ok(entries) = std::fs::read_dir(self.place.path("records")) else {
            return Vec::new();
        };
        let paths = entries.map(|entry| entry.unwrap().path());
        let mut files: Vec<_> = paths
            .filter(|path| path.extension().is_some_and(|end| end == "mcap"))
            .collect();
        files.sort();
        files
    }

    /// The newest file once there are so many.
    fn file(&self, count: usize) -> PathBuf {
        eventually("a flight record", || {
            let files = self.files();
            (files.len() == count).then(|| files.last().unwrap().clone())
        })
    }

    fn end(&mut self) {
        let daemon = self.daemon.take().unwrap();
        let (code, log) = daemon.terminated().log();
        assert_eq!(code, 0, "{log}");
        assert!(log.contains("flight record written"), "{log}");
    }
}

/// Replays with the real binary: exit code, standard output, standard error.
fn replayed(file: &Path, arguments: &[&str]) -> (i32, String, String) {
    let mut command: Command = vpcd();
    let output = command.arg("replay").arg(file).args(arguments).output();
    let output = output.unwrap();
    (
        output.status.code().unwrap(),
        String::from_utf8(output.stdout).unwrap(),
        String::from_utf8(output.stderr).unwrap(),
    )
}

fn report(file: &Path) -> Value {
    let (code, text, trouble) = replayed(file, &["--json"]);
    assert_eq!(code, 0, "{text}{trouble}");
    serde_json::from_str(&text).unwrap()
}

/// Writes a flight record again.
fn write(flight: &Recording, path: &Path) {
    let mut file = RecordingFile::create(path, true).unwrap();
    let origin = ["cause", "executable", "memory_sha256"];
    for key in origin {
        let entry = flight.origin(key).unwrap().to_owned();
        file.origin([(key, entry)]).unwrap();
    }
    for (name, data) in &flight.attachments {
        file.attach(name, data).unwrap();
    }
    flight.snapshots.iter().for_each(|m| file.write(m).unwrap());
    flight.features.iter().for_each(|m| file.write(m).unwrap());
    flight.robot.iter().for_each(|m| file.write(m).unwrap());
    flight.replies.iter().for_each(|m| file.write(m).unwrap());
    flight
        .cycles
        .iter()
        .for_each(|m: &CycleRecord| file.write(m).unwrap());
    file.finish().unwrap();
}

#[test]
fn every_cause_of_a_flight_record_leaves_one_that_replays() {
    let mut bench = Bench::new("at_exit = true");
    for _ in 0..150 {
        bench.show(|_| ());
    }
    let gpr = Request::strategy(6, StrategyCode::Gpr, 0);
    assert_eq!(bench.ask(&gpr), Outcome::Done);
    for _ in 0..50 {
        bench.show(|_| ());
    }
    assert_eq!(bench.ask(&Request::new(7, Action::Record)), Outcome::Done);
    let file = bench.file(1);
    let told = report(&file);
    assert_eq!(told["cause"], "request");
    assert_eq!(told["other_build"], false);
    assert_eq!(told["report"]["cycles"], 200);
    assert_eq!(told["report"]["skipped"], 0);
    // The change of the strategy is in it, and was replayed.
    let flight = Recording::read(&file).unwrap();
    let counts: Vec<u32> = flight.cycles.iter().map(|r| r.requests).collect();
    assert_eq!(counts.iter().sum::<u32>(), 1);
    assert_eq!(counts[150], 1);
    let answered = flight.replies.iter().find(|reply| reply.cycle == 151);
    assert_eq!(answered.unwrap().strategy, StrategyCode::Gpr.code());
    assert!(flight.config().unwrap().contains("strategy = \"knn3\""));

    bench.show(|features| features.points[0] = -500.0);
    let told = report(&bench.file(2));
    assert_eq!(told["cause"], "fault: off image");
    assert_eq!(told["report"]["last"], 201);

    bench.show(|_| ());
    bench.signal(Signal::USR1);
    let file = bench.file(3);
    assert_eq!(report(&file)["report"]["cycles"], 202);

    bench.end();
    let told = report(&bench.file(4));
    assert_eq!(told["cause"], "exit");
    let (code, text, _) = replayed(&file, &["--until", "77"]);
    assert_eq!(code, 0, "{text}");
    assert!(
        text.contains("\"cycle\":77") && text.contains("same: 13 cycles (65 to 77)"),
        "{text}"
    );
}

#[test]
fn replay_exits_with_1_on_a_difference_and_names_bad_files() {
    let mut bench = Bench::new("");
    for _ in 0..40 {
        bench.show(|_| ());
    }
    bench.signal(Signal::USR1);
    let file = bench.file(1);
    bench.end();

    // One bit of a twist, in a file without damage.
    let mut flight = Recording::read(&file).unwrap();
    let twist = &mut flight.cycles[20].twist[2];
    *twist = f64::from_bits(twist.to_bits() ^ 1);
    let forged = bench.place.path("forged.mcap");
    write(&flight, &forged);
    let (code, text, _) = replayed(&forged, &[]);
    assert_eq!(code, 1, "{text}");
    assert!(
        text.contains("cycle 21: twist[2] differs: recorded"),
        "{text}"
    );
    let (code, text, _) = replayed(&forged, &["--json"]);
    let told: Value = serde_json::from_str(&text).unwrap();
    assert_eq!((code, &told["same"]), (1, &Value::Bool(false)));
    assert_eq!(told["difference"]["field"], "twist[2]");
    // Before it all is well.
    assert_eq!(replayed(&forged, &["--until", "20"]).0, 0);

    let refused = |file: &Path, arguments: &[&str], exit: i32, words: &[&str]| {
        let (code, _, trouble) = replayed(file, arguments);
        assert_eq!(code, exit, "{trouble}");
        for word in words {
            assert!(trouble.contains(word), "{trouble}\nlacks: {word}");
        }
    };
    let mut bytes = std::fs::read(&file).unwrap();
    let at = bytes.len() / 2;
    bytes[at] ^= 1;
    let damaged = bench.place.file("damaged.mcap", &bytes);
    refused(
        &damaged,
        &[],
        65,
        &["damaged.mcap: damaged: ", "; allowed: "],
    );
    bytes.truncate(at);
    let short = bench.place.file("short.mcap", &bytes);
    refused(&short, &[], 65, &["short.mcap: damaged: "]);
    let text = bench.place.file("text.mcap", "no recording");
    refused(&text, &[], 65, &["text.mcap: not a recording"]);
    let none = bench.place.path("none.mcap");
    refused(&none, &[], 66, &["none.mcap", "No such file"]);
    let beyond = ["--until = 41; allowed: 1 to 40"];
    refused(&file, &["--until", "41"], 64, &beyond);
    refused(&file, &["--until", "x"], 64, &["--until"]);
    let other_memory = bench.place.path("other.vpcmem");
    write_memory(
        &bench.scene,
        &other_memory,
        &mut ChaCha8Rng::seed_from_u64(9),
    );
    let other_memory = other_memory.display().to_string();
    refused(
        &file,
        &["--memory", &other_memory],
        65,
        &["other.vpcmem: SHA-256 = "],
    );
    std::fs::remove_file(bench.place.path("m.vpcmem")).unwrap();
    refused(&file, &[], 66, &["m.vpcmem", "No such file"]);
}
