//! Foresight arrives from starts that no setting was chosen on, no run is deep inside an occlusion
//! at any instant, and in the exact model a run costs no more than was foreseen.

use std::sync::Arc;

use hw_sim::FreeCamera;
use ipc::ClockMode;
use memory_blob::MemoryFile;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use scene::{Pose, Scene};
use system_tests::row::Row;
use system_tests::run::{Run, run};
use system_tests::simulated::Simulated;
use system_tests::spec::Spec;
use vpc::foresight::Outcome;
use vpc::{Controller, Measurement, MotionMemory, Settings, Task};

use crate::fixture::{memory_file, repeats, tell, turn};

/// Of the starts; no setting was chosen on them.
const SEED: u64 = 90_210;
/// The deepest that a point may be at any of twelve instants a period, px.
const DEEPEST_PX: f64 = 3.0;

/// What a promise may rise by, as a share: rounding, which grows over a run (1.3e-9 seen).
const ROUNDING: f64 = 1e-8;

fn scene() -> Scene {
    Scene::parse(scene::PAPER_SIM, "paper-sim.toml").unwrap()
}

fn starts(scene: &Scene, count: usize) -> Vec<Pose> {
    let task = Task::new(scene).unwrap();
    let mut random = ChaCha8Rng::seed_from_u64(SEED);
    let draws = std::iter::repeat_with(|| memory_builder::start::draw(scene, &mut random));
    let valid =
        |pose: &Pose| memory_builder::start::features_if_valid(scene, &task, pose).is_some();
    draws.filter(valid).take(count).collect()
}

fn memory(scene: &Scene) -> Arc<MemoryFile> {
    let memory = MemoryFile::open(&memory_file(), Some(scene.fingerprint().bytes()));
    Arc::new(memory.unwrap())
}

/// Runs of a strategy with changed settings from each start, and their row.
fn row(text: &str, starts: &[Pose], change: fn(&mut Settings)) -> (Row, Vec<Run>) {
    let scene = scene();
    let memory = memory(&scene);
    let spec: Spec = text.parse().unwrap();
    let mut settings = spec.settings();
    change(&mut settings);
    let runs: Vec<Run> = starts
        .par_iter()
        .map_init(
            || Simulated::new(&scene, Some(memory.clone()), settings, ClockMode::Fixed).unwrap(),
            |daemon, start| run(&scene, daemon, start),
        )
        .collect();
    let row = Row::of(spec, &runs);
    tell(format!(
        "{text}: {:.1} % ({:.1} to {:.1}) of {} starts, mean cost {:.2}, {:.1} cycles, deepest {:.2} px",
        100.0 * row.success_rate,
        100.0 * row.success_interval[0],
        100.0 * row.success_interval[1],
        runs.len(),
        row.mean_cost,
        row.steps,
        row.deepest_px
    ));
    (row, runs)
}

#[test]
fn foresight_arrives_where_the_papers_strategies_stay_behind() {
    let _turn = turn();
    let starts = starts(&scene(), repeats("foresight, starts", 100, 1000));
    let (foresight, runs) = row("foresight:3", &starts, |_| ());
    let failed = runs.iter().filter(|run| !run.success).count();
    assert!(failed * 200 <= starts.len(), "{failed} of {}", starts.len());
    assert!(foresight.mean_cost <= 12.5, "{}", foresight.mean_cost);
    assert!(foresight.steps <= 49.0, "{}", foresight.steps);
    for text in ["previous:3", "gpr:3"] {
        let (other, _) = row(text, &starts, |_| ());
        let [low, high] = [foresight.success_interval[0], other.success_interval[1]];
        assert!(high < low, "{text}: up to {high}, foresight from {low} on");
        assert!(foresight.mean_cost < other.mean_cost, "{text}");
    }
}

#[test]
fn no_run_is_deep_at_any_instant_and_without_the_mechanism_some_are() {
    let _turn = turn();
    let starts = starts(&scene(), repeats("between the frames, starts", 24, 300));
    for text in ["previous:3", "knn:3", "gpr:3", "foresight:3"] {
        let (row, _) = row(text, &starts, |_| ());
        assert!(row.deepest_px <= DEEPEST_PX, "{text}: {}", row.deepest_px);
    }
    let (row, _) = row("previous:3", &starts, |settings| {
        settings.solver.intersample = false;
    });
    assert!(row.deepest_px > 2.0 * DEEPEST_PX, "{}", row.deepest_px);
}

#[test]
fn in_the_exact_model_a_run_costs_no_more_than_was_foreseen() {
    let _turn = turn();
    let scene = scene();
    let memory = memory(&scene);
    let view = memory.view();
    let memory = Some(&view as &dyn MotionMemory);
    let spec: Spec = "foresight:3".parse().unwrap();
    let mut law = Controller::new(&scene, spec.settings(), |len| vec![0.0; len]).unwrap();
    let (ts, np) = (scene.sampling_time(), spec.np as f64);
    let starts = starts(&scene, repeats("promises of foresight, starts", 12, 300));
    let (mut steepest, mut promises) = (0.0_f64, 0);
    for (index, start) in starts.iter().enumerate() {
        law.reset();
        let mut camera = FreeCamera::new(&scene, start);
        let (mut spent, mut promised, mut first) = (0.0, f64::INFINITY, None);
        for k in 0..450_u32 {
            let features = camera.features().unwrap();
            let now_ns = (f64::from(k) * ts * 1e9).round() as u64;
            let measured = Measurement::from_points(&features).taken(now_ns, now_ns);
            let step = law.step(&measured, memory).unwrap();
            if step.error_px < scene.success.convergence_px {
                break;
            }
            spent += step.cost / np;
            law.sent(&step.twist, now_ns);
            law.think(memory);
            camera.advance(&step.twist, ts);
            if let Outcome::Arrives { cost, .. } = law.foreseen().outcome {
                let total = spent + cost;
                steepest = steepest.max(total / promised - 1.0);
                promised = total;
                promises += 1;
                first.get_or_insert(total);
            }
        }
        let first = first.expect("a way is known");
        assert!(
            spent <= first * (1.0 + ROUNDING),
            "start {index}: {spent} of {first}"
        );
    }
    tell(format!(
        "{promises} promises from {} starts: the steepest rise {:.2e} of the promise",
        starts.len(),
        steepest
    ));
    assert!(steepest <= ROUNDING, "{steepest}");
}
