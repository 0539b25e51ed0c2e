//! Foresight arrives from starts that no setting was chosen on, no run is deep inside an occlusion
//! at any instant, and in the exact model a run costs no more than was foreseen.

use hw_sim::FreeCamera;
use memory_blob::MemoryFile;
use messages::ClockMode;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal};
use rayon::prelude::*;
use scene::{Pose, Scene};
use system_tests::row::Row;
use system_tests::run::{Run, run};
use system_tests::simulated::Simulated;
use system_tests::spec::Spec;
use testkit::is_long;
use vpc::foresight::Outcome;
use vpc::{Law, Measurement, MotionMemory, Settings, Task};

use crate::fixture::{memory_file, tell};

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

fn memory(scene: &Scene) -> MemoryFile {
    let memory = MemoryFile::open(&memory_file(), Some(scene.fingerprint().bytes()));
    memory.unwrap()
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
            || Simulated::new(&scene, Some(&memory), settings, ClockMode::Fixed).unwrap(),
            |daemon, start| run(&scene, daemon, start),
        )
        .collect();
    let row = Row::of(spec.strategy.to_string(), Some(spec.np), &runs, false);
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

/// The starts of these numbers; with `VPC_LONG=1` so many.
fn taken(few: &[usize], all: usize) -> Vec<Pose> {
    let scene = scene();
    if is_long() {
        return starts(&scene, all);
    }
    let most = few.iter().max().map_or(0, |most| most + 1);
    let starts = starts(&scene, most);
    few.iter().map(|number| starts[*number]).collect()
}

/// From these two the paper's strategies do not arrive.
#[test]
fn foresight_arrives_where_the_papers_strategies_stay_behind() {
    let drawn = starts(&scene(), 47);
    let starts = [drawn[16], drawn[46]];
    let arrive = |text: &str| {
        let (_, runs) = row(text, &starts, |_| ());
        runs.iter().filter(|run| run.success).count()
    };
    let arrivals = ["foresight:3", "previous:3", "gpr:3"].map(arrive);
    assert_eq!(arrivals, [2, 0, 0]);
}

#[test]
#[ignore = "long: 1,000 starts, three strategies"]
fn foresight_arrives_more_often_and_at_less_cost_than_the_papers_strategies() {
    let starts = starts(&scene(), 1000);
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
fn no_run_is_deep_and_without_the_mechanism_some_are() {
    let starts = taken(&[2, 31], 300);
    for text in ["previous:3", "knn:3", "gpr:3", "foresight:3"] {
        let (row, _) = row(text, &starts, |_| ());
        assert!(row.deepest_px <= DEEPEST_PX, "{text}: {}", row.deepest_px);
    }
    let (row, _) = row("previous:3", &starts, |settings| {
        settings.intersample = false;
    });
    assert!(row.deepest_px > 2.0 * DEEPEST_PX, "{}", row.deepest_px);
}

/// A run of the law alone, with an exact camera.
struct Bare {
    has_arrived: bool,
    /// Most cycles in a row without motion far from the goal.
    rest: u32,
    /// By how much the greatest rise of the promised cost exceeds it, as a share.
    steepest: f64,
    /// What the run cost above what was first promised, as a share.
    beyond: f64,
    promises: u32,
}

/// Noise of a camera.
struct Noise {
    px: f64,
    random: ChaCha8Rng,
}

/// Runs the law from a start for the scene's time at most, until the features arrive.
fn bare(
    scene: &Scene,
    memory: Option<&dyn MotionMemory>,
    settings: Settings,
    start: &Pose,
    noise: &mut Noise,
) -> Bare {
    let mut law = Law::new(scene, settings, |len| vec![0.0; len]).unwrap();
    let (ts, np) = (scene.sampling_time(), settings.np as f64);
    let normal = Normal::new(0.0, noise.px).unwrap();
    let mut camera = FreeCamera::new(scene, start);
    let (mut spent, mut promised, mut first, mut rests) = (0.0, f64::INFINITY, None, 0);
    let mut run = Bare {
        has_arrived: false,
        rest: 0,
        steepest: 0.0,
        beyond: 0.0,
        promises: 0,
    };
    for k in 0..(scene.success.time_s / ts) as u32 {
        let mut features = camera.features().unwrap();
        let coordinates = features.iter_mut().flatten();
        coordinates.for_each(|x| *x += normal.sample(&mut noise.random));
        let now_ns = (f64::from(k) * ts * 1e9).round() as u64;
        let measured = Measurement::from_points(&features).taken(now_ns, now_ns);
        let step = law.step(&measured, memory).unwrap();
        run.has_arrived = step.error_px < scene.success.convergence_px;
        if run.has_arrived {
            break;
        }
        let shares = step.twist.iter().zip(law.task().limits);
        let is_still = shares.map(|(v, limit)| v.abs() / limit).fold(0.0, f64::max) < 1e-3;
        let is_far = step.error_px > 10.0 * scene.success.convergence_px;
        rests = if is_still && is_far { rests + 1 } else { 0 };
        run.rest = run.rest.max(rests);
        spent += step.cost / np;
        law.sent(&step.twist, now_ns);
        law.think(memory);
        camera.advance(&step.twist, ts);
        if let Outcome::Arrives { cost, .. } = law.foreseen().outcome {
            let total = spent + cost;
            run.steepest = run.steepest.max(total / promised - 1.0);
            promised = total;
            run.promises += 1;
            first.get_or_insert(total);
        }
    }
    run.beyond = first.map_or(0.0, |first| spent / first - 1.0);
    run
}

/// Runs of the law alone from every start.
fn all_bare(starts: &[Pose], has_memory: bool, settings: Settings, noise_px: f64) -> Vec<Bare> {
    let scene = scene();
    let memory = memory(&scene);
    let run = |(index, start)| {
        let view = memory.view();
        let memory = has_memory.then_some(&view as &dyn MotionMemory);
        let mut noise = Noise {
            px: noise_px,
            random: ChaCha8Rng::seed_from_u64(SEED + index as u64),
        };
        bare(&scene, memory, settings, start, &mut noise)
    };
    starts.par_iter().enumerate().map(run).collect()
}

#[test]
fn in_the_exact_model_a_run_costs_no_more_than_was_foreseen() {
    let starts = taken(&[2, 8], 3000);
    let spec: Spec = "foresight:3".parse().unwrap();
    // The margin for what is not known of a pattern's motion changes from cycle to cycle.
    let settings = Settings {
        drift_compensation: false,
        ..spec.settings()
    };
    for has_memory in [true, false] {
        let runs = all_bare(&starts, has_memory, settings, 0.0);
        let worst = |of: fn(&Bare) -> f64| runs.iter().map(of).fold(0.0, f64::max);
        let (steepest, beyond) = (worst(|run| run.steepest), worst(|run| run.beyond));
        let promises: u32 = runs.iter().map(|run| run.promises).sum();
        tell(format!(
            "{promises} promises from {} starts, memory: {has_memory}: the steepest rise is {steepest:.1e} of the promise, \
             and the dearest run {beyond:.1e} above its first one",
            starts.len(),
        ));
        assert!(promises > 20 * starts.len() as u32);
        assert!(steepest <= ROUNDING && beyond <= ROUNDING);
    }
    // It would be seen: with noise the model is not exact.
    let runs = all_bare(&starts[..2], true, settings, 0.3);
    assert!(runs.iter().all(|run| run.steepest > 1e3 * ROUNDING));
}

#[test]
fn no_run_freezes_within_any_margin() {
    // From this one the law alone comes to rest in front of an occlusion.
    let starts = taken(&[7], 300);
    let margins: &[f64] = if is_long() {
        &[0.0, 2.0, 5.0, 8.0, 12.0, 20.0]
    } else {
        let alone = "previous:3".parse::<Spec>().unwrap().settings();
        assert!(all_bare(&starts, true, alone, 0.0)[0].rest > 60);
        &[0.0, 8.0, 20.0]
    };
    let spec: Spec = "foresight:3".parse().unwrap();
    for &margin_px in margins {
        for noise_px in [0.0, 0.3] {
            let settings = Settings {
                margin_px,
                ..spec.settings()
            };
            let runs = all_bare(&starts, true, settings, noise_px);
            let arrived = runs.iter().filter(|run| run.has_arrived).count();
            let rest = runs.iter().map(|run| run.rest).max().unwrap();
            tell(format!(
                "margin {margin_px} px, noise {noise_px} px: {arrived} of {} arrive, at rest for {rest} cycles at most",
                runs.len()
            ));
            assert_eq!(arrived, runs.len(), "margin {margin_px}, noise {noise_px}");
            assert!(rest <= 10, "margin {margin_px}, noise {noise_px}: {rest}");
        }
    }
}

#[test]
fn a_refused_plan_is_not_tried_for_ever() {
    // Within a margin of 10 px the plan from here is a local minimum that the last check refuses.
    let start = Pose {
        translation: [0.3203824370779994, -0.1961089265896908, 0.9669374209814583],
        rotation: [
            -0.10082193339033213,
            -0.34914504677574354,
            0.8344904625871906,
        ],
    };
    for text in ["foresight:3", "previous:3"] {
        let spec: Spec = text.parse().unwrap();
        let settings = Settings {
            margin_px: 10.0,
            ..spec.settings()
        };
        let [run] = &all_bare(&[start], true, settings, 0.0)[..] else {
            unreachable!("one start");
        };
        assert!(run.has_arrived && run.rest <= 1, "{text}: {}", run.rest);
    }
}
