//! `hw-sim` as a process: its exit codes, what it says, its verdict, and that it leaves nothing
//! behind.

use std::path::PathBuf;
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

use ipc::{ControllerPorts, Domain, Features, Publisher, Subscriber, TwistCommand, TwistState};
use rustix::process::{Pid, Signal, kill_process};
use serde_json::Value;

/// A file of the repository, from its root.
fn repository(path: &str) -> PathBuf {
    PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/..")).join(path)
}

/// A directory for one test, with a domain in it.
struct Place(tempfile::TempDir);

impl Place {
    fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    fn domain(&self) -> PathBuf {
        self.0.path().join("domain")
    }

    /// `hw-sim` in this domain with the default configuration, and some more words.
    fn hw_sim(&self, words: &[&str]) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_hw-sim"));
        command
            .arg("--config")
            .arg(repository("hw-sim/hw-sim.toml"))
            .arg("--domain")
            .arg(self.domain())
            .args(words)
            .stdout(Stdio::piped())
            .stderr(Stdio::piped());
        command
    }

    fn run(&self, words: &[&str]) -> Output {
        self.hw_sim(words).output().unwrap()
    }

    /// Starts `hw-sim`, and waits until it is in the domain.
    fn start(&self, words: &[&str]) -> Child {
        let mut child = self.hw_sim(words).spawn().unwrap();
        let patience = Instant::now() + Duration::from_secs(10);
        while Domain::segments(&self.domain()).unwrap_or(0) < 6 {
            assert!(child.try_wait().unwrap().is_none(), "it ended");
            assert!(Instant::now() < patience, "it does not come");
            std::thread::sleep(Duration::from_millis(2));
        }
        child
    }

    /// Files of shared memory that its domain has.
    fn left(&self) -> usize {
        Domain::segments(&self.domain()).unwrap()
    }
}

fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// The one line that a run prints.
fn verdict(output: &Output) -> Value {
    let text = std::str::from_utf8(&output.stdout).unwrap();
    assert_eq!(text.lines().count(), 1, "{text} {}", stderr(output));
    serde_json::from_str(text).unwrap()
}

#[test]
fn what_it_cannot_start_with_is_named_with_its_exit_code() {
    let place = Place::new();
    let path = |name: &str| place.0.path().join(name).display().to_string();
    let (unknown, broken, missing) = (path("unknown.toml"), path("broken.toml"), path("missing"));
    std::fs::write(&unknown, "noise = 0.3").unwrap();
    std::fs::write(&broken, "noise_px = ").unwrap();
    let (unknown, broken) = (unknown.as_str(), broken.as_str());
    for (words, code, part) in [
        (["--bogus", "1"], 64, "--bogus"),
        (
            ["--clock", "sundial"],
            64,
            "[possible values: fixed, lockstep]",
        ),
        (["--config", &missing], 64, "cannot be used multiple times"),
        (["--scene", &missing], 66, missing.as_str()),
        (["--starts", &missing], 66, missing.as_str()),
        (["--scene", broken], 78, broken),
        (["--start", "100"], 78, "--start = 100; allowed: 0 to 99"),
        (
            ["--noise", "-0.5"],
            78,
            "--noise = -0.5; allowed: 0 to 100 px",
        ),
        (
            ["--noise", "nan"],
            78,
            "--noise = NaN; allowed: 0 to 100 px",
        ),
        (["--drop", "1.5"], 78, "--drop = 1.5; allowed: 0 to 1"),
        (
            ["--delay", "101"],
            78,
            "--delay = 101; allowed: 0 to 100 frames",
        ),
        (
            ["--time-limit", "0"],
            78,
            "--time-limit = 0; allowed: 0.1 to 86400 s",
        ),
        (
            ["--latency-ms", "901"],
            78,
            "--latency-ms = 901; allowed: 0 to 900 ms",
        ),
    ] {
        let output = place.run(&words);
        let said = stderr(&output);
        assert_eq!(output.status.code(), Some(code), "{words:?}: {said}");
        assert!(said.contains(part), "{words:?}: {said}");
        assert!(output.stdout.is_empty(), "{words:?}");
    }
    // Not even a domain was made.
    assert!(!place.domain().exists());
    // The box of the other scene stands where no arm sees it.
    let unreachable = place.run(&["--robot", "panda"]);
    let said = stderr(&unreachable);
    assert_eq!(unreachable.status.code(), Some(78), "{said}");
    assert_eq!(said.matches("no joint positions").count(), 1, "{said}");
    for (file, part) in [(unknown, "noise"), (broken, "line 1")] {
        let mut command = Command::new(env!("CARGO_BIN_EXE_hw-sim"));
        let output = command.args(["--config", file]).output().unwrap();
        let said = stderr(&output);
        assert_eq!(output.status.code(), Some(78), "{file}: {said}");
        assert!(said.contains(part) && said.contains(file), "{said}");
    }
}

#[test]
fn a_run_begins_with_the_first_command_and_ends_when_time_is_out() {
    let place = Place::new();
    let domain = Domain::join(&place.domain()).unwrap();
    let mut controller = ControllerPorts::open(&domain).unwrap();
    let child = place.start(&["--time-limit", "0.5"]);
    // One command, and then silence: the camera stands.
    let features = loop {
        if let Some(features) = controller.features.latest().unwrap() {
            break features;
        }
        std::thread::sleep(Duration::from_millis(2));
    };
    let twist = TwistCommand::answer(&features, [0.0; 6], TwistState::Moving);
    controller.twist.publish(&twist).unwrap();
    let output = child.wait_with_output().unwrap();
    assert_eq!(output.status.code(), Some(1), "{}", stderr(&output));
    let verdict = verdict(&output);
    assert_eq!(verdict["verdict"], "time_out", "{verdict}");
    let count = |key: &str| verdict[key].as_u64().unwrap();
    assert!((10..count("frames")).contains(&count("stale")), "{verdict}");
    assert!(verdict["error_px"].as_f64().unwrap() > 20.0, "{verdict}");
    drop((controller, domain));
    assert_eq!(place.left(), 0);
}

#[test]
fn signals_end_it_with_a_verdict_and_nothing_is_left() {
    let scenes = repository("ipc/scene/scenes");
    let file = |name| scenes.join(name).display().to_string();
    let (scene, starts) = (file("paper-robot.toml"), file("paper-robot-starts.csv"));
    for robot in ["free", "panda"] {
        for signal in [Signal::TERM, Signal::INT] {
            let place = Place::new();
            let child = place.start(&["--robot", robot, "--scene", &scene, "--starts", &starts]);
            kill_process(Pid::from_child(&child), signal).unwrap();
            let output = child.wait_with_output().unwrap();
            let said = stderr(&output);
            assert_eq!(output.status.code(), Some(1), "{robot} {signal:?}: {said}");
            assert_eq!(verdict(&output)["verdict"], "stopped", "{robot}");
            assert_eq!(place.left(), 0, "{robot} {signal:?}");
        }
    }
}

#[test]
fn a_second_camera_is_refused_and_the_first_goes_on() {
    let place = Place::new();
    let mut first = place.start(&[]);
    let second = place.run(&[]);
    let said = stderr(&second);
    assert_eq!(second.status.code(), Some(69), "{said}");
    let expected = "vpc/features: another publisher is at work";
    assert!(said.contains(expected), "{said}");
    assert!(!said.contains("features go out"), "{said}");
    assert!(first.try_wait().unwrap().is_none());
    kill_process(Pid::from_child(&first), Signal::TERM).unwrap();
    assert_eq!(
        verdict(&first.wait_with_output().unwrap())["verdict"],
        "stopped"
    );
}

/// A camera's frame: its number and its first point, px.
type Frame = (u64, [f64; 2]);

/// A controller that answers every frame with a twist of zero until `is_over`; gives the frames.
fn answer(domain: &Domain, mut is_over: impl FnMut(&[Frame]) -> bool) -> Vec<Frame> {
    let mut twists: Publisher<TwistCommand> = domain.publisher().unwrap();
    let mut features: Subscriber<Features> = domain.subscriber(64).unwrap();
    let mut frames = Vec::new();
    while !is_over(&frames) {
        while let Some(received) = features.oldest().unwrap() {
            let message = received.message;
            frames.push((message.stamp.sequence, message.pairs().next().unwrap()));
            let twist = TwistCommand::answer(&message, [0.0; 6], TwistState::Moving);
            twists.publish(&twist).unwrap();
        }
        std::thread::sleep(Duration::from_micros(200));
    }
    frames
}

#[test]
fn all_starts_are_run_one_after_another_each_a_new_run() {
    let place = Place::new();
    let domain = Domain::join(&place.domain()).unwrap();
    let words = ["--clock", "lockstep", "--all", "--start", "98"];
    let mut child = place.start(&[&words[..], &["--time-limit", "0.2"]].concat());
    let frames = answer(&domain, |_| child.try_wait().unwrap().is_some());
    let output = child.wait_with_output().unwrap();
    let numbers: Vec<u64> = frames.iter().map(|frame| frame.0).collect();
    assert_eq!(numbers, [1, 2, 3, 4, 5, 6, 1, 2, 3, 4, 5, 6]);
    assert_ne!(frames[0].1, frames[6].1);
    let text = String::from_utf8(output.stdout.clone()).unwrap();
    let lines: Vec<Value> = text
        .lines()
        .map(|line| serde_json::from_str(line).unwrap())
        .collect();
    let said: Vec<_> = lines
        .iter()
        .map(|line| {
            (
                line["start"].as_u64().unwrap(),
                line["verdict"].as_str().unwrap(),
            )
        })
        .collect();
    assert_eq!(said, [(98, "time_out"), (99, "time_out")]);
    assert_eq!(output.status.code(), Some(1));
    let said = stderr(&output);
    assert!(said.contains("start 99: did not arrive in time"), "{said}");
    assert!(said.contains("(0 of 2 arrived)"), "{said}");
}

#[test]
fn between_the_runs_of_a_loop_the_camera_shows_the_goal_and_then_begins_again() {
    let place = Place::new();
    let domain = Domain::join(&place.domain()).unwrap();
    let child = place.start(&["--loop", "--time-limit", "0.2"]);
    // The run, the rest and the next run each count from 1.
    let firsts = |frames: &[Frame]| frames.iter().filter(|frame| frame.0 == 1).count();
    let frames = answer(&domain, |frames| firsts(frames) == 3);
    let points: Vec<[f64; 2]> = frames.iter().filter(|f| f.0 == 1).map(|f| f.1).collect();
    assert_eq!(points[0], points[2]);
    assert!(
        (points[1][0] - 312.0).hypot(points[1][1] - 312.0) < 1e-9,
        "{points:?}"
    );
    assert!(
        frames
            .windows(2)
            .all(|pair| pair[1].0 == 1 || pair[1].0 == pair[0].0 + 1)
    );
    kill_process(Pid::from_child(&child), Signal::TERM).unwrap();
    let said = stderr(&child.wait_with_output().unwrap());
    assert!(said.contains("start 0: did not arrive in time"), "{said}");
    assert!(said.contains("start 0: stopped"), "{said}");
}
