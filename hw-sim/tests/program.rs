//! `hw-sim` as a process: its exit codes, what it says, its verdict, and that it leaves nothing
//! behind.

use std::fs::File;
use std::io::Read as _;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::Duration;

use ipc::{ControllerPorts, Domain, Observer, Publisher, Subscriber};
use messages::{Features, TwistCommand, TwistState};
use rustix::process::Signal;
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use serde_json::Value;
use testkit::{Ended, Place, Running, eventually};

/// `hw-sim` in the domain of a place with the default configuration, and some more words.
fn hw_sim(place: &Place, words: &[&str]) -> Command {
    let mut command = testkit::command(env!("CARGO_BIN_EXE_hw-sim"));
    command
        .arg("--config")
        .arg(testkit::root().join("hw-sim/hw-sim.toml"))
        .arg("--domain")
        .arg(place.domain())
        .args(words)
        .stdout(Stdio::piped())
        .stderr(Stdio::piped());
    command
}

fn run(place: &Place, words: &[&str]) -> Ended {
    testkit::ended(hw_sim(place, words))
}

/// Starts `hw-sim`, and waits until it is in the domain.
fn start(place: &Place, words: &[&str]) -> Running {
    let mut running = Running::start(hw_sim(place, words));
    eventually("hw-sim comes", || {
        assert!(running.is_running(), "it ended");
        (Domain::segments(&place.domain()).unwrap_or(0) >= 6).then_some(())
    });
    running
}

/// Files of shared memory that the domain of a place has.
fn left(place: &Place) -> usize {
    Domain::segments(&place.domain()).unwrap()
}

/// The one line that a run prints.
fn verdict(ended: &Ended) -> Value {
    let Ended { stdout, stderr, .. } = ended;
    assert_eq!(stdout.lines().count(), 1, "{stdout} {stderr}");
    serde_json::from_str(stdout).unwrap()
}

#[test]
fn what_it_cannot_start_with_is_named_with_its_exit_code() {
    let place = Place::new();
    let file = |name, text| place.file(name, text).display().to_string();
    let unknown = file("unknown.toml", "noise = 0.3");
    let broken = file("broken.toml", "noise_px = ");
    let missing = place.path("missing").display().to_string();
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
        let ended = run(&place, &words);
        let said = &ended.stderr;
        assert_eq!(ended.code, Some(code), "{words:?}: {said}");
        assert!(said.contains(part), "{words:?}: {said}");
        assert!(ended.stdout.is_empty(), "{words:?}");
    }
    // Not even a domain was made.
    assert!(!place.domain().exists());
    // The box of the other scene stands where no arm sees it.
    let (code, said) = run(&place, &["--robot", "panda"]).log();
    assert_eq!(code, 78, "{said}");
    assert_eq!(said.matches("no joint positions").count(), 1, "{said}");
    for (file, part) in [(unknown, "noise"), (broken, "line 1")] {
        let mut command = testkit::command(env!("CARGO_BIN_EXE_hw-sim"));
        let (code, said) = testkit::ended(command.args(["--config", file])).log();
        assert_eq!(code, 78, "{file}: {said}");
        assert!(said.contains(part) && said.contains(file), "{said}");
    }
}

#[test]
fn a_run_begins_with_a_command_and_ends_at_the_time_limit() {
    let place = Place::new();
    let domain = Domain::join(&place.domain()).unwrap();
    let mut controller = ControllerPorts::open(&domain).unwrap();
    let running = start(&place, &["--time-limit", "0.5"]);
    // One command, and then silence: the camera stands.
    let features = eventually("features", || controller.features.latest().unwrap());
    let twist = TwistCommand::answer(&features, [0.0; 6], TwistState::Moving);
    controller.twist.publish(&twist).unwrap();
    let ended = running.ended();
    assert_eq!(ended.code, Some(1), "{}", ended.stderr);
    let verdict = verdict(&ended);
    assert_eq!(verdict["verdict"], "time_out", "{verdict}");
    assert!(verdict["error_px"].as_f64().unwrap() > 20.0, "{verdict}");
    drop((controller, domain));
    assert_eq!(left(&place), 0);
}

#[test]
fn signals_end_it_with_a_verdict_and_nothing_is_left() {
    let scenes = testkit::root().join("ipc/scene/scenes");
    let file = |name| scenes.join(name).display().to_string();
    let (scene, starts) = (file("paper-robot.toml"), file("paper-robot-starts.csv"));
    for (robot, signal) in [("free", Signal::TERM), ("panda", Signal::INT)] {
        let place = Place::new();
        let words = ["--robot", robot, "--scene", &scene, "--starts", &starts];
        let running = start(&place, &words);
        // While it starts, a signal ends it where it is.
        let domain = Domain::join(&place.domain()).unwrap();
        let mut observer = Observer::open(&domain).unwrap();
        eventually("features", || observer.features.latest().unwrap());
        drop((observer, domain));
        running.signal(signal);
        let ended = running.ended();
        let said = &ended.stderr;
        assert_eq!(ended.code, Some(1), "{robot} {signal:?}: {said}");
        assert_eq!(verdict(&ended)["verdict"], "stopped", "{robot}");
        assert_eq!(left(&place), 0, "{robot} {signal:?}");
    }
}

/// What `hw-sim` prints to standard output, where that is a terminal, and to standard error.
fn on_a_terminal(words: &[&str]) -> (String, String) {
    let place = Place::new();
    let mut terminal = File::from(openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY).unwrap());
    grantpt(&terminal).unwrap();
    unlockpt(&terminal).unwrap();
    let name = ptsname(&terminal, Vec::new()).unwrap();
    let path = Path::new(name.to_str().unwrap());
    let end = File::options().read(true).write(true).open(path).unwrap();
    let mut command = hw_sim(&place, words);
    command.stdout(end);
    let mut running = Running::start(command);
    running.line("features go out");
    running.signal(Signal::INT);
    let ended = running.ended();
    // The last read of a terminal that nobody holds any more is an error.
    let mut printed = Vec::new();
    let _ = terminal.read_to_end(&mut printed);
    (String::from_utf8(printed).unwrap(), ended.stderr)
}

#[test]
fn a_terminal_gets_json_only_where_it_is_asked_for() {
    for (words, is_printed) in [(&[][..], false), (&["--json"], true)] {
        let (printed, said) = on_a_terminal(words);
        assert!(said.contains("hw-sim: stopped after 0.0 s"), "{said}");
        assert_eq!(printed.contains("\"verdict\":"), is_printed, "{printed}");
    }
}

#[test]
fn a_second_camera_is_refused_and_the_first_goes_on() {
    let place = Place::new();
    let mut first = start(&place, &[]);
    // Whoever has the port is the first, not who began first.
    first.line("features go out");
    let (code, said) = run(&place, &[]).log();
    assert_eq!(code, 69, "{said}");
    let expected = "vpc/features: another publisher is at work";
    assert!(said.contains(expected), "{said}");
    assert!(!said.contains("features go out"), "{said}");
    assert!(first.is_running());
    assert_eq!(verdict(&first.terminated())["verdict"], "stopped");
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
    let mut running = start(&place, &[&words[..], &["--time-limit", "0.2"]].concat());
    let frames = answer(&domain, |_| !running.is_running());
    let Ended {
        code,
        stdout,
        stderr: said,
        ..
    } = running.ended();
    let numbers: Vec<u64> = frames.iter().map(|frame| frame.0).collect();
    assert_eq!(numbers, [1, 2, 3, 4, 5, 6, 1, 2, 3, 4, 5, 6]);
    assert_ne!(frames[0].1, frames[6].1);
    let lines: Vec<Value> = stdout
        .lines()
        .map(|line| serde_json::from_str(line).unwrap())
        .collect();
    let verdicts: Vec<_> = lines
        .iter()
        .map(|line| {
            (
                line["start"].as_u64().unwrap(),
                line["verdict"].as_str().unwrap(),
            )
        })
        .collect();
    assert_eq!(verdicts, [(98, "time_out"), (99, "time_out")]);
    assert_eq!(code, Some(1));
    assert!(said.contains("start 99: did not arrive in time"), "{said}");
    assert!(said.contains("(0 of 2 arrived)"), "{said}");
}

#[test]
fn between_the_runs_of_a_loop_the_camera_shows_the_goal() {
    let place = Place::new();
    let domain = Domain::join(&place.domain()).unwrap();
    let running = start(&place, &["--loop", "--time-limit", "0.2"]);
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
    let said = running.terminated().stderr;
    assert!(said.contains("start 0: did not arrive in time"), "{said}");
    assert!(said.contains("start 0: stopped"), "{said}");
}

#[test]
fn lockstep_images_and_their_twists_end_the_run() {
    let place = Place::new();
    let scene = scene::Scene::parse(scene::TAGS_ROBOT, "tags").unwrap();
    let goal = hw_sim::FreeCamera::new(&scene, &scene.goal)
        .features()
        .unwrap();
    let starts = place.file("starts.csv", "tx,ty,tz,rx,ry,rz\n0,-0.01,0.35,0,0,0\n");
    let config = testkit::root().join("hw-sim/hw-sim-tags.toml");
    let mut command = testkit::command(env!("CARGO_BIN_EXE_hw-sim"));
    command.arg("--config").arg(config);
    command.arg("--domain").arg(place.domain());
    command.arg("--starts").arg(starts);
    command.args([
        "--clock",
        "lockstep",
        "--dwell-s",
        "0.1",
        "--time-limit",
        "3",
    ]);
    let domain = Domain::join(&place.domain()).unwrap();
    let mut images = domain.image_subscriber().unwrap();
    let mut twists: Publisher<TwistCommand> = domain.publisher().unwrap();
    let mut running = Running::start(command.stdout(Stdio::piped()).stderr(Stdio::piped()));
    let (mut numbers, mut object) = (Vec::new(), Vec::<f64>::new());
    while running.is_running() {
        let Some(image) = images.latest().unwrap() else {
            std::thread::sleep(Duration::from_micros(200));
            continue;
        };
        let header = *image.header();
        assert_eq!(
            (header.width, header.height, header.exposure_ns),
            (640, 480, 6_000_000)
        );
        let stamp = header.stamp;
        let late_ms = (stamp.published_ns - stamp.data_ns) / 1_000_000;
        assert_eq!(late_ms, 110);
        // White modules and black ones, where the first tag is at the goal.
        let [u, v] = goal[0].map(|x| x as usize);
        let near = (0..400).map(|k| image[(v + k / 20 - 10) * 640 + u + k % 20 - 10]);
        if numbers.is_empty() {
            assert!(near.clone().max().unwrap() > 150 && near.min().unwrap() < 50);
        }
        // In the middle of the grasped object, until it is let go.
        let inside = (0..4000).map(|k| f64::from(image[(420 + k / 100) * 640 + 270 + k % 100]));
        object.push(inside.sum::<f64>() / 4000.0);
        numbers.push(stamp.sequence);
        let mut found = Features::new(&goal, stamp.data_ns);
        found.stamp = stamp;
        let twist = TwistCommand::answer(&found, [0.0; 6], TwistState::Moving);
        twists.publish(&twist).unwrap();
    }
    let ended = running.ended();
    let verdict = verdict(&ended);
    assert_eq!(verdict["verdict"], "arrived", "{verdict}");
    // One in a hundred is lost.
    assert!(
        numbers
            .windows(2)
            .all(|pair| (1..4).contains(&(pair[1] - pair[0])))
    );
    assert!(
        (object.last().unwrap() - object[0]).abs() > 5.0,
        "{object:?}"
    );
    assert_eq!(ended.code, Some(0), "{}", ended.stderr);
}
