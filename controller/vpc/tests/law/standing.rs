//! While the camera stands, because nobody has armed the controller yet, foresight finds better
//! ways, and comes no further on the one that it follows.

use std::sync::atomic::{AtomicUsize, Ordering};

use memory_blob::MemoryFile;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal};
use scene::{Pose, Scene};
use serde_json::Value;
use vpc::foresight::Outcome;
use vpc::way::COMMANDS;
use vpc::{DOF, Law, Measurement, MotionMemory, Settings, Strategy, Twist};

use crate::world::{World, is_long};

/// A scene with fixed starts, and the best known ways from them.
struct Example {
    scene: &'static str,
    starts: &'static str,
    ways: &'static str,
}

const PAPER_SIM: Example = Example {
    scene: scene::PAPER_SIM,
    starts: scene::PAPER_SIM_STARTS,
    ways: include_str!("../../fixtures/oracle-paper-sim.json"),
};
const CUP_DISC_BARS: Example = Example {
    scene: include_str!("../../../../tests/scenes/cup-disc-bars.toml"),
    starts: include_str!("../../../../tests/scenes/cup-disc-bars-starts.csv"),
    ways: include_str!("../../fixtures/oracle-cup-disc-bars.json"),
};

/// For so long a live robot obeys a command, and no image of it repeats another one.
const VALIDITY_NS: u64 = 200_000_000;
const NOISE_PX: f64 = 0.01;

/// What a run cost.
#[derive(Debug)]
struct Run {
    /// Beyond the best known way, %.
    beyond: f64,
    /// Whether a way was known when it was armed.
    was_promised: bool,
    cycles: u32,
    commands: Vec<Twist>,
}

/// A memory of one run.
struct OneRun {
    start: Vec<[f64; 2]>,
    commands: Vec<Twist>,
}

impl MotionMemory for OneRun {
    fn infer(&self, _: Strategy, _: &[f64], _: &mut [f64]) -> bool {
        false
    }

    fn trajectory(
        &self,
        _: &[f64],
        rank: usize,
        periods: f64,
        found: &mut [f64],
        commands: &mut [Twist],
    ) -> Option<()> {
        assert_eq!(periods, 1.0);
        let pairs = found.iter_mut().zip(self.start.iter().flatten());
        pairs.for_each(|(to, from)| *to = *from);
        let own = self.commands.iter().chain(std::iter::repeat(&[0.0; DOF]));
        let pairs = commands.iter_mut().zip(own);
        pairs.for_each(|(to, from)| *to = *from);
        (rank == 1).then_some(())
    }
}

fn is_live() -> bool {
    std::env::var_os("VPC_LIVE").is_some()
}

/// Runs the law from a start after `standing` cycles in which zero is sent.
fn run(
    scene: &Scene,
    memory: Option<&dyn MotionMemory>,
    start: &Pose,
    known: f64,
    standing: u64,
) -> Run {
    let settings = Settings {
        strategy: Strategy::Foresight,
        ..Settings::default()
    };
    let (np, periods) = (settings.np as f64, scene.success.time_s * 30.0);
    let mut law = Law::new(scene, settings, |len| vec![0.0; len]).unwrap();
    let is_live = is_live();
    if is_live {
        law.go_live(VALIDITY_NS);
    }
    let noise = Normal::new(0.0, NOISE_PX).unwrap();
    let mut random = ChaCha8Rng::seed_from_u64(0);
    let mut world = World::of(scene.clone(), start);
    let period = scene.sampling_time();
    let (mut cost, mut promised) = (0.0, f64::INFINITY);
    let mut commands = Vec::new();
    for k in 0..standing + periods as u64 {
        let mut pixels = world.features();
        if is_live {
            let coordinates = pixels.as_flattened_mut().iter_mut();
            coordinates.for_each(|x| *x += noise.sample(&mut random));
        }
        let now_ns = (k as f64 * period * 1e9).round() as u64;
        let measured = Measurement::from_points(&pixels).taken(now_ns, now_ns);
        let step = law.step(&measured, memory).unwrap();
        if k < standing {
            law.sent(&[0.0; DOF], now_ns);
            law.think(memory);
            promised = match law.foreseen().outcome {
                Outcome::Arrives { cost, .. } => cost / periods,
                _ => f64::INFINITY,
            };
            continue;
        }
        if step.error_px < scene.success.convergence_px {
            let cost = cost / periods;
            assert!(
                is_live || cost < 1.1 * promised,
                "{cost}, promised {promised}"
            );
            return Run {
                beyond: 100.0 * (cost / known - 1.0),
                was_promised: promised.is_finite(),
                cycles: (k - standing) as u32,
                commands,
            };
        }
        cost += step.cost / np;
        commands.push(step.twist);
        law.sent(&step.twist, now_ns);
        law.think(memory);
        world.obey(&step.twist, period);
    }
    panic!("not arrived after {standing} standing cycles: {start:?}");
}

#[test]
fn by_half_of_a_command_the_camera_comes_half_a_step_further() {
    let scene = Scene::parse(scene::PAPER_SIM, "sim").unwrap();
    let starts = scene::parse_starts(scene::PAPER_SIM_STARTS, "starts").unwrap();
    let pixels = World::of(scene.clone(), &starts[0]).features();
    let settings = Settings {
        strategy: Strategy::Foresight,
        ..Settings::default()
    };
    let np = settings.np as f64;
    let mut law = Law::new(&scene, settings, |len| vec![0.0; len]).unwrap();
    // What is left of the present command, and of the promised cost, after a cycle in which these
    // shares of the command were sent, one after the other.
    let mut left = |shares: &[f64]| {
        law.reset();
        let measured = Measurement::from_points(&pixels).taken(0, 0);
        let step = law.step(&measured, None).unwrap();
        let before = law.foreseen().outcome;
        for share in shares {
            law.sent(&step.twist.map(|v| share * v), 0);
        }
        law.think(None);
        let (guide, after) = (law.foreseen().guide, law.foreseen().outcome);
        let (Outcome::Arrives { cost: before, .. }, Outcome::Arrives { cost: after, .. }) =
            (before, after)
        else {
            panic!("{before:?}, {after:?}");
        };
        (
            guide.left + f64::from(guide.ahead),
            (before - after) / (step.cost / np),
        )
    };
    let (none, spent) = left(&[0.0]);
    assert_eq!((none, spent), (1.0 + COMMANDS as f64, 0.0));
    for (shares, passed) in [
        (&[0.5][..], 0.5),
        (&[1.0], 1.0),
        (&[0.0, 1.0], 1.0),
        (&[1.0, 0.0], 0.0),
    ] {
        let (rest, spent) = left(shares);
        assert!((none - rest - passed).abs() < 1e-9, "{shares:?}: {rest}");
        assert!((spent - passed).abs() < 1e-9, "{shares:?}: {spent}");
    }
}

/// From these two, together, the best way is found late, and more so from the first one; a memory of
/// a run that had time has it.
#[test]
fn what_a_memory_holds_of_a_start_is_found_from_there() {
    let scene = Scene::parse(scene::PAPER_SIM, "sim").unwrap();
    let starts = scene::parse_starts(scene::PAPER_SIM_STARTS, "starts").unwrap();
    let (mut shorts, mut longs) = (0.0, 0.0);
    let numbers = if is_long() { &[93, 98][..] } else { &[93] };
    for start in numbers.iter().map(|k| &starts[*k]) {
        let run = |memory, standing| run(&scene, memory, start, 1.0, standing);
        let (short, long) = (run(None, 20), run(None, 150));
        let memory = OneRun {
            start: World::of(scene.clone(), start).features(),
            commands: long.commands.clone(),
        };
        let with = run(Some(&memory), 20);
        let [short, long, with] = [&short, &long, &with].map(|run| 1.0 + run.beyond / 100.0);
        println!("without {short:.2}, with a memory {with:.2}, after five seconds {long:.2}");
        assert!(with < 1.02 * long);
        (shorts, longs) = (shorts + short, longs + long);
    }
    assert!(shorts > 1.1 * longs, "nothing was found late");
}

impl Example {
    fn scene(&self) -> Scene {
        Scene::parse(self.scene, "scene").unwrap()
    }

    /// The starts with the cost of the best known way, where one is known.
    fn starts(&self) -> Vec<(Pose, Option<f64>)> {
        let starts = scene::parse_starts(self.starts, "starts").unwrap();
        let known: Value = serde_json::from_str(self.ways).unwrap();
        let ways = known["ways"].as_array().unwrap();
        let cost = |way: &Value| way.get("cost").and_then(Value::as_f64);
        starts.into_iter().zip(ways.iter().map(cost)).collect()
    }
}

/// What runs cost.
struct Costs {
    /// In rising order.
    runs: Vec<Run>,
}

impl Costs {
    /// Of runs from the starts of an example with a known way, after so many standing cycles.
    fn of(example: &Example, memory: Option<&MemoryFile>, standing: u64) -> Self {
        let (scene, starts) = (example.scene(), example.starts());
        let pairs = starts
            .iter()
            .filter_map(|(start, cost)| Some((start, (*cost)?)));
        let pairs: Vec<_> = pairs.collect();
        let next = AtomicUsize::new(0);
        let work = || {
            let view = memory.map(MemoryFile::view);
            let memory = view.as_ref().map(|view| view as &dyn MotionMemory);
            let taken = std::iter::from_fn(|| pairs.get(next.fetch_add(1, Ordering::Relaxed)));
            taken
                .map(|&(start, cost)| run(&scene, memory, start, cost, standing))
                .collect::<Vec<_>>()
        };
        let mut runs = std::thread::scope(|scope| {
            let jobs = [(); 2].map(|()| scope.spawn(work));
            jobs.into_iter()
                .flat_map(|job| job.join().unwrap())
                .collect::<Vec<_>>()
        });
        runs.sort_by(|a, b| a.beyond.total_cmp(&b.beyond));
        let costs = Self { runs };
        costs.tell(standing);
        costs
    }

    /// What this share of the runs does not exceed, % beyond the best known.
    fn at(&self, share: f64) -> f64 {
        self.runs[(share * (self.runs.len() - 1) as f64).round() as usize].beyond
    }

    fn tell(&self, standing: u64) {
        let runs = &self.runs;
        let dear = runs.iter().filter(|run| run.beyond > 20.0).count();
        let cheap = runs.iter().filter(|run| run.beyond < -3.0).count();
        let cycles = runs.iter().map(|run| f64::from(run.cycles)).sum::<f64>() / runs.len() as f64;
        println!(
            "{standing} standing cycles, {} runs: {cycles:.1} cycles; beyond the best known in %: \
             {:.0} (median), {:.0} (nine of ten), {:.0} (most); more than 20 % from {dear}, cheaper by \
             more than 3 % from {cheap}",
            runs.len(),
            self.at(0.5),
            self.at(0.9),
            self.at(1.0)
        );
        let dearest = runs.iter().rev().take(6).map(|run| run.beyond.round());
        println!("the dearest: {:?}", dearest.collect::<Vec<_>>());
    }
}

/// From these starts a way that is sought at once is dear, or none is known when the camera moves.
#[test]
fn a_second_before_it_is_armed_shows_a_better_way() {
    for (example, numbers) in [(&PAPER_SIM, [66, 98]), (&CUP_DISC_BARS, [2, 18])] {
        let (scene, starts) = (example.scene(), example.starts());
        for number in numbers {
            let (start, cost) = starts[number];
            let after = |standing| run(&scene, None, &start, cost.unwrap(), standing);
            let (at_once, later) = (after(0), after(30));
            assert!(
                at_once.beyond > 15.0 && !at_once.was_promised,
                "{number}: {at_once:?}"
            );
            assert!(
                later.beyond < 6.0 && later.was_promised,
                "{number}: {later:?}"
            );
        }
    }
}

/// With `VPC_MEMORY=FILE` by this memory; with `VPC_LIVE` in real time, as the daemon runs the law.
#[test]
#[ignore = "long: 100 starts"]
fn a_second_before_it_is_armed_shows_most_of_the_best_ways() {
    let memory = std::env::var_os("VPC_MEMORY");
    let memory = memory.map(|file| MemoryFile::open(file.as_ref(), None).unwrap());
    for (standing, nine_of_ten, most) in [(0, 30.0, 300.0), (30, 6.0, 15.0)] {
        let costs = Costs::of(&PAPER_SIM, memory.as_ref(), standing);
        let promised = costs.runs.iter().filter(|run| run.was_promised).count();
        let is_most = promised > costs.runs.len() * 8 / 9;
        assert_eq!(is_most, standing > 0, "{promised} promised");
        assert!(costs.at(0.5) < 2.0 && costs.at(0.9) < nine_of_ten);
        assert!(is_live() || costs.at(1.0) < most);
    }
}

/// Starts that chose no setting; the first guesses were chosen on others of this scene.
#[test]
#[ignore = "long: 21 starts"]
fn nor_is_it_dear_from_starts_that_chose_no_setting() {
    for (standing, most) in [(0, 300.0), (30, 15.0)] {
        let costs = Costs::of(&CUP_DISC_BARS, None, standing);
        assert!(costs.at(0.5) < 2.0 && costs.at(1.0) < most);
    }
}
