//! A rival of our strategies, ViSP, takes part in `cargo table`: it follows a moving pattern with
//! its compensation of the target's motion, and lags behind it without.

use hw_sim::motion::Motion;
use hw_sim::sensor::Flaws;
use scene::Scene;
use system_tests::rival::Rival;
use system_tests::run::{Reason, Run, World, through};
use testkit::{Place, are_installed, command, not_run, root};
use vpc::Settings;

/// Starts from which straight motion to the goal meets no occlusion.
const STARTS: [usize; 3] = [0, 4, 8];

/// Compiles `tests/rivals/visp.cpp` by the command in its head; its path, where ViSP is installed.
fn visp(place: &Place) -> Option<String> {
    let what = "ViSP as a rival";
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
    let source = std::fs::read_to_string(root().join("tests/rivals/visp.cpp")).unwrap();
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

/// The runs of a rival from each start, with a pattern that moves.
fn runs(words: &str, motion: &str) -> Vec<Run> {
    let scene = Scene::parse(scene::PAPER_SIM, "paper-sim.toml").unwrap();
    let starts = scene::parse_starts(scene::PAPER_SIM_STARTS, "paper-sim-starts.csv").unwrap();
    let mut rival = Rival::start(words, &scene, &Settings::default()).unwrap();
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
    let runs = starts.map(|start| through(&scene, &mut rival, start, &world).unwrap());
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
