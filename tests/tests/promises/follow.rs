//! An image that does not follow the commands disarms, and one that follows as badly as a
//! laboratory lets it does not: the daemon's decision step in simulated time, with random errors.

use hw_sim::FreeCamera;
use messages::{ClockMode, Features, Hold, TwistState};
use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use rayon::prelude::*;
use scene::{Pose, Scene};
use system_tests::simulated::Simulated;

use crate::fixture::{repeats, tell};

type Twist = [f64; 6];

/// Instants of a period at which the camera is moved.
const INSTANTS: usize = 5;
/// Frames of a run.
const FRAMES: usize = 300;

/// What is not as the law believes.
#[derive(Clone, Debug, Default)]
struct World {
    /// Carried out of each component, as a share of what was commanded.
    gain: f64,
    /// Transport delay and time constant of the arm, s.
    dead_s: f64,
    shaper_s: f64,
    /// The true mounting: rotation vector, rad, and lever arm, m.
    turned: [f64; 3],
    lever: [f64; 3],
    /// Twist of the object about its middle, in its own axes.
    object: Twist,
    noise_px: f64,
    /// Frames between exposure and delivery.
    delay: usize,
    /// Probability that a frame is lost or shows a hidden point, and for how many it stays so.
    gap: f64,
    longest_gap: usize,
}

impl Ending {
    /// Whether the daemon went on, at more than a third of the limits on average.
    fn is_believed(&self) -> bool {
        self.cause.is_none() && 3.0 * self.path_s > self.moves_s
    }
}

impl World {
    /// Random errors; the object moves at up to a fifth of the camera's limits.
    fn draw(scene: &Scene, random: &mut impl Rng) -> Self {
        let mut signed = |most: f64| random.random_range(-most..=most);
        let degrees = 3_f64.to_radians() / 3_f64.sqrt();
        let metres = 0.03 / 3_f64.sqrt();
        let limits = scene.limits.velocity();
        let mut world = Self {
            gain: 1.0 + signed(0.2),
            turned: [(); 3].map(|()| signed(degrees)),
            lever: [(); 3].map(|()| signed(metres)),
            object: limits.map(|limit| signed(0.2 * limit)),
            ..Self::default()
        };
        // One direction or one axis in half of the runs, at full speed in some.
        if random.random() {
            let axis = random.random_range(0..6);
            let faster = random.random_range(1.0..2.0_f64);
            for (k, v) in world.object.iter_mut().enumerate() {
                let most = 0.2 * limits[k];
                *v = if k == axis {
                    (*v * faster).clamp(-most, most)
                } else {
                    0.0
                };
            }
        }
        for axes in world.object.chunks_mut(3).zip(limits.chunks(3)) {
            let (axes, most) = (axes.0, 0.2 * axes.1[0]);
            let speed = axes.iter().map(|v| v * v).sum::<f64>().sqrt();
            axes.iter_mut().for_each(|v| *v *= (most / speed).min(1.0));
        }
        // It turns about its normal: seen from its edge it is no pattern any more.
        (world.object[3], world.object[4]) = (0.0, 0.0);
        world.dead_s = random.random_range(0.0..0.1);
        world.shaper_s = random.random_range(0.0..0.05);
        world.noise_px = random.random_range(0.0..0.5);
        world.delay = random.random_range(0..5);
        world.gap = random.random_range(0.0..0.02);
        world.longest_gap = 4;
        world
    }

    /// What the camera does while the arm carries `v` out.
    fn mounted(&self, v: &Twist) -> Twist {
        let turn = |x: [f64; 3]| {
            let y = cross(self.turned, x);
            [x[0] + y[0], x[1] + y[1], x[2] + y[2]]
        };
        let omega = turn([v[3], v[4], v[5]]);
        let (nu, arm) = (turn([v[0], v[1], v[2]]), cross(omega, self.lever));
        let [x, y, z] = [0, 1, 2].map(|i| self.gain * (nu[i] + arm[i]));
        let [a, b, c] = omega.map(|w| self.gain * w);
        [x, y, z, a, b, c]
    }

    /// The camera's twist against the object that has the same effect as the object's own.
    fn object_twist(&self, camera: &FreeCamera) -> Twist {
        let r = camera.pose.rotation.matrix();
        let axes = |x: &[f64]| -> [f64; 3] {
            std::array::from_fn(|i| (0..3).map(|j| r[(i, j)] * x[j]).sum())
        };
        let (v, w) = (axes(&self.object[..3]), axes(&self.object[3..]));
        let c = camera.pose.translation.vector;
        let arm = cross(w, [c[0], c[1], c[2]]);
        let [x, y, z] = [0, 1, 2].map(|i| arm[i] - v[i]);
        [x, y, z, -w[0], -w[1], -w[2]]
    }
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    ]
}

/// What goes wrong at a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Fault {
    None,
    /// One image comes again and again, with this noise, px.
    Frozen(f64),
    /// The arm does the opposite of what it is told.
    Sign,
    /// The arm stands, and the image with it.
    Stands,
}

/// How a run ended.
#[derive(Clone, Copy, Debug, Default)]
struct Ending {
    /// Why the daemon disarmed, if it did.
    cause: Option<Hold>,
    /// Frames held because the features were elsewhere.
    elsewhere: usize,
    /// After the fault: how far the commands go, in seconds at the limit of the fastest component,
    /// and for how long, s.
    path_s: f64,
    moves_s: f64,
}

fn run(
    daemon: &mut Simulated,
    scene: &Scene,
    start: &Pose,
    world: &World,
    (fault, at): (Fault, usize),
    random: &mut impl Rng,
) -> Ending {
    daemon.restart();
    let (period_s, limits) = (scene.sampling_time(), scene.limits.velocity());
    let tick_s = period_s / INSTANTS as f64;
    let dead = (world.dead_s / tick_s).round() as usize;
    let mut camera = FreeCamera::new(scene, start);
    let mut sent = vec![[0.0; 6]; dead + 1];
    let mut done: Twist = [0.0; 6];
    let mut under_way = std::collections::VecDeque::new();
    let (mut frozen, mut blind) = (None, 0);
    let mut ending = Ending::default();
    for k in 0..FRAMES {
        let now_ns = (k as f64 * period_s * 1e9).round() as u64;
        let Ok(mut points) = camera.features() else {
            break;
        };
        let mut noise_px = world.noise_px;
        if let (Fault::Frozen(px), true) = (fault, k >= at) {
            points = frozen.get_or_insert(points).clone();
            noise_px = px;
        }
        for x in points.iter_mut().flatten() {
            let noise: f64 = StandardNormal.sample(random);
            *x += noise_px * noise;
        }
        let mut features = Features::new(&points, now_ns);
        features.stamp.sequence = k as u64 + 1;
        if blind == 0 && random.random_bool(world.gap) {
            blind = random.random_range(1..=world.longest_gap);
        }
        let is_blind = blind > 0;
        blind = blind.saturating_sub(1);
        if is_blind {
            features.visible = 0b1011;
        }
        let is_lost = is_blind && k % 2 == 0;
        under_way.push_back((!is_lost).then_some(features));
        let due = under_way.len() > world.delay;
        let frame = due.then(|| under_way.pop_front().flatten()).flatten();
        let record = daemon.decide(&Simulated::received(frame, now_ns));
        ending.elsewhere += usize::from(record.hold == Hold::Elsewhere.code());
        if record.state == TwistState::Disarmed.code() {
            ending.cause = record.hold();
            break;
        }
        if k >= at {
            let shares = record
                .twist
                .iter()
                .zip(limits)
                .map(|(v, most)| v.abs() / most);
            ending.path_s += shares.fold(0.0, f64::max) * period_s;
            ending.moves_s += period_s;
        }
        for _ in 0..INSTANTS {
            sent.push(record.twist);
            let aim = sent[sent.len() - 1 - dead];
            let share = tick_s / (tick_s + world.shaper_s);
            done = std::array::from_fn(|i| done[i] + share * (aim[i] - done[i]));
            let carried = match fault {
                Fault::Sign if k >= at => done.map(|v| -v),
                Fault::Stands if k >= at => [0.0; 6],
                _ => done,
            };
            camera.advance(&world.mounted(&carried), tick_s);
            let object = world.object_twist(&camera);
            camera.advance(&object, tick_s);
        }
    }
    ending
}

/// Runs in both scenes, with fault and world drawn for each.
fn all(
    count: usize,
    seed: u64,
    draw: impl Fn(&Scene, &mut ChaCha8Rng) -> (World, Fault, usize) + Sync,
) -> Vec<(Fault, World, Ending)> {
    let scenes = [
        (scene::PAPER_SIM, scene::PAPER_SIM_STARTS),
        (scene::PAPER_ROBOT, scene::PAPER_ROBOT_STARTS),
    ];
    let halves = scenes
        .into_iter()
        .enumerate()
        .flat_map(|(half, (text, starts))| {
            let scene = Scene::parse(text, "scene").unwrap();
            let starts = scene::parse_starts(starts, "starts").unwrap();
            let count = (count + half) / 2;
            let runs: Vec<_> = (0..count)
                .into_par_iter()
                .map_init(
                    || {
                        let settings = vpc::Settings {
                            brake_s: 0.15,
                            ..vpc::Settings::default()
                        };
                        Simulated::new(&scene, None, settings, ClockMode::Fixed).unwrap()
                    },
                    |daemon, k| {
                        let number = (2 * k + half) as u64;
                        let mut random = ChaCha8Rng::seed_from_u64(seed);
                        random.set_stream(number);
                        let (world, fault, at) = draw(&scene, &mut random);
                        let start = starts[k % starts.len()];
                        let ending = run(daemon, &scene, &start, &world, (fault, at), &mut random);
                        (fault, world, ending)
                    },
                )
                .collect();
            runs
        });
    halves.collect()
}

#[test]
fn an_image_that_follows_badly_is_believed() {
    let count = repeats("images that follow", 100, 10_000);
    let runs = all(count, 1, |scene, random| {
        (World::draw(scene, random), Fault::None, FRAMES)
    });
    let ended = |wanted: &dyn Fn(&Ending) -> bool| {
        let ended = runs.iter().filter(|(.., ending)| wanted(ending));
        ended.count()
    };
    let alarms = ended(&|ending| ending.cause == Some(Hold::NotFollowing));
    let elsewhere = ended(&|ending| ending.elsewhere > 0);
    let whole = ended(&|ending| ending.cause.is_none());
    tell(format!(
        "{alarms} of {count} runs end as images that do not follow, in {elsewhere} features were elsewhere, {whole} go on to \
         their end"
    ));
    assert!(1000 * alarms <= count && 1000 * elsewhere <= count);
}

#[test]
fn an_image_that_does_not_follow_disarms() {
    let count = repeats("images that do not follow", 100, 10_000);
    let runs = all(count, 2, |_, random| {
        let fault = match random.random_range(0..3) {
            0 => Fault::Frozen(10_f64.powf(random.random_range(-9.0..-0.3))),
            1 => Fault::Sign,
            _ => Fault::Stands,
        };
        // The rest is as believed.
        let world = World {
            gain: 1.0,
            noise_px: random.random_range(0.0..0.5),
            ..World::default()
        };
        (world, fault, random.random_range(0..30))
    });
    for name in ["Frozen", "Sign", "Stands"] {
        let is_it = |fault: &Fault| format!("{fault:?}").starts_with(name);
        let endings = runs.iter().filter(|(fault, ..)| is_it(fault));
        let endings: Vec<Ending> = endings.map(|(.., ending)| *ending).collect();
        let number = |wanted: &dyn Fn(&&Ending) -> bool| endings.iter().filter(wanted).count();
        let found = number(&|ending| ending.cause.is_some());
        let by_this = number(&|ending| ending.cause == Some(Hold::NotFollowing));
        let believed = number(&|ending| ending.is_believed());
        let mut paths: Vec<f64> = endings.iter().map(|ending| ending.path_s).collect();
        paths.sort_by(f64::total_cmp);
        let [median, most] = [50, 95].map(|percent| paths[(paths.len() - 1) * percent / 100]);
        tell(format!(
            "{name}: {found} of {} runs disarm, {by_this} because the image does not follow; {believed} go on at more than a \
             third of the limits; path, s at the limits: median {median:.2}, 95 % {most:.2}",
            endings.len()
        ));
        assert!(50 * believed <= endings.len() && most < 1.5, "{name}");
    }
}
