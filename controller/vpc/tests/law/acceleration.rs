//! Limits of acceleration: no command changes faster, and at every instant the camera can be braked
//! before a feature is lost.

use nalgebra::Vector3;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use scene::{Limits, Pose, Scene};
use vpc::motion::Motion;
use vpc::{Law, Measurement, Settings, Strategy, Task, Twist, camera, constraint, features, task};

use crate::world::{is_long, taken};

const ACCELERATION: Limits = Limits {
    linear: 0.5,
    angular: 1.0,
    linear_acceleration: Some(2.0),
    angular_acceleration: Some(4.0),
};
/// Instants of a period that are judged.
const INSTANTS: u32 = 12;
/// What the referee allows between the frames, px.
const DEEPEST_PX: f64 = 3.0;

/// What a run from one start came to.
#[derive(Debug, Default)]
struct Seen {
    /// Greatest change of a component, as a share of what a period allows.
    change: f64,
    /// Deepest point while the camera is braked, from any cycle of the run, px.
    deepest_px: f64,
    /// Cycles until it arrived.
    cycles: Option<u32>,
}

/// The depth of the deepest point, px; `None` where one is behind the camera.
fn depth(task: &Task, points: &[Vector3<f64>]) -> Option<f64> {
    let mut depths = points.iter().map(|x| {
        let pixel = camera::project(&task.camera, (*x).into())?;
        Some(constraint::violation(task, pixel, 0.0))
    });
    depths.try_fold(0.0, |worst: f64, depth| Some(worst.max(depth?)))
}

fn moved(points: &[Vector3<f64>], twist: &Twist, seconds: f64) -> Vec<Vector3<f64>> {
    let motion = Motion::of_camera(twist, seconds);
    points.iter().map(|x| motion.apply(x)).collect()
}

/// Runs the law from a start until it arrives; an arm that obeys exactly is braked from every cycle, in thought, as
/// fast as `judge` allows.
fn run(law: &Scene, judge: &Task, start: &Pose, strategy: Strategy) -> Seen {
    let settings = Settings {
        strategy,
        ..Settings::default()
    };
    let mut controller = Law::new(law, settings, |len| vec![0.0; len]).unwrap();
    let mut points: Vec<_> = task::placed(&law.pattern, start).collect();
    let (mut seen, mut standing) = (Seen::default(), [0.0; 6]);
    let period = law.sampling_time();
    for k in 0..300_u64 {
        let pixels: Vec<_> = points
            .iter()
            .map(|x| camera::project(&judge.camera, (*x).into()).unwrap())
            .collect();
        let now_ns = (k as f64 * period * 1e9).round() as u64;
        let step = controller
            .step(
                &Measurement::from_points(&pixels).taken(now_ns, now_ns),
                None,
            )
            .unwrap();
        controller.sent(&step.twist, now_ns);
        controller.think(None);
        let change: Twist = std::array::from_fn(|i| step.twist[i] - standing[i]);
        seen.change = seen.change.max(judge.stop_s(&change) / period);
        standing = step.twist;
        points = moved(&points, &standing, period);
        // The stop that could begin here.
        let (mut twist, mut braked) = (standing, points.clone());
        while twist != [0.0; 6] {
            let share = (1.0 - period / judge.stop_s(&twist)).max(0.0);
            twist = twist.map(|v| share * v);
            for _ in 0..INSTANTS {
                braked = moved(&braked, &twist, period / f64::from(INSTANTS));
                let depth = depth(judge, &braked).unwrap_or(f64::INFINITY);
                seen.deepest_px = seen.deepest_px.max(depth);
            }
        }
        if step.error_px < law.success.convergence_px {
            seen.cycles = Some(k as u32);
            break;
        }
    }
    seen
}

/// Stops at a random instant, also between two commands, and slows down evenly then: the depth of
/// the deepest point, px, or `None` if the camera had arrived before.
fn stopped(law: &Scene, judge: &Task, start: &Pose, random: &mut ChaCha8Rng) -> Option<f64> {
    let settings = Settings {
        strategy: Strategy::Foresight,
        ..Settings::default()
    };
    let mut controller = Law::new(law, settings, |len| vec![0.0; len]).unwrap();
    let mut points: Vec<_> = task::placed(&law.pattern, start).collect();
    let period = law.sampling_time();
    let stop_s: f64 = random.random_range(0.0..2.0);
    for k in 0.. {
        let pixels: Vec<_> = points
            .iter()
            .map(|x| camera::project(&judge.camera, (*x).into()).unwrap())
            .collect();
        if features::largest_error(&pixels, &judge.goal) < law.success.convergence_px {
            return None;
        }
        let begin_s = f64::from(k) * period;
        let now_ns = (begin_s * 1e9).round() as u64;
        let measured = Measurement::from_points(&pixels).taken(now_ns, now_ns);
        let twist = controller.step(&measured, None).unwrap().twist;
        controller.sent(&twist, now_ns);
        controller.think(None);
        let before_s = (stop_s - begin_s).min(period);
        let brakes_s = judge.stop_s(&twist);
        if before_s == period || brakes_s == 0.0 {
            points = moved(&points, &twist, period);
            continue;
        }
        let depth = |x: f64| {
            // x: the time since the command, s; how far it has gone, in seconds of the command.
            let braked_s = (x - before_s).clamp(0.0, brakes_s);
            let held_s = x.min(before_s) + braked_s * (1.0 - 0.5 * braked_s / brakes_s);
            depth(judge, &moved(&points, &twist, held_s)).unwrap_or(f64::INFINITY)
        };
        let instants = (0..=1000).map(|i| f64::from(i) / 1000.0 * (before_s + brakes_s));
        return Some(instants.map(depth).fold(0.0, f64::max));
    }
    None
}

#[test]
fn no_point_is_lost_by_a_stop_at_a_random_instant() {
    let mut scene = Scene::parse(scene::PAPER_SIM, "paper-sim").unwrap();
    let starts = scene::parse_starts(scene::PAPER_SIM_STARTS, "starts").unwrap();
    let unlimited = scene.clone();
    let numbers = taken(&[12, 36, 43, 73, 76, 82], 0..starts.len());
    let (mut stops, mut deepest_px, mut too_deep) = (0, 0.0_f64, 0);
    for share in [0.25, 0.4, 0.6, 1.0] {
        scene.limits = ACCELERATION;
        scene.limits.linear_acceleration = Some(share * 2.0);
        scene.limits.angular_acceleration = Some(share * 4.0);
        let judge = Task::new(&scene).unwrap();
        for &number in &numbers {
            let stopped = |law: &Scene| {
                let mut random = ChaCha8Rng::seed_from_u64(number as u64);
                stopped(law, &judge, &starts[number], &mut random)
            };
            if let Some(depth_px) = stopped(&scene) {
                assert!(depth_px < DEEPEST_PX, "{share} {number}: {depth_px}");
                (stops, deepest_px) = (stops + 1, deepest_px.max(depth_px));
            }
            // A law that does not know the limits comes too fast.
            too_deep += usize::from(stopped(&unlimited).is_some_and(|px| px > DEEPEST_PX));
        }
    }
    println!("{stops} stops, deepest {deepest_px:.2} px; {too_deep} of a law without limits");
    assert!(
        stops >= 3 * numbers.len() && 10 * too_deep > stops,
        "{stops} {too_deep}"
    );
}

/// Cycles until the features arrive, on average.
fn cycles(scene: &Scene, starts: &[Pose]) -> f64 {
    let judge = Task::new(scene).unwrap();
    let numbers = taken(&[20, 70], 0..starts.len()).into_iter();
    let all = numbers.map(|number| {
        let seen = run(scene, &judge, &starts[number], Strategy::Foresight);
        f64::from(seen.cycles.expect("it arrives"))
    });
    let all: Vec<f64> = all.collect();
    all.iter().sum::<f64>() / all.len() as f64
}

#[test]
fn ramps_cost_no_more_than_their_time() {
    let mut scene = Scene::parse(scene::PAPER_SIM, "paper-sim").unwrap();
    let starts = scene::parse_starts(scene::PAPER_SIM_STARTS, "starts").unwrap();
    let unlimited = cycles(&scene, &starts);
    scene.limits = Limits {
        linear_acceleration: Some(0.5),
        angular_acceleration: Some(1.0),
        ..ACCELERATION
    };
    let limited = cycles(&scene, &starts);
    // From rest to the limits takes a second, and so does the stop.
    let most = 1.3 * unlimited + 2.0 * scene.camera.rate_hz;
    assert!(limited < most, "{limited} {unlimited}");
}

#[test]
fn commands_keep_the_acceleration_and_stop_before_constraints() {
    let mut scene = Scene::parse(scene::PAPER_SIM, "paper-sim").unwrap();
    let unlimited = scene.clone();
    scene.limits = ACCELERATION;
    let judge = Task::new(&scene).unwrap();
    let starts = scene::parse_starts(scene::PAPER_SIM_STARTS, "starts").unwrap();
    let (mut arrived, mut too_deep) = (0, 0);
    let numbers: Vec<usize> = if is_long() {
        (0..starts.len()).step_by(10).collect()
    } else {
        vec![13, 14, 26]
    };
    for start in numbers.iter().map(|number| &starts[*number]) {
        for strategy in [Strategy::Previous, Strategy::Foresight] {
            let seen = run(&scene, &judge, start, strategy);
            assert!(seen.change < 1.0 + 1e-9, "{start:?} {strategy:?}: {seen:?}");
            assert!(
                seen.deepest_px < DEEPEST_PX,
                "{start:?} {strategy:?}: {seen:?}"
            );
            arrived += u32::from(seen.cycles.is_some());
        }
        let seen = run(&unlimited, &judge, start, Strategy::Previous);
        assert!(seen.change > 2.0, "{start:?}: {seen:?}");
        too_deep += u32::from(seen.deepest_px > 5.0 * DEEPEST_PX);
    }
    let most = 2 * numbers.len() as u32;
    let least = if is_long() { 16 } else { most };
    assert!(arrived >= least, "{arrived} of {most}");
    // A law that does not know the limits.
    assert!(too_deep >= 3, "{too_deep} of {}", numbers.len());
}
