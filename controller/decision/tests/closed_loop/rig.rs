//! The whole decision in virtual time, before a camera and a robot that do not do what they say.

use std::collections::VecDeque;

use decision::{ControlStep, Input, Inputs, Rules, Safety};
use messages::{ClockMode, CycleRecord, Features, Hold, RobotMode, RobotState, TwistState};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use scene::{Pose, Scene};
use vpc::{Settings, Strategy, Twist};

use crate::world::{Own, World};

/// Parts of a period in which the robot moves.
const PARTS: usize = 12;
/// Longest dead time, in these.
const MOST_PARTS: usize = 400;
/// An instant before the first cycle, ns: zero means that a time is unknown.
const BEGIN_NS: u64 = 1_000_000_000;

/// How a robot carries commands out.
#[derive(Clone, Copy, Debug)]
pub struct Robot {
    /// Dead time, s, and time constant of a low-pass filter behind it, s.
    pub dead_s: f64,
    pub low_pass_s: f64,
    /// Carried out of what was commanded.
    pub gain: f64,
    /// Whether it reports what it does; else what it was told.
    pub is_honest: bool,
}

impl Robot {
    pub const GOOD: Self = Self {
        dead_s: 0.0,
        low_pass_s: 0.0,
        gain: 1.0,
        is_honest: true,
    };
}

/// What a camera sends of an image.
pub struct Image {
    pub points: Vec<[f64; 2]>,
    pub visible: u32,
}

/// What a camera sends of frame `k`, of all that it has seen; `None`: nothing.
pub type Show = dyn Fn(usize, Image, &[Vec<[f64; 2]>]) -> Option<Image> + Sync;

/// A run. Times are counted from its begin, s.
pub struct Trial<'a> {
    pub scene: Scene,
    pub start: Pose,
    pub strategy: Strategy,
    pub seed: u64,
    pub seconds: f64,
    pub noise_px: f64,
    /// Frames from an exposure to its delivery, as its stamp says.
    pub delay: usize,
    /// Motion of the pattern.
    pub own: Own,
    /// What is wrong with the robot, from when on.
    pub robot: (Robot, f64),
    pub camera: &'a Show,
    /// When the fault begins, s: from then on motion is counted.
    pub fault_s: f64,
    /// Whether a run ends with its arrival.
    pub arrives: bool,
}

impl Trial<'_> {
    pub fn new(scene: &Scene, start: Pose, rate_hz: f64) -> Self {
        let mut scene = scene.clone();
        scene.camera.rate_hz = rate_hz;
        Self {
            scene,
            start,
            strategy: Strategy::Previous,
            seed: 0,
            seconds: 10.0,
            noise_px: 0.05,
            delay: 0,
            own: |_| [0.0; 6],
            robot: (Robot::GOOD, 0.0),
            camera: &|_, image, _| Some(image),
            fault_s: 0.0,
            arrives: true,
        }
    }
}

/// How a run ended.
#[derive(Clone, Debug, Default)]
pub struct Ending {
    /// When it was at the goal for the first time, s.
    pub arrived_s: Option<f64>,
    /// Why and when it disarmed, s after the fault began, and the lag that was told, s.
    pub disarmed: Option<(Hold, f64)>,
    pub lag_s: f64,
    /// Way of the camera after the fault, m.
    pub path_m: f64,
    /// Time in which it was faster than one and a half times its limits, s.
    pub beyond_s: f64,
}

impl Trial<'_> {
    pub fn run(&self) -> Ending {
        let scene = &self.scene;
        let settings = Settings {
            strategy: self.strategy,
            brake_s: 0.15,
            ..Settings::default()
        };
        let safety = Safety {
            armed: true,
            ..Safety::default()
        };
        let rules = Rules::new(scene, &settings, &safety, ClockMode::Fixed);
        let mut control = ControlStep::new(scene, settings, None, rules).unwrap();
        let task = control.law().task().clone();
        let mut world = World::of(scene.clone(), &self.start);
        let mut random = ChaCha8Rng::seed_from_u64(self.seed);
        let period = scene.sampling_time();
        let part = period / PARTS as f64;
        let mut images = Vec::new();
        let (mut under_way, mut sent) = (VecDeque::new(), VecDeque::new());
        let (mut twist, mut done): (Twist, Twist) = ([0.0; 6], [0.0; 6]);
        let mut ending = Ending::default();
        let cycles = (self.seconds / period) as usize;
        for k in 0..cycles {
            let seconds = k as f64 * period;
            let now_ns = BEGIN_NS + (seconds * 1e9).round() as u64;
            let (robot, since_s) = self.robot;
            let robot = if seconds < since_s {
                Robot::GOOD
            } else {
                robot
            };
            let Some(truth) = seen(&world) else { break };
            let pairs = truth.iter().flatten().zip(task.goal.iter().flatten());
            let error_px = pairs.map(|(s, goal)| (s - goal).abs()).fold(0.0, f64::max);
            let is_there = error_px < scene.success.convergence_px;
            if is_there && ending.arrived_s.is_none() {
                ending.arrived_s = Some(seconds);
                if self.arrives {
                    break;
                }
            }
            images.push(truth.clone());
            let image = Image {
                points: truth,
                visible: u32::MAX,
            };
            let image = (self.camera)(k, image, &images);
            let image = image.map(|mut image| {
                for x in image.points.iter_mut().flatten() {
                    let noise: f64 = StandardNormal.sample(&mut random);
                    *x += self.noise_px * noise;
                }
                let mut features = Features::new(&image.points, now_ns);
                features.visible = image.visible;
                features.stamp.sequence = k as u64 + 1;
                features
            });
            under_way.push_back(image);
            let image = match under_way.len() > self.delay {
                true => under_way.pop_front().flatten(),
                false => None,
            };
            let features = image.map_or(Input::Nothing, |mut features| {
                features.stamp.published_ns = now_ns;
                Input::Message(features)
            });
            let mut state = RobotState {
                mode: RobotMode::Moving.code(),
                twist: if robot.is_honest { done } else { twist },
                ..RobotState::default()
            };
            state.stamp.sequence = k as u64 + 1;
            (state.stamp.data_ns, state.stamp.published_ns) = (now_ns, now_ns);
            let mut record = CycleRecord::default();
            let inputs = Inputs {
                now_ns,
                features,
                robot: Input::Message(state),
                desired: Input::Nothing,
                missed: 0,
                suspended: false,
                shutdown: false,
            };
            control.decide(&inputs, &mut record);
            control.think();
            twist = record.twist;
            if record.state == TwistState::Disarmed.code() {
                let hold = record.hold().unwrap();
                ending.disarmed = Some((hold, seconds - self.fault_s));
                ending.lag_s = record.lag_s;
                break;
            }
            let dead = (robot.dead_s / part).round() as usize;
            for _ in 0..PARTS {
                sent.push_front(twist);
                sent.truncate(MOST_PARTS);
                let aim = sent.get(dead).copied().unwrap_or_default();
                let share = part / (part + robot.low_pass_s);
                done = std::array::from_fn(|i| done[i] + share * (robot.gain * aim[i] - done[i]));
                world.go(&done, self.own, part);
            }
            if seconds >= self.fault_s {
                let speed = done[..3].iter().map(|v| v * v).sum::<f64>().sqrt();
                ending.path_m += speed * period;
                let mut shares = done.iter().zip(task.limits).map(|(v, most)| v.abs() / most);
                if shares.any(|share| share > 1.5) {
                    ending.beyond_s += period;
                }
            }
        }
        ending
    }
}

/// The points as they are; `None` where one is behind the camera.
fn seen(world: &World) -> Option<Vec<[f64; 2]>> {
    let points = world.points.iter();
    let see = |x: &nalgebra::Vector3<f64>| {
        vpc::camera::project(&world.scene.camera, (*x).into())
            .filter(|p| p.iter().all(|x| x.is_finite() && x.abs() < 1e5))
    };
    points.map(see).collect()
}

/// Valid starts of a seed, from the scene's whole region.
pub fn drawn(scene: &Scene, count: usize, seed: u64) -> Vec<Pose> {
    let task = vpc::Task::new(scene).unwrap();
    let region = &scene.starts;
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut uniform = |low: f64, high: f64| low + (high - low) * random.random::<f64>();
    let poses = std::iter::repeat_with(|| {
        let translation =
            [0, 1, 2].map(|k| uniform(region.translation_min[k], region.translation_max[k]));
        let [x, y] = [(); 2].map(|()| uniform(-region.tilt_max, region.tilt_max));
        let roll = uniform(-region.roll_max, region.roll_max);
        let turn = |axis: [f64; 3]| nalgebra::Rotation3::new(nalgebra::Vector3::from(axis));
        let rotation = turn([0.0, 0.0, roll]) * turn([x, y, 0.0]);
        Pose {
            translation,
            rotation: rotation.scaled_axis().into(),
        }
    });
    let area = |points: &[[f64; 2]]| vpc::features::signed_area(points);
    let is_valid = |pose: &Pose| {
        task.features_at(pose).is_some_and(|points| {
            let away = points.iter().zip(&task.goal);
            let away = away.map(|(s, t)| (s[0] - t[0]).hypot(s[1] - t[1]));
            area(&points) * area(&task.goal) > 0.0
                && away.sum::<f64>() / points.len() as f64 >= region.min_error_px
                && points
                    .iter()
                    .all(|&p| vpc::constraint::violation(&task, p, region.clearance_px) == 0.0)
        })
    };
    poses.filter(is_valid).take(count).collect()
}
