//! Methods of others take part in `vpc-lab table`: ViSP follows a moving pattern with its compensation
//! of the target's motion, and lags behind it without; a program in Python is judged like ours; the
//! peers steer.

use std::time::Duration;

use decision::Inputs;
use hw_sim::motion::Motion;
use hw_sim::sensor::Flaws;
use messages::{ClockMode, CycleRecord};
use scene::{Pose, Scene};
use system_tests::benchmark;
use system_tests::external::{External, ExternalError, Method};
use system_tests::run::{Reason, Run, World, through};
use system_tests::simulated::Simulated;
use system_tests::steering::Steering;
use testkit::{Place, are_installed, command, not_run, root};
use vpc::{Settings, Strategy, Task};

/// Starts from which straight motion to the goal meets no occlusion.
const STARTS: [usize; 3] = [0, 4, 8];

/// Compiles `tests/peers/visp.cpp` by the command in its head; its path, where ViSP is installed.
fn visp(place: &Place) -> Option<String> {
    let what = "ViSP as a peer";
    if !are_installed(what, &["c++=g++"]) {
        return None;
    }
    let mut header = command("c++");
    header.args([
        "-E",
        "-include",
        "visp3/vs/vpServo.h",
        "-x",
        "c++",
        "/dev/null",
    ]);
    header.args(["-isystem", "/usr/include/opencv4", "-o", "/dev/null"]);
    if !header.output().unwrap().status.success() {
        let packages = "libvisp-vs-dev libvisp-vision-dev";
        not_run(
            what,
            format_args!("ViSP missing (apt-get install {packages})"),
        );
        return None;
    }
    let source = std::fs::read_to_string(root().join("tests/peers/visp.cpp")).unwrap();
    let lines = source.lines().map_while(|line| line.strip_prefix("// "));
    let words = lines.filter_map(|line| line.strip_prefix("    "));
    let words: Vec<&str> = words.flat_map(str::split_whitespace).collect();
    let program = place.path("visp").display().to_string();
    let words = words
        .iter()
        .map(|word| word.replace("target/visp", &program));
    let words: Vec<String> = words.collect();
    let mut compiler = command(&words[0]);
    compiler
        .args(&words[1..])
        .args(["-Wall", "-Wextra", "-Werror"]);
    let status = compiler.current_dir(root()).status();
    assert!(status.unwrap().success(), "{words:?}");
    Some(program)
}

fn paper_sim() -> (Scene, Vec<Pose>) {
    let scene = Scene::parse(scene::PAPER_SIM, "paper-sim.toml").unwrap();
    let starts = scene::parse_starts(scene::PAPER_SIM_STARTS, "paper-sim-starts.csv").unwrap();
    (scene, starts.to_vec())
}

fn started(words: &str, scene: &Scene, patience_s: f64) -> Result<External, ExternalError> {
    let method = Method {
        name: "method".to_owned(),
        words: words.to_owned(),
    };
    let patience = Duration::from_secs_f64(patience_s);
    External::start(&method, scene, &Settings::default(), patience)
}

/// The runs of a method from each start, with a pattern that moves.
fn runs(words: &str, motion: &str) -> Vec<Run> {
    let (scene, starts) = paper_sim();
    let mut method = started(words, &scene, 60.0).unwrap();
    let flaws = Flaws {
        noise_px: 0.3,
        ..Flaws::default()
    };
    let world = World {
        motion: Motion::new(&[motion.parse().unwrap()]),
        follow_s: 3.0,
        ..World::from(flaws)
    };
    let starts = STARTS.iter().map(|&start| &starts[start]);
    let runs = starts.map(|start| through(&scene, &mut method, start, &world).unwrap());
    runs.collect()
}

#[test]
fn visp_follows_a_moving_pattern_only_with_its_compensation() {
    let place = Place::new();
    let Some(visp) = visp(&place) else {
        return;
    };
    let compensating = format!("{visp} --compensate");
    let rms_px = |run: &Run| run.following.as_ref().map(|report| report.rms_px);
    for (words, motion, most_px) in [
        (&visp, "conveyor:0", 0.2),
        (&compensating, "conveyor:0", 0.2),
        (&compensating, "conveyor:0.03", 0.7),
    ] {
        for run in runs(words, motion) {
            let follows = rms_px(&run).is_some_and(|rms| rms < most_px);
            assert!(
                follows,
                "{words}, {motion}: {:?}, {:?}",
                run.reason,
                rms_px(&run)
            );
        }
    }
    for run in runs(&visp, "conveyor:0.03") {
        assert_eq!(run.reason, Some(Reason::NotConverged));
    }
}

/// A strategy, and all that it commanded, run by run.
struct Recorded<'m>(Simulated<'m>, Vec<Vec<[f64; 6]>>);

impl Steering for Recorded<'_> {
    type Error = std::convert::Infallible;

    fn task(&self) -> &Task {
        self.0.task()
    }

    fn np(&self) -> usize {
        self.0.np()
    }

    fn begin(&mut self) -> Result<(), Self::Error> {
        self.1.push(Vec::new());
        self.0.begin()
    }

    fn answer(&mut self, inputs: &Inputs) -> Result<CycleRecord, Self::Error> {
        let record = self.0.answer(inputs)?;
        self.1.last_mut().unwrap().push(record.twist);
        Ok(record)
    }
}

#[test]
fn the_same_commands_from_a_program_in_python_are_judged_the_same() {
    if !are_installed("the adapter in Python", &["python3"]) {
        return;
    }
    let (scene, starts) = paper_sim();
    let settings = Settings {
        strategy: Strategy::Previous,
        ..Settings::default()
    };
    let ours = Simulated::new(&scene, None, settings, ClockMode::Fixed).unwrap();
    let mut ours = Recorded(ours, Vec::new());
    let world = World::from(Flaws {
        noise_px: 0.3,
        delay_frames: 1,
        ..Flaws::default()
    });
    let starts = || STARTS.iter().map(|&start| &starts[start]);
    let wanted = starts().map(|start| through(&scene, &mut ours, start, &world).unwrap());
    let wanted: Vec<Run> = wanted.collect();
    let place = Place::new();
    let path = |name: &str| place.path(name).display().to_string();
    place.file("twists.json", serde_json::to_string(&ours.1).unwrap());
    // A first frame that is late has no step.
    let program = r#"
import json, sys
sys.path.append(sys.argv[1])
import adapter

class Replay:
    def __init__(self, scene):
        print("this is no answer")
        assert len(scene["occlusions"]) == 4 and scene["goal"]["features"][2] == [712.0, 712.0]
        self.runs = iter(json.load(open(sys.argv[2])))
    def reset(self):
        self.twists = iter(next(self.runs)[1:])
    def step(self, points):
        return next(self.twists)

adapter.run(Replay)
"#;
    place.file("replay.py", program);
    let peers = root().join("tests/peers").display().to_string();
    let words = format!(
        "python3 {} {peers} {}",
        path("replay.py"),
        path("twists.json")
    );
    let mut method = started(&words, &scene, 60.0).unwrap();
    for (wanted, start) in wanted.iter().zip(starts()) {
        let run = through(&scene, &mut method, start, &world).unwrap();
        assert_eq!((run.success, run.steps), (wanted.success, wanted.steps));
        assert!((run.cost / wanted.cost - 1.0).abs() < 1e-9, "{}", run.cost);
        assert!((run.least_between_px - wanted.least_between_px).abs() < 1e-6);
        assert!(method.times_us().len() > run.steps);
        assert!(method.times_us().iter().all(|us| *us > 1.0));
    }
}

#[test]
fn the_peers_arrive_where_nothing_is_in_the_way() {
    let (scene, starts) = paper_sim();
    let methods = benchmark::methods(&testkit::memory_file());
    for method in &methods {
        let patience = Duration::from_secs(120);
        let mut external = External::start(method, &scene, &Settings::default(), patience).unwrap();
        let start = &starts[STARTS[0]];
        let run = through(&scene, &mut external, start, &Flaws::default().into()).unwrap();
        assert!(run.success, "{}: {:?}", method.name, run.reason);
    }
}
