//! The camera: what it sees of the object, and what it sends of that.

use std::collections::VecDeque;

use decision::Input;
use hw_sim::FreeCamera;
use messages::{Features, MAX_POINTS, Message};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use scene::{Pose, Scene};

use crate::fault::Fault;

/// Noise of a measured point, px.
const NOISE_PX: f64 = 0.1;
/// How old the images of a late camera are, and how far others are in the future, ns.
const LATE_NS: u64 = 400_000_000;
/// How old the images of a camera are that stamps them as fresh ones, ns.
const STAMPED_LATE_NS: std::ops::Range<u64> = 180_000_000..400_000_000;

/// The camera in the robot's hand, and its driver.
pub struct Camera {
    scene: Scene,
    /// What it truly sees.
    pub eye: FreeCamera,
    /// What goes wrong with it, and since when, ns.
    fault: Option<(Fault, u64)>,
    /// Deviation of the noise of [`Fault::Noise`], px.
    noise_px: f64,
    /// Whether the fault has shown itself once.
    has_begun: bool,
    sequence: u64,
    /// The last message of a camera that worked.
    good: Features,
    older_ns: u64,
    /// Images of before, the newest first.
    past: VecDeque<Features>,
    /// How old its images are that seem fresh, ns.
    late_ns: u64,
    /// Of how many images one is whole, where the others are not, and what these show.
    flicker: (u64, u32),
    /// Images since the fault began.
    images: u64,
    random: ChaCha8Rng,
}

impl Camera {
    /// One that sees the object there.
    pub fn new(scene: &Scene, start: &Pose, random: ChaCha8Rng) -> Self {
        Self {
            scene: scene.clone(),
            eye: FreeCamera::new(scene, start),
            fault: None,
            noise_px: 0.0,
            has_begun: false,
            sequence: 0,
            good: Features::default(),
            older_ns: 0,
            past: VecDeque::new(),
            late_ns: 0,
            flicker: (1, 0),
            images: 0,
            random,
        }
    }

    /// From now on it fails so.
    pub fn fail(&mut self, fault: Fault, now_ns: u64, random: &mut ChaCha8Rng) {
        self.fault = Some((fault, now_ns));
        self.noise_px = 10_f64.powf(random.random_range(-9.0..-0.3));
        (self.has_begun, self.older_ns, self.images) = (false, 0, 0);
        self.late_ns = random.random_range(STAMPED_LATE_NS);
        let hidden = [0, 0b1, 0b11, 0b111][random.random_range(0..4)];
        self.flicker = (random.random_range(2..9), hidden);
    }

    /// From now on it sees another object: of these places of it the one whose points are furthest
    /// from those of the object that it saw, half of them at least.
    pub fn see_other(&mut self, places: &[Pose]) {
        let Ok(seen) = self.eye.features() else {
            return;
        };
        let away_px = |other: &FreeCamera| {
            let points = other.features().unwrap_or_default();
            let pairs = points.iter().zip(&seen);
            let each = pairs.map(|(p, q)| (p[0] - q[0]).hypot(p[1] - q[1]));
            let mut each: Vec<f64> = each.collect();
            each.sort_unstable_by(f64::total_cmp);
            each[(each.len() - 1) / 2]
        };
        let others = places
            .iter()
            .map(|place| FreeCamera::new(&self.scene, place));
        let furthest = others.max_by(|a, b| away_px(a).total_cmp(&away_px(b)));
        self.eye = furthest.unwrap_or_else(|| self.eye.clone());
    }

    /// From now on it works.
    pub fn recover(&mut self) {
        self.fault = None;
    }

    /// When the last good features were published, ns.
    pub fn good_ns(&self) -> u64 {
        self.good.stamp.published_ns
    }

    /// An image of what it sees; `None` where a point is behind it.
    pub fn expose(&mut self, now_ns: u64) -> Option<Features> {
        let points = self.eye.features().ok()?;
        let mut features = Features::new(&points, now_ns);
        noisy(&mut features, NOISE_PX, &mut self.random);
        Some(features)
    }

    /// What its driver publishes of an image at `now_ns`; `None` if nothing.
    pub fn publish(&mut self, image: Features, now_ns: u64) -> Option<Input<Features>> {
        let mut features = image;
        self.past.push_front(image);
        self.past.truncate(32);
        features.stamp.published_ns = now_ns;
        // An image of before another object came is good, also where it is published after that.
        let is_before = |fault, since_ns| {
            matches!(fault, Fault::OtherAfterHidden | Fault::OtherAfterRestart)
                && image.stamp.data_ns < since_ns
        };
        let fault = self
            .fault
            .filter(|(fault, since_ns)| !is_before(*fault, *since_ns));
        let Some((fault, since_ns)) = fault else {
            let features = self.count(features);
            self.good = features;
            return Some(Input::Message(features));
        };
        let is_first = !std::mem::replace(&mut self.has_begun, true);
        let good = self.good;
        self.images += 1;
        match fault {
            Fault::Freeze => features.stamp.data_ns = good.stamp.data_ns,
            Fault::Image => features.points = good.points,
            Fault::Noise => {
                features.points = good.points;
                noisy(&mut features, self.noise_px, &mut self.random);
            }
            Fault::Flicker => {
                let (of, hidden) = self.flicker;
                features.points = good.points;
                noisy(&mut features, 0.05, &mut self.random);
                if !self.images.is_multiple_of(of) {
                    features.visible = hidden;
                }
            }
            Fault::LateFresh => {
                let is_old = |one: &&Features| one.stamp.data_ns + self.late_ns <= now_ns;
                let oldest = self.past.iter().find(is_old).or(self.past.back());
                features.points = oldest.map_or(features.points, |one| one.points);
            }
            Fault::Mirrored => {
                let width = self.scene.camera.width;
                let count = 2 * features.count as usize;
                let across = features.points[..count].iter_mut().step_by(2);
                across.for_each(|u| *u = width - *u);
            }
            Fault::OtherAfterHidden if is_first => features.visible = 0b1011,
            Fault::OtherAfterRestart if is_first => {
                self.sequence = 0;
                return None;
            }
            Fault::Silence | Fault::Replaced => return None,
            Fault::Pause if now_ns < since_ns + LATE_NS => return None,
            Fault::Older => {
                self.older_ns += 33_000_000;
                features.stamp.data_ns = good.stamp.data_ns - self.older_ns;
            }
            Fault::Hidden => features.visible = 0b1011,
            Fault::Zeros => features.points = features.points.map(|x| x * 1e-3),
            Fault::Line => {
                let v = features.points[1];
                heights(&mut features).for_each(|x| *x = v);
            }
            Fault::Late => {
                features.stamp.data_ns -= LATE_NS;
                features.stamp.published_ns -= LATE_NS;
                if features.stamp.data_ns <= good.stamp.data_ns {
                    return None;
                }
            }
            Fault::Future => features.stamp.published_ns += LATE_NS,
            Fault::NotFinite => features.points[2] = f64::NAN,
            Fault::TooFew => features.count = 3,
            Fault::Swapped => (0..2).for_each(|k| features.points.swap(k, k + 2)),
            Fault::Uncounted => self.sequence = 0,
            Fault::Transport => return Some(Input::Failed),
            Fault::NoAnswer => {
                let count = f64::from(features.count);
                let middle = heights(&mut features).map(|v| *v).sum::<f64>() / count;
                heights(&mut features).for_each(|v| *v = middle + 0.01 * (*v - middle));
            }
            _ => (),
        }
        let features = self.count(features);
        // As reception checks it.
        Some(match features.check() {
            Ok(()) => Input::Message(features),
            Err(_) => Input::Refused(features.stamp),
        })
    }

    /// Another camera takes its place, which sees the object there.
    pub fn replace(&mut self, start: &Pose) {
        (self.eye, self.fault) = (FreeCamera::new(&self.scene, start), None);
        self.sequence = 0;
    }

    /// The object is carried to where the camera sees it well.
    pub fn place(&mut self, start: &Pose) {
        self.eye = FreeCamera::new(&self.scene, start);
    }

    fn count(&mut self, mut features: Features) -> Features {
        self.sequence += 1;
        features.stamp.sequence = self.sequence;
        features
    }
}

/// The v of each point.
fn heights(features: &mut Features) -> impl Iterator<Item = &mut f64> {
    let count = (features.count as usize).min(MAX_POINTS);
    features.points[..2 * count].iter_mut().skip(1).step_by(2)
}

fn noisy(features: &mut Features, px: f64, random: &mut ChaCha8Rng) {
    let count = 2 * features.count as usize;
    for x in &mut features.points[..count] {
        *x += random.random_range(-px..=px);
    }
}
