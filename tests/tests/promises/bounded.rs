//! Bounded work: a million random, ill-conditioned, infeasible and meaningless problems. Each is
//! answered with a command that is finite and inside the limits, or refused; iterations and counted
//! work never pass their bounds. The worst counted work is at most three times the median of the
//! problems that begin inside an occlusion, and ten times that of those that begin clear of all,
//! for windows of 3, 10 and 30 steps.

use hw_sim::FreeCamera;
use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use scene::Scene;
use vpc::gate::{check_sense, check_shape};
use vpc::solver::Size;
use vpc::work::Prices;
use vpc::{Law, Measurement, Settings, SettingsError, Strategy, Task, constraint};

use crate::fixture::{repeats, speed, tell};

const SIZE: f64 = 1024.0;
/// Bound of the worst counted work, in medians of the problems that begin clear of all occlusions,
/// and of the others.
const MOST: [u32; 2] = [10, 3];

/// Points that the gate lets pass: see [`any_points`].
fn points(task: &Task, scene: &Scene, random: &mut impl Rng) -> [[f64; 2]; 4] {
    loop {
        let points = any_points(scene, random);
        // Each order of them is as good as any.
        for order in [
            [0, 1, 2, 3],
            [0, 2, 1, 3],
            [0, 1, 3, 2],
            [3, 2, 1, 0],
            [3, 1, 2, 0],
            [2, 3, 1, 0],
        ] {
            let ordered = order.map(|i| points[i]);
            let seen = ordered.into();
            if check_shape(task, &seen).is_ok() && check_sense(task, &seen).is_ok() {
                return ordered;
            }
        }
    }
}

/// Four points: at random, tiny, huge, or two of them as close as points can be; every other set
/// reaches into an occlusion, where no plan is feasible and the solver looks longest.
fn any_points(scene: &Scene, random: &mut impl Rng) -> [[f64; 2]; 4] {
    let kind = random.random_range(0..4);
    let size = match kind {
        0 => random.random_range(0.5..3.0),
        1 => random.random_range(200.0..500.0),
        _ => random.random_range(20.0..200.0),
    };
    let mut points: [[f64; 2]; 4] =
        std::array::from_fn(|_| std::array::from_fn(|_| size * random.random_range(-1.0..1.0)));
    let parts: Vec<_> = scene
        .occlusions
        .iter()
        .flat_map(|occlusion| &occlusion.parts)
        .collect();
    let part = parts[random.random_range(0..parts.len())];
    let place: [f64; 2] = if random.random_bool(0.5) {
        // The first point is inside.
        std::array::from_fn(|c| {
            part.center[c] + part.half[c] * random.random_range(-0.9..0.9) - points[0][c]
        })
    } else {
        std::array::from_fn(|_| random.random_range(0.0..SIZE))
    };
    for point in &mut points {
        *point = std::array::from_fn(|c| (point[c] + place[c]).clamp(0.0, SIZE - 1.0));
    }
    if kind == 3 {
        points[2] = [points[0][0] + 0.51, points[0][1]];
    }
    points
}

/// Features that no camera should send.
fn meaningless(random: &mut impl Rng) -> [[f64; 2]; 4] {
    let numbers = [f64::NAN, f64::INFINITY, f64::MAX, -1e300, 1e9, 0.0];
    std::array::from_fn(|_| std::array::from_fn(|_| numbers[random.random_range(0..numbers.len())]))
}

fn check(np: usize, problems: usize) {
    let scene = Scene::parse(scene::PAPER_SIM, "sim").unwrap();
    let settings = Settings {
        np,
        ..Settings::default()
    };
    let mut controller = Law::new(&scene, settings, |len| vec![0.0; len]).unwrap();
    let task = controller.task().clone();
    let prices = Prices::of(Size::of(&task, np, settings.nc));
    let budget = prices.budget(settings.iterations);
    let bound = prices.decision(budget);
    let mut random = ChaCha8Rng::seed_from_u64(np as u64);
    // Of problems that begin clear of all occlusions, and of the others.
    let mut worked = [Vec::new(), Vec::new()];
    let mut refused = 0;
    for _ in 0..problems {
        let is_meaningless = random.random_bool(0.05);
        let points = if is_meaningless {
            meaningless(&mut random)
        } else {
            points(&task, &scene, &mut random)
        };
        let Ok(step) = controller.step(&Measurement::from_points(&points), None) else {
            refused += 1;
            continue;
        };
        assert!(speed(&step.twist) <= 1.0, "{points:?}: {:?}", step.twist);
        // Two starts, each with its iterations and its share of the budget.
        assert!(step.iterations <= 2 * settings.iterations);
        assert!(step.work <= bound, "{points:?}: {} > {bound}", step.work);
        let inside = points
            .iter()
            .any(|&p| constraint::violation(&task, p, 0.0) > 0.0);
        worked[usize::from(inside)].push(step.work);
    }
    assert!(refused > problems / 50);
    assert!(worked.iter().all(|worked| worked.len() > problems / 5));
    let worst = *worked.iter().flatten().max().unwrap();
    for ((worked, begin), most) in worked.iter_mut().zip(["clear of", "inside"]).zip(MOST) {
        worked.sort_unstable();
        let median = worked[worked.len() / 2];
        tell(format!(
            "np {np}: {} problems that begin {begin} occlusions: median of counted work {median}; worst of all {worst}, \
             {:.2} times as much",
            worked.len(),
            f64::from(worst) / f64::from(median)
        ));
        assert!(
            worst <= most * median,
            "np {np}: {worst} > {most} x {median}"
        );
    }
}

#[test]
fn hard_problems_take_no_more_than_three_times_the_usual_work() {
    let problems = repeats("hard problems", 4_000, 1_000_000);
    let longer = repeats("hard problems with longer windows", 1_000, 100_000);
    check(3, problems);
    check(10, longer);
    check(30, longer);
}

/// A scene with 8 points and 47 round or rounded parts between them.
fn dense(exponent: f64) -> Scene {
    let mut random = ChaCha8Rng::seed_from_u64(47);
    let head = scene::PAPER_SIM.split_once("points =").unwrap().0;
    let tail = scene::PAPER_SIM.split_once("[goal]").unwrap().1;
    let tail = tail.split_once("# An occlusion").unwrap().0;
    let corner = |k: u32| (std::f64::consts::TAU * (f64::from(k) + 0.5) / 8.0).sin_cos();
    let points = (0..8)
        .map(corner)
        .map(|(y, x)| format!("[{}, {}, 0.0]", 0.2 * x, 0.2 * y));
    let points = Vec::from_iter(points).join(", ");
    let mut text = format!("{head}points = [{points}]\n\n[goal]{tail}");
    // The goal has its points on a circle of this radius about the image's centre.
    let circle = 800.0 * 0.2 / 0.6;
    let mut part = || loop {
        let [u, v] = [0, 1].map(|_| random.random_range(20.0..SIZE - 20.0));
        let away: f64 = (u - 0.5 * SIZE).hypot(v - 0.5 * SIZE) - circle;
        if away.abs() > 60.0 {
            break format!(
                "{{ center = [{u:.1}, {v:.1}], half = [12.0, 12.0], p = {exponent:?} }}"
            );
        }
    };
    for occlusion in 0..6 {
        let parts = Vec::from_iter((0..if occlusion < 5 { 8 } else { 7 }).map(|_| part()));
        let parts = parts.join(", ");
        text += &format!("[[occlusion]]\nname = \"group {occlusion}\"\nparts = [{parts}]\n");
    }
    let scene = Scene::parse(&text, "dense.toml").unwrap();
    assert_eq!((scene.pattern.len(), scene.parts().count()), (8, 47));
    scene
}

#[test]
fn thinking_ahead_is_bounded_by_what_a_step_costs() {
    let starts = repeats("starts among 47 parts", 2, 100);
    for (scene, np) in [
        (Scene::parse(scene::PAPER_SIM, "sim").unwrap(), 3),
        (Scene::parse(scene::PAPER_SIM, "sim").unwrap(), 30),
        (dense(8.0), 3),
        (dense(8.0), 10),
        (dense(3.0), 10),
    ] {
        let settings = Settings {
            strategy: Strategy::Foresight,
            np,
            ..Settings::default()
        };
        let mut law = Law::new(&scene, settings, |len| vec![0.0; len]).unwrap();
        let task = law.task().clone();
        let prices = Prices::of(Size::of(&task, np, 1));
        // The step that passes the share of the period is the last.
        let share = (0.2 * 1e9 * task.period) as u64;
        let budget = prices.budget(settings.iterations);
        let most = share + 2 * u64::from(prices.decision(budget));
        let mut random = ChaCha8Rng::seed_from_u64(7);
        let (mut thought, mut greatest) = (0, 0);
        for _ in 0..starts {
            let start = memory_builder::start::draw(&scene, &mut random);
            let mut camera = FreeCamera::new(&scene, &start);
            law.reset();
            for k in 0..40_u64 {
                let now_ns = (k as f64 * task.period * 1e9).round() as u64;
                let Ok(features) = camera.features() else {
                    break;
                };
                let measured = Measurement::from_points(&features).taken(now_ns, now_ns);
                let Ok(step) = law.step(&measured, None) else {
                    break;
                };
                law.sent(&step.twist, now_ns);
                law.think(None);
                camera.advance(&step.twist, task.period);
                let work = law.foreseen().work;
                assert!(work <= most, "np {np}: {work} > {most}");
                greatest = greatest.max(work);
                thought += u32::from(law.foreseen().simulated > 0);
            }
        }
        tell(format!(
            "np {np}, {} points, {} parts: {:.1} ms of counted work in a cycle at most, of a period of {:.1} ms",
            task.pattern.len(),
            task.parts.len(),
            1e-6 * greatest as f64,
            1e3 * task.period
        ));
        assert!(thought > 5, "np {np}: {thought}");
    }
}

#[test]
fn a_window_too_long_for_the_period_is_refused() {
    let settings = |np| Settings {
        strategy: Strategy::Foresight,
        np,
        nc: 2,
        ..Settings::default()
    };
    let mut scene = dense(3.0);
    scene.camera.rate_hz = 120.0;
    let new = |np| Law::new(&scene, settings(np), |len| vec![0.0; len]).map(|_| ());
    let Err(SettingsError::Window { most, .. }) = new(40) else {
        unreachable!("np 40 has no room");
    };
    assert!((2..40).contains(&most), "{most}");
    assert_eq!(new(most), Ok(()));
    let refused = new(most + 1).unwrap_err().to_string();
    let words = format!("np = {} with nc = 2, 8 points, 47 parts", most + 1);
    assert!(refused.starts_with(&words), "{refused}");
    assert!(
        refused.contains(&format!("np of at most {most}")),
        "{refused}"
    );
}
