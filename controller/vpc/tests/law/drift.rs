//! The law and a pattern that moves, against a truth of its own.

use nalgebra::Vector3;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal};
use scene::Pose;
use vpc::{DOF, Law, Measurement, Refusal, Settings, Strategy, constraint};

use crate::world::{INSTANTS, Own, World, is_long, taken};

/// How a run goes.
struct Trial {
    own: Own,
    noise_px: f64,
    /// Frames from an exposure to the command that answers it.
    delay: usize,
    /// Of the actuator.
    gain: f64,
    drift_compensation: bool,
    /// The cycle from which the image stays as it is, but for its noise.
    stuck: usize,
    /// Cycles after its arrival at which a run ends.
    after: usize,
    /// The longest that it takes, s.
    seconds: f64,
}

impl Default for Trial {
    fn default() -> Self {
        Self {
            own: |_| [0.0; DOF],
            noise_px: 0.3,
            delay: 4,
            gain: 1.0,
            drift_compensation: true,
            stuck: usize::MAX,
            after: usize::MAX,
            seconds: 8.0,
        }
    }
}

/// What it led to.
#[derive(Debug, Default)]
struct Run {
    /// Cycles until every feature was at the goal.
    cycles: Option<usize>,
    /// Feature error from a second after that on, RMS, px.
    error_px: f64,
    /// Distance between the pattern and where it should be, meanwhile, RMS, mm.
    away_mm: f64,
    /// Mean change of the command from a second after the arrival on, as a share of the limits.
    change: f64,
    /// How deep a point was in an occlusion or outside the image, px.
    deepest_px: f64,
    /// Way of the camera after the image stuck, m.
    way_m: f64,
    /// The first refusal.
    refusal: Option<Refusal>,
}

/// Mean and count of some numbers.
#[derive(Default)]
struct Mean(f64, f64);

impl Mean {
    fn add(&mut self, x: f64) {
        self.0 += x;
        self.1 += 1.0;
    }

    fn get(&self) -> f64 {
        self.0 / self.1.max(1.0)
    }
}

/// A run from the start of this number.
fn run(trial: &Trial, number: usize) -> Run {
    let mut world = World::new(&starts()[number]);
    let scene = world.scene.clone();
    let period = scene.sampling_time();
    let settings = Settings {
        strategy: Strategy::Foresight,
        drift_compensation: trial.drift_compensation,
        brake_s: 0.25,
        ..Settings::default()
    };
    let mut law = Law::new(&scene, settings, |len| vec![0.0; len]).unwrap();
    law.go_live(100_000_000);
    let task = law.task().clone();
    let goal = task.goal.as_flattened();
    let mut random = ChaCha8Rng::seed_from_u64(number as u64);
    let noise = Normal::new(0.0, trial.noise_px).unwrap();
    let ns = |k: usize| 1_000_000_000 + (k as f64 * period * 1e9).round() as u64;
    let (mut run, mut frames, mut standing) = (Run::default(), Vec::new(), [0.0; DOF]);
    let (mut errors, mut changes, mut away) = (Mean::default(), Mean::default(), Mean::default());
    law.sent(&standing, ns(0) - 100);
    for k in 0..(trial.seconds / period) as usize {
        let truth = world.features();
        let each = || {
            truth
                .as_flattened()
                .iter()
                .zip(goal)
                .map(|(s, goal)| s - goal)
        };
        let error_px = each().map(f64::abs).fold(0.0, f64::max);
        if run.cycles.is_none() && error_px <= scene.success.convergence_px {
            run.cycles = Some(k);
        }
        if run.cycles.is_some_and(|at| k - at >= trial.after) {
            break;
        }
        frames.push(truth.clone());
        let mut twist = [0.0; DOF];
        if let Some(at) = k.checked_sub(trial.delay) {
            let seen = frames[at.min(trial.stuck)].iter();
            let seen: Vec<_> = seen
                .map(|p| p.map(|x| x + noise.sample(&mut random)))
                .collect();
            let seen = Measurement::from_points(&seen).taken(ns(at), ns(k));
            match law.step(&seen, None) {
                Ok(step) => twist = step.twist,
                Err(refusal) => run.refusal = run.refusal.or(Some(refusal)),
            }
        }
        if run.refusal.is_some() && trial.stuck < k {
            return run;
        }
        law.sent(&twist, ns(k));
        law.think(None);
        if run.cycles.is_some_and(|at| k >= at + 30) {
            each().for_each(|e| errors.add(e * e));
            let off = world.origin[0] - Vector3::from(scene.goal.translation);
            away.add(off.norm_squared());
            for (limit, (a, b)) in task.limits.iter().zip(twist.iter().zip(&standing)) {
                changes.add((a - b).abs() / limit);
            }
        }
        if k > trial.stuck {
            run.way_m += period * Vector3::new(twist[0], twist[1], twist[2]).norm();
        }
        standing = twist;
        for _ in 0..INSTANTS {
            let moved = twist.map(|v| trial.gain * v);
            world.go(&moved, trial.own, period / INSTANTS as f64);
            for pixel in world.features() {
                run.deepest_px = run.deepest_px.max(constraint::violation(&task, pixel, 0.0));
            }
        }
    }
    (run.error_px, run.away_mm) = (errors.get().sqrt(), 1e3 * away.get().sqrt());
    run.change = changes.get();
    run
}

fn starts() -> Vec<Pose> {
    scene::parse_starts(scene::PAPER_SIM_STARTS, "starts").unwrap()
}

/// Runs from the starts of these numbers.
fn runs(trial: &Trial, numbers: &[usize]) -> Vec<Run> {
    numbers.iter().map(|number| run(trial, *number)).collect()
}

/// Cycles until the arrival, on average.
fn mean_cycles(runs: &[Run]) -> f64 {
    let mut mean = Mean::default();
    for run in runs {
        mean.add(run.cycles.expect("it arrives") as f64);
    }
    mean.get()
}

#[test]
fn a_pattern_that_moves_is_followed() {
    let motions: [Own; 4] = [
        |_| [0.01, 0.0, 0.0, 0.0, 0.0, 0.0],
        |_| [0.03, 0.0, 0.0, 0.0, 0.0, 0.0],
        |_| [0.1, 0.0, 0.0, 0.0, 0.0, 0.0],
        |_| [0.0, 0.0, 0.0, 0.0, 0.0, 0.2],
    ];
    let numbers = taken(&[40], 40..46);
    for own in motions {
        let follows = Trial {
            own,
            after: 90,
            ..Trial::default()
        };
        for run in runs(&follows, &numbers) {
            assert!(run.cycles.is_some() && run.refusal.is_none(), "{run:?}");
            assert!(run.error_px < 0.3 && run.deepest_px < 3.0, "{run:?}");
        }
        // A law that believes that it rests stays behind.
        let lags = Trial {
            own,
            drift_compensation: false,
            seconds: 4.0,
            ..Trial::default()
        };
        assert!(runs(&lags, &numbers).iter().all(|run| run.cycles.is_none()));
    }
}

#[test]
fn a_circle_is_followed_to_two_millimetres() {
    let own: Own = |t| [0.1 * t.cos(), 0.1 * t.sin(), 0.0, 0.0, 0.0, 0.0];
    let mut squares = Mean::default();
    let trial = Trial {
        own,
        ..Trial::default()
    };
    for run in runs(&trial, &taken(&[40, 41], 40..46)) {
        assert!(run.cycles.is_some() && run.refusal.is_none(), "{run:?}");
        squares.add(run.away_mm * run.away_mm);
    }
    let away_mm = squares.get().sqrt();
    assert!(away_mm < 2.0, "{away_mm}");
}

#[test]
fn a_pattern_at_rest_costs_little() {
    let of = |drift_compensation| {
        let trial = Trial {
            drift_compensation,
            after: 90,
            ..Trial::default()
        };
        runs(&trial, &taken(&[40, 41], 40..70))
    };
    let (with, without) = (of(true), of(false));
    // Until the pattern is known to be at rest, ways keep farther from borders.
    let (with_s, without_s) = (mean_cycles(&with), mean_cycles(&without));
    assert!(with_s < 1.06 * without_s, "{with_s} instead of {without_s}");
    assert!(
        with.iter()
            .all(|run| run.change < 0.002 && run.error_px < 0.1),
        "{with:?}"
    );
}

#[test]
fn a_wrong_gain_is_no_motion_of_the_pattern() {
    for gain in [0.8, 1.2] {
        let of = |drift_compensation| {
            let trial = Trial {
                gain,
                drift_compensation,
                after: 0,
                ..Trial::default()
            };
            mean_cycles(&runs(&trial, &taken(&[41, 48], 40..70)))
        };
        let (with, without) = (of(true), of(false));
        assert!(with < 1.05 * without, "{gain}: {with} instead of {without}");
    }
}

#[test]
fn a_pattern_is_followed_with_a_wrong_gain() {
    let own: Own = |_| [0.1, 0.0, 0.0, 0.0, 0.0, 0.0];
    for gain in [0.8, 1.2] {
        let trial = Trial {
            own,
            gain,
            after: 90,
            ..Trial::default()
        };
        for run in runs(&trial, &taken(&[40, 41], 40..46)) {
            assert!(run.error_px < 0.3 && run.cycles.is_some(), "{gain} {run:?}");
        }
    }
}

#[test]
fn an_image_that_sticks_is_not_taken_for_motion() {
    for stuck in [10, 20, 30] {
        let trial = Trial {
            stuck,
            ..Trial::default()
        };
        for run in runs(&trial, &taken(&[40, 41], 40..46)) {
            let is_noticed = matches!(run.refusal, Some(Refusal::NotFollowing { .. }));
            assert!(is_noticed && run.way_m < 0.6, "{stuck}: {run:?}");
        }
    }
}

#[test]
fn a_camera_that_begins_again_elsewhere_teaches_nothing() {
    let starts = starts();
    let starts = &starts[..if is_long() { 30 } else { 12 }];
    let scene = World::new(&starts[0]).scene;
    let seen = |start| Measurement::from_points(&World::new(start).features());
    let ns = |k: usize| 1_000_000_000 + k as u64 * 33_333_333;
    let fresh = Law::new(&scene, Settings::default(), |len| vec![0.0; len]).unwrap();
    let mut count = 0;
    for (k, before) in starts.iter().enumerate() {
        for (j, after) in starts.iter().enumerate() {
            let mut law = fresh.clone();
            law.go_live(100_000_000);
            // It moves, stops, and begins again at once or after a pause.
            let (still, moves) = ([0.0; DOF], [0.2, -0.1, -0.2, 0.1, 0.3, -0.3]);
            law.sent(&still, ns(0) - 1);
            law.step(&seen(before).taken(ns(0), ns(0)), None).unwrap();
            let pause = [2, 12][(k + j) % 2];
            for at in 0..pause + 3 {
                let is_back = at >= pause;
                if at == pause {
                    law.reset();
                }
                if is_back && law.step(&seen(after).taken(ns(at), ns(at)), None).is_ok() {
                    count += 1;
                    assert_eq!(*law.drift(), [0.0; DOF], "{k} {j}");
                }
                let is_moving = at < 6.min(pause);
                law.sent(if is_moving { &moves } else { &still }, ns(at));
            }
        }
    }
    assert!(count > starts.len() * starts.len() / 5, "{count}");
}
