//! Twists of another program: what is harmless passes to the last bit, and nothing else takes a
//! point out of sight or the camera beyond its limits.

use nalgebra::Vector3;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use scene::{Limits, Pose, Scene};
use vpc::motion::Motion;
use vpc::{
    Law, Measurement, Refusal, Settings, Step, Strategy, Task, Twist, camera, constraint, task,
};

use crate::world::is_long;

/// Cycles of a run.
const CYCLES: u64 = 100;
/// Instants of a period that are judged.
const INSTANTS: u32 = 12;
/// The deepest that a point may be in an occlusion or outside the image, px.
const DEEPEST_PX: f64 = 0.25;
/// A twist is harmless if it keeps all points so far away from every border, px: what the law keeps
/// because the pattern may move, at most, and a little more.
const FAR_PX: f64 = 18.0;

/// The least sine of the angle between the line of sight and the pattern's plane: of 15 degrees,
/// less what a command changes within a period. And that from which the law lets every twist pass.
const FROM_FRONT: f64 = 0.255;
const FRONTAL: f64 = 0.56;

/// A camera that obeys exactly.
struct Camera<'a> {
    task: &'a Task,
    points: Vec<Vector3<f64>>,
}

/// The sine of the angle between the line of sight to the middle of the points and their plane.
fn sine(points: &[Vector3<f64>]) -> f64 {
    let normal = (points[1] - points[0]).cross(&(points[2] - points[0]));
    let middle = points.iter().sum::<Vector3<f64>>();
    normal.normalize().dot(&middle.normalize()).abs()
}

impl Camera<'_> {
    fn pixels(&self) -> Vec<[f64; 2]> {
        let see = |x: &Vector3<f64>| camera::project(&self.task.camera, (*x).into()).unwrap();
        self.points.iter().map(see).collect()
    }

    /// The points after so long at a twist.
    fn after(&self, twist: &Twist, seconds: f64) -> Vec<Vector3<f64>> {
        let motion = Motion::of_camera(twist, seconds);
        self.points.iter().map(|x| motion.apply(x)).collect()
    }

    /// The depth of the deepest point, with so much clearance, at any instant of a way of so many
    /// seconds, px.
    fn deepest_px(&self, twist: &Twist, seconds: f64, clearance_px: f64) -> f64 {
        let depth = |x: &Vector3<f64>| match camera::project(&self.task.camera, (*x).into()) {
            Some(pixel) => constraint::violation(self.task, pixel, clearance_px),
            None => f64::INFINITY,
        };
        (1..=INSTANTS)
            .flat_map(|i| self.after(twist, f64::from(i) / f64::from(INSTANTS) * seconds))
            .map(|x| depth(&x))
            .fold(0.0, f64::max)
    }
}

/// What another program may want next: what a policy wants, and what none should.
fn wanted(
    random: &mut ChaCha8Rng,
    limits: &Twist,
    [before, standing]: [&Twist; 2],
) -> Option<Twist> {
    let mut within =
        |share: f64| limits.map(|most| share * most * (2.0 * random.random::<f64>() - 1.0));
    let (small, any, wild) = (within(0.2), within(1.0), within(20.0));
    match random.random_range(0..20_u32) {
        0 => None,
        1 => Some([f64::NAN; 6]),
        2 => Some([f64::INFINITY, 0.0, -f64::MAX, 0.0, 0.0, f64::MIN_POSITIVE]),
        3 => Some(before.map(|v| -v)),
        4 => Some(any.map(|v| v.signum() * 1e3)),
        5 => Some(wild),
        6..=8 => Some(any),
        9 | 10 => Some(small),
        11..=13 => Some(std::array::from_fn(|i| 0.9 * standing[i] + 0.1 * small[i])),
        // Most go on, so that it comes to a border.
        _ => Some(*before),
    }
}

/// What came of the wanted twists.
#[derive(Debug, Default)]
struct Seen {
    twists: u64,
    /// How many of them were harmless, and passed.
    harmless: u64,
    /// How many were changed.
    changed: u64,
    deepest_px: f64,
    /// Of the lowest view.
    least_sine: f64,
    /// Greatest component, and greatest change of one in a period, as a share of what is allowed.
    fastest: f64,
    steepest: f64,
}

/// The law that guards.
fn guardian(scene: &Scene) -> Law<Vec<f64>> {
    let settings = Settings {
        strategy: Strategy::Follow,
        ..Settings::default()
    };
    Law::new(scene, settings, |len| vec![0.0; len]).unwrap()
}

/// A cycle: what is sent where so much is wanted.
fn cycle(
    law: &mut Law<Vec<f64>>,
    pixels: &[[f64; 2]],
    number: u64,
    wanted: Option<Twist>,
) -> Result<Step, Refusal> {
    let now_ns = (number as f64 * law.task().period * 1e9).round() as u64;
    law.want(wanted);
    let measured = Measurement::from_points(pixels).taken(now_ns, now_ns);
    let step = law.step(&measured, None)?;
    law.sent(&step.twist, now_ns);
    Ok(step)
}

/// Guards a camera against random twists from a start.
fn guard(scene: &Scene, start: &Pose, seed: u64, seen: &mut Seen) {
    let mut law = guardian(scene);
    let task = law.task().clone();
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let (mut standing, mut before) = ([0.0; 6], task.limits);
    let mut camera = Camera {
        task: &task,
        points: task::placed(&task.pattern, start).collect(),
    };
    for k in 0..CYCLES {
        let wanted = wanted(&mut random, &task.limits, [&before, &standing]);
        let step = cycle(&mut law, &camera.pixels(), k, wanted);
        let step = step.unwrap_or_else(|why| panic!("seed {seed}, cycle {k}: {why}"));
        seen.twists += 1;
        let change: Twist = std::array::from_fn(|i| step.twist[i] - standing[i]);
        let shares = step.twist.iter().zip(&task.limits);
        seen.fastest = shares
            .map(|(v, most)| v.abs() / most)
            .fold(seen.fastest, f64::max);
        seen.steepest = seen.steepest.max(task.stop_s(&change) / task.period);
        if let Some(wanted) = wanted {
            // The way of a command and of its braking, held: as far as it goes.
            let seconds = task.period + 0.5 * task.stop_s(&wanted);
            let may_begin = task.stop_s(&std::array::from_fn(|i| wanted[i] - standing[i]));
            let is_slow = wanted
                .iter()
                .zip(&task.limits)
                .all(|(v, most)| v.abs() <= *most);
            let is_harmless = is_slow
                && may_begin <= task.period
                && camera.deepest_px(&wanted, seconds, FAR_PX) == 0.0
                && sine(&camera.after(&wanted, seconds)) > FRONTAL;
            let passed = step.twist.map(f64::to_bits) == wanted.map(f64::to_bits);
            assert!(
                passed || !is_harmless,
                "seed {seed}, cycle {k}: {wanted:?}, {step:?}"
            );
            seen.harmless += u64::from(is_harmless);
            seen.changed += u64::from(!passed);
            before = wanted;
        }
        let deepest_px = camera.deepest_px(&step.twist, task.period, 0.0);
        seen.deepest_px = seen.deepest_px.max(deepest_px);
        standing = step.twist;
        camera.points = camera.after(&standing, task.period);
        seen.least_sine = seen.least_sine.min(sine(&camera.points));
    }
}

/// Guards from the starts of paper-sim; `VPC_LONG=1` against a million twists.
fn guarded(limits: Limits) -> Seen {
    let mut scene = Scene::parse(scene::PAPER_SIM, "sim").unwrap();
    scene.limits = limits;
    let starts = scene::parse_starts(scene::PAPER_SIM_STARTS, "starts").unwrap();
    let most = if is_long() { 1_000_000 } else { 20_000 };
    let mut seen = Seen {
        least_sine: 1.0,
        ..Seen::default()
    };
    for (seed, start) in (0..).zip(starts.iter().cycle()) {
        guard(&scene, start, seed, &mut seen);
        if seen.twists >= most {
            break;
        }
    }
    println!("{seen:?}");
    assert!(seen.harmless > seen.twists / 10, "{seen:?}");
    assert!(seen.changed > seen.twists / 10, "{seen:?}");
    assert!(seen.fastest <= 1.0, "{seen:?}");
    assert!(seen.least_sine > FROM_FRONT, "{seen:?}");
    seen
}

/// However much is wanted, the camera does what it would for as much as its limits.
#[test]
fn what_is_wanted_beyond_the_limits_counts_up_to_them() {
    let scene = Scene::parse(scene::PAPER_SIM, "sim").unwrap();
    let start = &scene::parse_starts(scene::PAPER_SIM_STARTS, "starts").unwrap()[0];
    let drive = |size: f64| {
        let mut law = guardian(&scene);
        let task = law.task().clone();
        let mut camera = Camera {
            task: &task,
            points: task::placed(&task.pattern, start).collect(),
        };
        let mut sent = Vec::new();
        for k in 0..CYCLES {
            let sign = if k < CYCLES / 2 { 1.0 } else { -1.0 };
            let step = cycle(&mut law, &camera.pixels(), k, Some([size * sign; 6])).unwrap();
            assert!(step.status.is_feasible(), "{size}, cycle {k}: {step:?}");
            camera.points = camera.after(&step.twist, task.period);
            sent.push(step.twist);
        }
        sent
    };
    let most = drive(1.0);
    assert!(most.iter().filter(|twist| **twist != [0.0; 6]).count() > 20);
    for size in [500.0, 1e12, 1e160, f64::MAX] {
        assert_eq!(drive(size), most, "{size}");
    }
}

/// The lowest view on a way around the pattern in this direction, rad, on which the camera turns so
/// that it keeps it in sight; with noise, px.
fn lowest(scene: &Scene, direction: f64, noise_px: f64) -> f64 {
    let mut random = ChaCha8Rng::seed_from_u64(7);
    let mut law = guardian(scene);
    let task = law.task().clone();
    let mut camera = Camera {
        task: &task,
        points: task::placed(&task.pattern, &scene.goal).collect(),
    };
    let (sin, cos) = direction.sin_cos();
    let mut lowest = 1.0_f64;
    for k in 0..(10.0 / task.period) as u64 {
        let mut noise = || noise_px * 3.0_f64.sqrt() * (2.0 * random.random::<f64>() - 1.0);
        let pixels = camera
            .pixels()
            .into_iter()
            .map(|pixel| pixel.map(|x| x + noise()));
        let pixels: Vec<_> = pixels.collect();
        let middle = camera.points.iter().sum::<Vector3<f64>>() / 4.0;
        let (x, y) = (middle.x / middle.z, middle.y / middle.z);
        let (speed, turn, aim) = (0.4, 0.4 / middle.norm(), 2.0);
        let wanted = [
            speed * cos,
            speed * sin,
            0.0,
            turn * sin - aim * y,
            aim * x - turn * cos,
            0.0,
        ];
        let step = cycle(&mut law, &pixels, k, Some(wanted));
        let step = step.unwrap_or_else(|why| panic!("{direction} rad, cycle {k}: {why}"));
        camera.points = camera.after(&step.twist, task.period);
        lowest = lowest.min(sine(&camera.points));
    }
    lowest
}

#[test]
fn no_twist_leads_to_the_pattern_s_side() {
    let mut scene = Scene::parse(scene::PAPER_SIM, "sim").unwrap();
    scene.occlusions.clear();
    let small = scene.pattern.iter().map(|p| p.map(|x| 0.2 * x)).collect();
    let cases = [
        (30.0, &scene.pattern, 0.0, None),
        (30.0, &scene.pattern, 0.0, Some(0.5)),
        (30.0, &scene.pattern, 0.0, Some(2.0)),
        (5.0, &scene.pattern, 0.0, None),
        (30.0, &small, 0.3, None),
    ];
    for (rate_hz, pattern, noise_px, acceleration) in cases {
        let mut scene = scene.clone();
        (scene.camera.rate_hz, scene.pattern) = (rate_hz, pattern.clone());
        scene.limits.linear_acceleration = acceleration;
        scene.limits.angular_acceleration = acceleration.map(|most| 2.0 * most);
        for way in 0..16 {
            let direction = f64::from(way) * std::f64::consts::TAU / 16.0;
            let lowest = lowest(&scene, direction, noise_px);
            // As far as it may, but for what the law does not know of the pose.
            let is_exact = rate_hz > 10.0 && noise_px == 0.0;
            let least = if is_exact { FROM_FRONT } else { 0.2 };
            assert!(
                (least..0.35).contains(&lowest),
                "{rate_hz} Hz, {noise_px} px, {acceleration:?}, {direction} rad: {lowest}"
            );
        }
    }
}

#[test]
fn no_twist_takes_a_point_out_of_sight() {
    let seen = guarded(Limits {
        linear: 0.5,
        angular: 1.0,
        linear_acceleration: None,
        angular_acceleration: None,
    });
    assert!(seen.deepest_px <= DEEPEST_PX, "{seen:?}");
}

#[test]
fn under_limits_of_acceleration_it_can_stop() {
    let seen = guarded(Limits {
        linear: 0.5,
        angular: 1.0,
        linear_acceleration: Some(2.0),
        angular_acceleration: Some(4.0),
    });
    assert!(seen.steepest <= 1.0 + 1e-9, "{seen:?}");
    assert!(seen.deepest_px <= DEEPEST_PX, "{seen:?}");
}
