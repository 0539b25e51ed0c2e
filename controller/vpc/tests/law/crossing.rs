//! Futures that go behind an occlusion on purpose, against a truth of its own: a bar from the upper
//! to the lower side of the image, which nothing goes round.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal};
use scene::{Pose, Scene};
use vpc::obstacle::Obstacle;
use vpc::{Law, Measurement, Refusal, Settings, Strategy};

use crate::world::{INSTANTS, World, taken};

const NOISE_PX: f64 = 0.3;
/// Frames from an exposure to the command that answers it.
const DELAY: usize = 2;

/// The paper's scene with a bar of such a half width, px, instead of its occlusions.
fn scene(half_px: f64, crossable: bool) -> Scene {
    let (head, _) = scene::PAPER_SIM.split_once("[[occlusion]]").unwrap();
    let text = format!(
        "{head}[[occlusion]]\nname = \"bar\"\ncrossable = {crossable}\n\
         parts = [{{ center = [512.0, 512.0], half = [{half_px:?}, 2000.0], p = 8.0 }}]\n"
    );
    Scene::parse(&text, "bar").unwrap()
}

/// Starts at which the whole pattern is beside the bar, with every point in sight.
fn starts() -> Vec<Pose> {
    let goal = scene(4.0, false).goal;
    let aside = [-0.34, -0.32, -0.3, 0.3, 0.32, 0.34].into_iter();
    let turned = aside.flat_map(|x| [-0.2, 0.0, 0.2].map(|roll| (x, roll)));
    let pose = |(x, roll): (f64, f64)| {
        let mut pose = goal;
        pose.translation[0] += x;
        pose.translation[2] += 0.2;
        pose.rotation[2] += roll;
        pose
    };
    turned.map(pose).collect()
}

#[derive(Debug, Default)]
struct Run {
    has_arrived: bool,
    /// The longest time without all points, s.
    blind_s: f64,
    refusals: Vec<Refusal>,
}

/// Runs until the arrival, `seconds` at most.
fn run(scene: &Scene, number: usize, settings: Settings, seconds: f64) -> Run {
    let start = &starts()[number];
    let mut world = World::of(scene.clone(), start);
    let period = scene.sampling_time();
    let mut law = Law::new(scene, settings, |len| vec![0.0; len]).unwrap();
    law.go_live(100_000_000);
    let task = law.task().clone();
    let hidden = |pixel| task.obstacles().any(|each: Obstacle| each.hides(pixel));
    let mut random = ChaCha8Rng::seed_from_u64(number as u64);
    let noise = Normal::new(0.0, NOISE_PX).unwrap();
    let ns = |k: usize| 1_000_000_000 + (k as f64 * period * 1e9).round() as u64;
    let (mut run, mut frames, mut blind_s) = (Run::default(), Vec::new(), 0.0);
    law.sent(&[0.0; 6], ns(0) - 100);
    for k in 0..(seconds / period) as usize {
        let truth = world.features();
        let pairs = truth.iter().flatten().zip(task.goal.iter().flatten());
        let away_px = pairs.map(|(s, goal)| (s - goal).abs()).fold(0.0, f64::max);
        if away_px < scene.success.convergence_px {
            run.has_arrived = true;
            return run;
        }
        let bits = truth.iter().enumerate();
        let visible = bits.fold(0, |bits, (i, &p)| bits | u32::from(!hidden(p)) << i);
        blind_s = if visible == 0b1111 {
            0.0
        } else {
            blind_s + period
        };
        run.blind_s = run.blind_s.max(blind_s);
        frames.push((truth, visible));
        let mut twist = [0.0; 6];
        if let Some(at) = k.checked_sub(DELAY) {
            let (truth, visible) = &frames[at];
            let seen: Vec<_> = (truth.iter())
                .map(|p| p.map(|x| x + noise.sample(&mut random)))
                .collect();
            let seen = Measurement::from_points(&seen).seeing(*visible);
            match law.step(&seen.taken(ns(at), ns(k)), None) {
                Ok(step) => twist = step.twist,
                Err(refusal) => run.refusals.push(refusal),
            }
        }
        law.sent(&twist, ns(k));
        law.think(None);
        for _ in 0..INSTANTS {
            world.obey(&twist, period / INSTANTS as f64);
        }
    }
    run
}

fn settings() -> Settings {
    Settings {
        strategy: Strategy::Foresight,
        brake_s: 0.15,
        ..Settings::default()
    }
}

/// Runs; those that are not to arrive last for twice as long as an arrival takes.
fn runs(scene: &Scene, settings: Settings, arrives: bool) -> Vec<Run> {
    let (few, seconds) = if arrives {
        (&[0, 10][..], 8.0)
    } else {
        (&[0][..], 4.0)
    };
    let numbers = taken(few, 0..starts().len()).into_iter();
    numbers
        .map(|number| run(scene, number, settings, seconds))
        .collect()
}

#[test]
fn a_bar_that_nothing_goes_round_is_crossed_where_the_scene_allows_it() {
    for half_px in [6.0, 25.0, 60.0] {
        for crossable in [false, true] {
            for run in runs(&scene(half_px, crossable), settings(), crossable) {
                assert!(run.refusals.is_empty(), "{half_px}: {run:?}");
                assert_eq!(run.has_arrived, crossable, "{half_px}: {run:?}");
            }
        }
    }
}

#[test]
fn a_future_is_not_blind_for_longer_than_the_settings_say() {
    for (blind_s, arrives) in [(0.0, false), (0.1, false), (0.25, true)] {
        let settings = Settings {
            blind_s,
            ..settings()
        };
        for run in runs(&scene(60.0, true), settings, arrives) {
            assert!(
                run.blind_s <= blind_s && run.has_arrived == arrives,
                "{blind_s}: {run:?}"
            );
        }
    }
}
