//! Bounded work: a million random, ill-conditioned, infeasible and meaningless problems. Each is
//! answered with a command that is finite and inside the limits, or refused; iterations and counted
//! work never pass their bounds, and the worst counted work is at most three times the median, for
//! windows of 3, 10 and 30 steps.

use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use scene::Scene;
use vpc::gate::{check_sense, check_shape};
use vpc::work;
use vpc::{Controller, Measurement, Settings, Task};

use crate::fixture::{repeats, speed, tell};

const SIZE: f64 = 1024.0;
/// Bound of the worst counted work, in medians.
const MOST: u32 = 3;

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

/// Four points: at random, tiny, huge, or two of them as close as points can be; most sets reach
/// into an occlusion, where no plan is feasible and the solver looks longest.
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
    let place: [f64; 2] = if random.random_bool(0.95) {
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
    let mut controller = Controller::new(&scene, settings).unwrap();
    let task = controller.task().clone();
    let mut random = ChaCha8Rng::seed_from_u64(np as u64);
    let mut worked = Vec::new();
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
        worked.push(step.work);
    }
    worked.sort_unstable();
    let (median, worst) = (worked[worked.len() / 2], worked[worked.len() - 1]);
    tell(format!(
        "np {np}: {problems} problems, {refused} refused; counted work: median {median}, worst {worst}, ratio {:.2}",
        f64::from(worst) / f64::from(median)
    ));
    assert!(
        worst <= MOST * median,
        "np {np}: {worst} > {MOST} x {median}"
    );
    assert!(refused > problems / 50 && worked.len() > problems / 2);
}

#[test]
fn hard_problems_take_no_more_than_three_times_the_usual_work() {
    let problems = repeats("hard problems", 20_000, 1_000_000);
    let longer = repeats("hard problems with longer windows", 10_000, 100_000);
    // The controller is some 600 KB and moves through several frames.
    let test = std::thread::Builder::new().stack_size(64 << 20);
    let test = test.spawn(move || {
        check(3, problems);
        check(10, longer);
        check(30, longer);
    });
    test.unwrap().join().unwrap();
}
