//! Bounded work: a million random, ill-conditioned, infeasible and meaningless problems. Each is
//! answered with a command that is finite and inside the limits, or refused; iterations and counted
//! work never pass their bounds. The worst counted work is at most three times the median of the
//! problems that begin inside an occlusion, and ten times that of those that begin clear of all,
//! for windows of 3, 10 and 30 steps.

use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use scene::Scene;
use vpc::gate::{check_sense, check_shape};
use vpc::work;
use vpc::{Controller, Measurement, Settings, Task, constraint};

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
    let mut controller = Controller::new(&scene, settings, |len| vec![0.0; len]).unwrap();
    let task = controller.task().clone();
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
        // Two starts, each with its iterations and its share of the budget, which an iteration that
        // has begun may pass by its expansion and the evaluations of its line search.
        let iterations = settings.solver.max_iterations;
        assert!(step.iterations <= 2 * iterations);
        let beyond = work::expansion(np) + 13 * work::most_evaluation(np);
        let bound = work::budget(np, iterations) + 2 * beyond;
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
    let problems = repeats("hard problems", 10_000, 1_000_000);
    let longer = repeats("hard problems with longer windows", 5_000, 100_000);
    check(3, problems);
    check(10, longer);
    check(30, longer);
}
