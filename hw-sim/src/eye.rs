//! The camera in the robot's hand: frames come late, with jitter, and some never.

use clap::ValueEnum;
use markers::Family;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal};
use scene::Scene;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use vision::{Image, Latency, Lens, Transit};

use crate::camera::{Points, outlines, project};
use crate::occlusion::Shape;
pub use crate::picture::EyeError;
use crate::picture::{Exposure, FrameRenderer};
use crate::pose::{RigidPose, seen_after, to_scene};
use crate::robot::truth::Truth;
use crate::stamps::Stamps;

/// What the camera sends.
#[derive(
    Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum, Deserialize, Serialize, JsonSchema,
)]
#[serde(rename_all = "lowercase")]
pub enum Sight {
    /// True projections with pixel noise; a partly covered marker is hidden.
    #[default]
    Ideal,
    /// Images of tags, for `vpc-camera`.
    Rendered,
}

/// Properties of the camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EyeSettings {
    /// What it sends.
    pub sight: Sight,
    /// From the middle of the exposure to the delivery.
    pub latency: Latency,
    /// Family of the rendered tags.
    pub family: Family,
    /// Standard deviation of each coordinate of ideal features, px.
    pub noise_px: f64,
    /// Seed of that noise, and of the picture's.
    pub seed: u64,
    /// How long a row is exposed, ns.
    pub exposure_ns: u64,
    /// From the first row to the last of a rolling shutter, ns.
    pub readout_ns: u64,
}

impl Default for EyeSettings {
    fn default() -> Self {
        Self {
            sight: Sight::Ideal,
            latency: Latency::default(),
            family: Family::default(),
            noise_px: 0.0,
            seed: 1,
            exposure_ns: 6_000_000,
            readout_ns: 15_000_000,
        }
    }
}

/// A delivered frame.
#[derive(Clone, Debug, PartialEq)]
pub struct Shot {
    /// Number of the frame, from 1; lost ones leave gaps.
    pub number: u64,
    /// Middle of the exposure as it is told, ns.
    pub stamp_ns: u64,
    /// Markers, px; with an image the true ones, which nobody is told.
    pub points: Points,
    /// Bit i: marker i is in sight.
    pub visible: u32,
    /// The image that is sent instead.
    pub image: Option<Image>,
}

impl Shot {
    /// Whether every marker is in sight.
    pub fn is_whole(&self) -> bool {
        self.visible.count_ones() as usize == self.points.len()
    }
}

/// A frame under way: its number and stamp, ns, and its markers with a bit for each in sight.
type Exposed = (u64, u64, Points, u32);

/// The camera.
#[derive(Debug)]
pub struct Eye {
    real: Scene,
    shapes: Vec<Shape>,
    shown: Vec<bool>,
    noise: Option<Normal<f64>>,
    random: ChaCha8Rng,
    lens: Lens,
    stamps: Stamps,
    readout_ns: u64,
    /// How long an exposure blurs, s.
    blur_s: f64,
    transit: Transit<Exposed>,
    /// Of rendered frames.
    renderer: Option<FrameRenderer>,
    is_live: bool,
    frames: u64,
}

impl Eye {
    /// A camera that looks at the scene as it is, `real`, with the flaws of `truth`. Where it
    /// `is_live`, a frame that is not drawn in time comes later; otherwise the caller waits for it.
    ///
    /// # Errors
    /// [`EyeError`] where there is nothing to draw, or no thread for it.
    pub fn new(
        real: &Scene,
        truth: &Truth,
        settings: &EyeSettings,
        is_live: bool,
    ) -> Result<Self, EyeError> {
        let is_rendered = settings.sight == Sight::Rendered;
        let renderer = || FrameRenderer::new(real, truth, settings.family, settings.seed);
        let latency = Latency {
            burst: truth.drop_burst,
            ..settings.latency
        };
        Ok(Self {
            shapes: real.occlusions.iter().map(Shape::new).collect(),
            real: real.clone(),
            shown: vec![true; real.occlusions.len()],
            noise: Normal::new(0.0, settings.noise_px).ok(),
            random: ChaCha8Rng::seed_from_u64(settings.seed),
            lens: truth.lens(real),
            stamps: Stamps::new(truth, settings.seed),
            readout_ns: settings.readout_ns,
            blur_s: 1e-9 * settings.exposure_ns as f64 * truth.motion_blur,
            transit: Transit::new(latency),
            renderer: is_rendered.then(renderer).transpose()?,
            is_live,
            frames: 0,
        })
    }

    /// Shows or takes away an occlusion, by its index in the scene.
    pub fn show(&mut self, occlusion: usize, shown: bool) {
        if let Some(there) = self.shown.get_mut(occlusion) {
            *there = shown;
        }
    }

    /// Exposes a frame: the object in the camera frame at the middle of the exposure, `stamp_ns`,
    /// and the camera's velocity relative to the object meanwhile.
    ///
    /// # Errors
    /// The picture could not be made.
    pub fn expose(
        &mut self,
        object: &RigidPose,
        twist: &[f64; 6],
        stamp_ns: u64,
    ) -> Result<(), EyeError> {
        self.frames += 1;
        let (mut points, visible) = self.true_features(object);
        if self.renderer.is_none() {
            points = points
                .iter()
                .map(|&pixel| self.lens.distort(pixel))
                .collect();
            self.add_noise(&mut points);
        }
        let told_ns = self.stamps.told(stamp_ns);
        let is_delivered = self
            .transit
            .expose((self.frames, told_ns, points, visible), stamp_ns);
        if let Some(renderer) = self.renderer.as_ref().filter(|_| is_delivered) {
            let around = |seconds: f64| {
                let half = 0.5 * seconds;
                [-half, half].map(|dt| to_scene(&seen_after(object, twist, dt)))
            };
            renderer.expose(Exposure {
                rows: around(1e-9 * self.readout_ns as f64),
                blur: around(self.blur_s),
                shown: self.shown.clone(),
            })?;
        }
        Ok(())
    }

    /// The oldest frame that has arrived by `now_ns`; call until there is none.
    ///
    /// # Errors
    /// The picture could not be made.
    pub fn deliver(&mut self, now_ns: u64) -> Result<Option<Shot>, EyeError> {
        if self.transit.next_due_ns().is_none_or(|due| due > now_ns) {
            return Ok(None);
        }
        let image = match &self.renderer {
            None => None,
            Some(renderer) => match renderer.next(!self.is_live)? {
                None => return Ok(None),
                image => image,
            },
        };
        Ok(self.transit.deliver(now_ns).map(|frame| {
            let (number, stamp_ns, points, visible) = frame.payload;
            Shot {
                number,
                stamp_ns,
                points,
                visible,
                image,
            }
        }))
    }

    /// Where the markers are, px, and which of them are in sight.
    fn true_features(&self, object: &RigidPose) -> (Points, u32) {
        // A point behind the camera is not to be seen; where it is not seen does not matter.
        let Ok(points) = project(&self.real, object) else {
            let middle = [self.real.camera.cx, self.real.camera.cy];
            return (self.real.pattern.iter().map(|_| middle).collect(), 0);
        };
        let mut visible = 0;
        for (i, &pixel) in points.iter().enumerate() {
            visible |= u32::from(self.is_in_sight(pixel)) << i;
        }
        for (i, outline) in outlines(&self.real, object).enumerate() {
            let is_whole = outline.is_some_and(|edge| edge.iter().all(|&p| self.is_in_sight(p)));
            visible &= !(u32::from(!is_whole) << i);
        }
        (points, visible)
    }

    fn add_noise(&mut self, points: &mut Points) {
        if let Some(noise) = self.noise {
            let random = &mut self.random;
            let numbers = points.iter_mut().flatten();
            numbers.for_each(|x| *x += noise.sample(random));
        }
    }

    fn is_in_sight(&self, pixel: [f64; 2]) -> bool {
        let camera = &self.real.camera;
        let [u, v] = self.lens.distort(pixel);
        let inside = |x: f64, most: f64| (0.0..=most - 1.0).contains(&x);
        let covered = |(shape, shown): (&Shape, &bool)| *shown && shape.covers(pixel);
        inside(u, camera.width)
            && inside(v, camera.height)
            && !self.shapes.iter().zip(&self.shown).any(covered)
    }
}

#[cfg(test)]
mod tests {
    use scene::Pose;

    use super::*;
    use crate::pose::from_scene;

    fn robot_scene() -> Scene {
        Scene::parse(scene::PAPER_ROBOT, "robot").unwrap()
    }

    /// Frames that are exposed in the first 400 ms.
    const SHOTS: usize = 13;

    fn shots(scene: &Scene, settings: &EyeSettings, is_live: bool, object: &Pose) -> Vec<Shot> {
        let mut eye = Eye::new(scene, &Truth::default(), settings, is_live).unwrap();
        let mut shots = Vec::new();
        let object = from_scene(object);
        for ms in 0..600_u64 {
            let now_ns = ms * 1_000_000;
            if ms % 33 == 0 && ms < 400 {
                eye.expose(&object, &[0.0; 6], now_ns).unwrap();
            }
            if is_live {
                std::thread::sleep(std::time::Duration::from_millis(1));
            }
            while let Some(shot) = eye.deliver(now_ns).unwrap() {
                assert!(now_ns >= shot.stamp_ns + settings.latency.latency_ns);
                shots.push(shot);
            }
        }
        // However late they are drawn.
        while is_live && shots.len() < SHOTS {
            shots.extend(eye.deliver(600_000_000).unwrap());
        }
        shots
    }

    #[test]
    fn pictures_match_those_drawn_by_the_caller() {
        let scene = Scene::parse(scene::TAGS_ROBOT, "tags").unwrap();
        let settings = EyeSettings {
            sight: Sight::Rendered,
            ..EyeSettings::default()
        };
        let here = shots(&scene, &settings, false, &scene.goal);
        assert_eq!(here.len(), SHOTS);
        let levels = |shot: &Shot| {
            let pixels = shot.image.as_ref().unwrap().pixels();
            [pixels.iter().min().copied(), pixels.iter().max().copied()]
        };
        assert!(
            here.iter()
                .all(|shot| levels(shot)[0] < Some(50) && levels(shot)[1] > Some(150))
        );
        assert_eq!(here, shots(&scene, &settings, true, &scene.goal));
    }

    #[test]
    fn a_scene_of_points_cannot_be_drawn() {
        let settings = EyeSettings {
            sight: Sight::Rendered,
            ..EyeSettings::default()
        };
        let error = Eye::new(&robot_scene(), &Truth::default(), &settings, false).unwrap_err();
        assert!(error.to_string().contains("pattern.marker_size"), "{error}");
    }

    #[test]
    fn a_marker_under_the_spot_is_hidden() {
        // The second marker right under the spot's centre, (320, 222) px.
        let mut object = robot_scene().goal;
        object.translation = [-0.06, 0.045 - 0.35 * 18.0 / 615.0, 0.35];
        let seen = shots(&robot_scene(), &EyeSettings::default(), false, &object);
        assert!(!seen.is_empty() && seen.iter().all(|shot| shot.visible & 2 == 0));
    }

    #[test]
    fn a_marker_is_hidden_when_any_of_it_is_covered() {
        let scene = Scene::parse(scene::TAGS_ROBOT, "tags").unwrap();
        let settings = EyeSettings::default();
        // At the goal, side by side with the spot, a circle about (320, 222) px of radius 38 px,
        // turned: half a side is 26.4 px and half a diagonal 37.3.
        let visible = |roll: f64, beside: f64| {
            let mut scene = scene.clone();
            scene.goal.rotation = [0.0, 0.0, roll];
            // The pattern turns about its middle, (320, 222.4) px.
            let object = from_scene(&scene.goal);
            let [u, v] = project(&scene, &object).unwrap()[0];
            scene.occlusions[0].parts[0].center = [u + 38.0 + beside, v];
            let eye = Eye::new(&scene, &Truth::default(), &settings, false).unwrap();
            eye.true_features(&object).1 & 1 == 1
        };
        let eighth = std::f64::consts::FRAC_PI_4;
        assert_eq!(
            [26.1, 26.7].map(|beside| visible(0.0, beside)),
            [false, true]
        );
        assert_eq!(
            [37.0, 37.6].map(|beside| visible(eighth, beside)),
            [false, true]
        );
        // Outside of the image, which begins at u = 0.
        let mut object = from_scene(&scene.goal);
        let eye = Eye::new(&scene, &Truth::default(), &settings, false).unwrap();
        for (left, expected) in [(26.1, 0b0110), (26.7, 0b1111)] {
            object.translation.x = (left - 320.0) * 0.35 / 615.0 + 0.06;
            assert_eq!(eye.true_features(&object).1, expected);
        }
    }

    #[test]
    fn ideal_features_have_noise_and_gaps_as_asked() {
        let settings = EyeSettings {
            noise_px: 0.3,
            latency: Latency {
                drop: 0.4,
                ..Latency::default()
            },
            ..EyeSettings::default()
        };
        let goal = robot_scene().goal;
        let seen = shots(&robot_scene(), &settings, false, &goal);
        assert!((1..13).contains(&seen.len()));
        assert!(
            seen.windows(2)
                .any(|pair| pair[1].number > pair[0].number + 1)
        );
        let ideal = project(&robot_scene(), &from_scene(&goal)).unwrap();
        let pairs = seen
            .iter()
            .flat_map(|shot| shot.points.iter().flatten().zip(ideal.iter().flatten()));
        let squares: Vec<f64> = pairs.map(|(a, b)| (a - b).powi(2)).collect();
        let deviation = (squares.iter().sum::<f64>() / squares.len() as f64).sqrt();
        assert!((0.15..0.45).contains(&deviation), "{deviation}");
    }

    /// What a camera delivers of 3000 frames of the goal.
    fn flawed(truth: &Truth, settings: &EyeSettings) -> Vec<Shot> {
        let scene = robot_scene();
        let object = from_scene(&scene.goal);
        let mut eye = Eye::new(&truth.scene(&scene), truth, settings, false).unwrap();
        let mut shots = Vec::new();
        for k in 0..3000 {
            let now_ns = 1_000_000_000 + k * 33_333_333;
            eye.expose(&object, &[0.0; 6], now_ns).unwrap();
            shots.extend(std::iter::from_fn(|| eye.deliver(now_ns).unwrap()));
        }
        shots
    }

    #[test]
    fn ideal_features_are_distorted_late_and_lost_in_bursts() {
        let truth = Truth {
            distortion: [-0.2, 0.05, 0.001, 0.0, 0.0],
            stamp_bias_ms: 12.0,
            stamp_jitter_ms: 2.0,
            drop_burst: 6.0,
            ..Truth::default()
        };
        let settings = EyeSettings {
            latency: Latency {
                drop: 0.1,
                ..Latency::default()
            },
            ..EyeSettings::default()
        };
        let scene = robot_scene();
        let (real, seen) = (
            flawed(&Truth::default(), &settings),
            flawed(&truth, &settings),
        );
        let straight = project(&scene, &from_scene(&scene.goal)).unwrap();
        assert_eq!(real[0].points, straight);
        for (found, pixel) in seen[0].points.iter().zip(&straight) {
            assert_eq!(*found, truth.lens(&scene).distort(*pixel));
        }
        let off = seen[0].points[0][0] - straight[0][0];
        assert!((0.8..6.0).contains(&off), "{off}");
        let errors = seen.iter().map(|shot| {
            let true_ns = 1_000_000_000 + (shot.number - 1) * 33_333_333;
            (shot.stamp_ns as f64 - true_ns as f64) * 1e-6
        });
        let mean = errors.sum::<f64>() / seen.len() as f64;
        assert!((mean - 12.0).abs() < 0.3, "{mean}");
        let bursts = |shots: &[Shot]| {
            let gaps = shots
                .windows(2)
                .map(|pair| pair[1].number - pair[0].number - 1);
            let gaps: Vec<u64> = gaps.filter(|gap| *gap > 0).collect();
            gaps.iter().sum::<u64>() as f64 / gaps.len() as f64
        };
        assert!((1.0..1.3).contains(&bursts(&real)), "{}", bursts(&real));
        assert!((4.0..8.0).contains(&bursts(&seen)), "{}", bursts(&seen));
    }

    #[test]
    fn true_occlusions_hide_and_not_those_that_are_believed() {
        // The first marker is 130 px from the spot.
        let settings = EyeSettings::default();
        let visible = |truth: Truth| flawed(&truth, &settings)[0].visible;
        assert_eq!(visible(Truth::default()), 0b1111);
        let [u, v] = project(&robot_scene(), &from_scene(&robot_scene().goal)).unwrap()[0];
        let shifted = Truth {
            mask_shift_px: [u - 320.0, v - 222.0],
            ..Truth::default()
        };
        assert_eq!(visible(shifted), 0b1110);
        let grown = Truth {
            mask_growth_px: 100.0,
            ..Truth::default()
        };
        assert_eq!(visible(grown) & 0b1100, 0);
    }
}
