//! A late camera costs time, not success: with compensation the runs arrive as without delay, those
//! frames later.

use hw_sim::sensor::Flaws;
use messages::ClockMode;
use scene::Scene;
use system_tests::run::{Reason, Run, flawed, time};
use system_tests::simulated::Simulated;
use vpc::Settings;

/// Starts at which the memory-less strategy arrives without delay.
const STARTS: [usize; 4] = [0, 8, 16, 24];

fn runs(delay_frames: usize, delay_compensation: bool) -> Vec<Run> {
    let scene = Scene::parse(scene::PAPER_SIM, "paper-sim.toml").unwrap();
    let starts = scene::parse_starts(scene::PAPER_SIM_STARTS, "paper-sim-starts.csv").unwrap();
    let settings = Settings {
        delay_compensation,
        ..Settings::default()
    };
    let mut daemon = Simulated::new(&scene, None, settings, ClockMode::Fixed).unwrap();
    let flaws = Flaws {
        delay_frames,
        ..Flaws::default()
    };
    let mut runs = Vec::new();
    for &i in &STARTS {
        let mut run = flawed(&scene, &mut daemon, &starts[i], flaws);
        // The run with its delay is repeatable, bit for bit.
        time(&mut run, &mut daemon, 1).unwrap();
        runs.push(run);
    }
    runs
}

#[test]
fn with_compensation_every_run_arrives_its_delay_later() {
    let at_once = runs(0, true);
    for frames in [1, 2, 4] {
        for (late, prompt) in runs(frames, true).iter().zip(&at_once) {
            assert!(late.success && prompt.success);
            // Rounding may shift an arrival by a cycle.
            assert!(late.steps.abs_diff(prompt.steps + frames) <= 1);
        }
    }
}

#[test]
fn without_compensation_four_frames_of_delay_end_in_a_violation() {
    let runs = runs(4, false);
    let hit = |run: &&Run| run.reason == Some(Reason::Violation);
    assert_eq!(runs.iter().filter(hit).count(), STARTS.len());
}

#[test]
fn without_delay_compensation_changes_nothing() {
    let twists = |runs: Vec<Run>| -> Vec<[f64; 6]> {
        let moments = runs.into_iter().flat_map(|run| run.history);
        moments.map(|moment| moment.twist).collect()
    };
    assert_eq!(twists(runs(0, true)), twists(runs(0, false)));
}
