//! The camera in the robot's hand: what it sees of the object, late, with jitter, and some frames never.

use std::collections::VecDeque;
use std::sync::mpsc;
use std::thread;

use clap::ValueEnum;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal};
use scene::{Pose, Scene};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use vision::{
    Detector, DetectorError, DetectorSettings, Fate, Latency, LatencyError, Look, LookError,
    Renderer, Transit,
};

use crate::camera::{Points, project};
use crate::occlusion;
use crate::pose::RigidPose;

/// Where features come from.
#[derive(
    Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum, Deserialize, Serialize, JsonSchema,
)]
#[serde(rename_all = "lowercase")]
pub enum Sight {
    /// True projections with pixel noise; a marker whose centre is covered is hidden.
    #[default]
    Ideal,
    /// A detector's, from a rendered picture.
    Rendered,
}

/// Properties of the camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EyeSettings {
    /// Where features come from.
    pub sight: Sight,
    /// From the middle of the exposure to the delivery.
    pub latency: Latency,
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
            noise_px: 0.0,
            seed: 1,
            exposure_ns: 6_000_000,
            readout_ns: 15_000_000,
        }
    }
}

/// Why a camera cannot be, or cannot go on.
#[derive(Debug, thiserror::Error)]
pub enum EyeError {
    /// Latency, jitter or losses.
    #[error(transparent)]
    Latency(#[from] LatencyError),
    /// The picture.
    #[error(transparent)]
    Look(#[from] LookError),
    /// The detector.
    #[error(transparent)]
    Detector(#[from] DetectorError),
    /// No thread for the picture.
    #[error("no thread for the camera's picture: {0}")]
    Thread(std::io::Error),
    /// The thread of the picture ended.
    #[error("the thread of the camera's picture ended")]
    Ended,
}

/// A delivered frame.
#[derive(Clone, Debug, PartialEq)]
pub struct Shot {
    /// Number of the frame, from 1; lost ones leave gaps.
    pub number: u64,
    /// Middle of the exposure, ns.
    pub stamp_ns: u64,
    /// Markers, px; those that are hidden are where they are believed.
    pub points: Points,
    /// Bit i: marker i was measured.
    pub visible: u32,
}

impl Shot {
    /// Whether every marker was measured.
    pub fn is_whole(&self) -> bool {
        self.visible.count_ones() as usize == self.points.len()
    }
}

/// What was seen.
type Seen = (Points, u32);

/// The camera.
#[derive(Debug)]
pub struct Eye {
    real: Scene,
    shown: Vec<bool>,
    noise: Option<Normal<f64>>,
    random: ChaCha8Rng,
    readout_ns: u64,
    transit: Transit<(u64, Option<Seen>)>,
    darkroom: Darkroom,
    frames: u64,
}

impl Eye {
    /// A camera that looks at the scene as it is, `real`, with a detector that knows it as it is `believed`, from the
    /// pose of the object at the start. With `is_live`, pictures are drawn by a thread beside the caller's.
    ///
    /// # Errors
    /// [`EyeError`] names the value that is out of range.
    pub fn new(
        real: &Scene,
        believed: &Scene,
        start: &Pose,
        settings: &EyeSettings,
        is_live: bool,
    ) -> Result<Self, EyeError> {
        let darkroom = match settings.sight {
            Sight::Ideal => Darkroom::None,
            Sight::Rendered => {
                let picture = Box::new(Picture::new(real, believed, start, settings.seed)?);
                if is_live {
                    Darkroom::beside(picture)?
                } else {
                    Darkroom::Here(picture, VecDeque::new())
                }
            }
        };
        Ok(Self {
            real: real.clone(),
            shown: vec![true; real.occlusions.len()],
            noise: Normal::new(0.0, settings.noise_px).ok(),
            random: ChaCha8Rng::seed_from_u64(settings.seed),
            readout_ns: settings.readout_ns,
            transit: Transit::new(settings.latency)?,
            darkroom,
            frames: 0,
        })
    }

    /// Shows or takes away an occlusion, by its index in the scene.
    pub fn show(&mut self, occlusion: usize, shown: bool) {
        if let Some(there) = self.shown.get_mut(occlusion) {
            *there = shown;
        }
    }

    /// Exposes a frame: the object in the camera frame at the middle of the exposure, `stamp_ns`, and the camera's
    /// velocity meanwhile.
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
        let number = self.frames;
        match self.darkroom {
            Darkroom::None => {
                let seen = self.ideal(object);
                self.transit.expose((number, Some(seen)), stamp_ns);
            }
            _ => {
                if let Fate::UnderWay { .. } = self.transit.expose((number, None), stamp_ns) {
                    let half = 0.5e-9 * self.readout_ns as f64;
                    let rows = [-half, half].map(|dt| pose(&object.seen_after(twist, dt)));
                    let shown = self.shown.clone();
                    self.darkroom.develop(Exposure { rows, shown })?;
                }
            }
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
        let developed = match self.darkroom {
            Darkroom::None => None,
            _ => match self.darkroom.developed()? {
                None => return Ok(None),
                seen => seen,
            },
        };
        let Some(frame) = self.transit.deliver(now_ns) else {
            return Ok(None);
        };
        let (number, seen) = frame.payload;
        Ok(seen.or(developed).map(|(points, visible)| Shot {
            number,
            stamp_ns: frame.stamp_ns,
            points,
            visible,
        }))
    }

    fn ideal(&mut self, object: &RigidPose) -> Seen {
        // A point behind the camera is not to be seen; where it is not seen does not matter.
        let Ok(points) = project(&self.real, object) else {
            let middle = [self.real.camera.cx, self.real.camera.cy];
            return (self.real.pattern.iter().map(|_| middle).collect(), 0);
        };
        let mut visible = 0;
        for (i, &pixel) in points.iter().enumerate() {
            visible |= u32::from(self.is_in_sight(pixel)) << i;
        }
        let mut measured = points;
        for x in measured.iter_mut().flatten() {
            *x += self
                .noise
                .map_or(0.0, |noise| noise.sample(&mut self.random));
        }
        (measured, visible)
    }

    fn is_in_sight(&self, pixel: [f64; 2]) -> bool {
        let camera = &self.real.camera;
        let inside = |x: f64, most: f64| (0.0..=most - 1.0).contains(&x);
        let covered = |(occlusion, shown): (&scene::Occlusion, &bool)| {
            *shown && occlusion::distance_below(occlusion, pixel, 0.0) < 0.0
        };
        inside(pixel[0], camera.width)
            && inside(pixel[1], camera.height)
            && !self.real.occlusions.iter().zip(&self.shown).any(covered)
    }
}

fn pose(object: &RigidPose) -> Pose {
    Pose {
        translation: object.translation.into(),
        rotation: object.rotation_vector(),
    }
}

/// A frame for the picture.
struct Exposure {
    /// The object in the camera frame while the first and the last row are exposed.
    rows: [Pose; 2],
    shown: Vec<bool>,
}

/// Renderer and detector.
#[derive(Debug)]
struct Picture {
    renderer: Renderer,
    detector: Detector,
}

impl Picture {
    fn new(real: &Scene, believed: &Scene, start: &Pose, seed: u64) -> Result<Self, EyeError> {
        let look = Look {
            seed,
            ..Look::default()
        };
        let mut detector = Detector::new(believed, &DetectorSettings::default())?;
        detector.expect(start);
        Ok(Self {
            renderer: Renderer::new(real, &look)?,
            detector,
        })
    }

    fn look(&mut self, exposure: &Exposure) -> Result<Seen, EyeError> {
        for (occlusion, &shown) in exposure.shown.iter().enumerate() {
            self.renderer.show(occlusion, shown);
        }
        let [first, last] = &exposure.rows;
        let image = self.renderer.render_rolling(first, last);
        let points = self.detector.detect(image)?;
        let points = points.iter().map(|sighting| sighting.pixel).collect();
        Ok((points, self.detector.visible()))
    }
}

/// Where pictures are made.
#[derive(Debug)]
enum Darkroom {
    /// Nowhere: features are ideal.
    None,
    /// At once, by the caller; kept until the frame is due.
    Here(Box<Picture>, VecDeque<Seen>),
    /// By a thread, so that the robot's millisecond does not wait for it.
    Beside {
        exposures: mpsc::Sender<Exposure>,
        seen: mpsc::Receiver<Result<Seen, EyeError>>,
    },
}

impl Darkroom {
    fn beside(mut picture: Box<Picture>) -> Result<Self, EyeError> {
        let (exposures, to_do) = mpsc::channel::<Exposure>();
        let (done, seen) = mpsc::channel();
        thread::Builder::new()
            .name("picture".into())
            .spawn(move || {
                // Ends when the camera does.
                while let Ok(exposure) = to_do.recv() {
                    if done.send(picture.look(&exposure)).is_err() {
                        break;
                    }
                }
            })
            .map_err(EyeError::Thread)?;
        Ok(Self::Beside { exposures, seen })
    }

    fn develop(&mut self, exposure: Exposure) -> Result<(), EyeError> {
        match self {
            Self::None => Ok(()),
            Self::Beside { exposures, .. } => exposures.send(exposure).map_err(|_| EyeError::Ended),
            Self::Here(picture, kept) => {
                kept.push_back(picture.look(&exposure)?);
                Ok(())
            }
        }
    }

    /// The next picture's features, where it is ready.
    fn developed(&mut self) -> Result<Option<Seen>, EyeError> {
        match self {
            Self::None => Ok(None),
            Self::Here(_, kept) => Ok(kept.pop_front()),
            Self::Beside { seen, .. } => match seen.try_recv() {
                Ok(seen) => seen.map(Some),
                Err(mpsc::TryRecvError::Empty) => Ok(None),
                Err(mpsc::TryRecvError::Disconnected) => Err(EyeError::Ended),
            },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn robot_scene() -> Scene {
        Scene::parse(scene::PAPER_ROBOT, "robot").unwrap()
    }

    fn shots(settings: &EyeSettings, is_live: bool, object: &Pose) -> Vec<Shot> {
        let scene = robot_scene();
        let mut eye = Eye::new(&scene, &scene, object, settings, is_live).unwrap();
        let mut shots = Vec::new();
        let object = RigidPose::new(object);
        for ms in 0..600_u64 {
            let now_ns = ms * 1_000_000;
            if ms % 33 == 0 && ms < 400 {
                eye.expose(&object, &[0.0; 6], now_ns).unwrap();
            }
            if is_live {
                thread::sleep(std::time::Duration::from_millis(1));
            }
            while let Some(shot) = eye.deliver(now_ns).unwrap() {
                assert!(now_ns >= shot.stamp_ns + settings.latency.latency_ns);
                shots.push(shot);
            }
        }
        shots
    }

    #[test]
    fn pictures_drawn_beside_the_robot_are_those_drawn_by_the_caller() {
        let settings = EyeSettings {
            sight: Sight::Rendered,
            ..EyeSettings::default()
        };
        let goal = robot_scene().goal;
        let here = shots(&settings, false, &goal);
        assert_eq!(here.len(), 13);
        assert!(here.iter().all(Shot::is_whole));
        let ideal = project(&robot_scene(), &RigidPose::new(&goal)).unwrap();
        let apart = |shot: &Shot| {
            let pairs = shot.points.iter().flatten().zip(ideal.iter().flatten());
            pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
        };
        assert!(here.iter().all(|shot| apart(shot) < 0.3));
        assert_eq!(here, shots(&settings, true, &goal));
    }

    #[test]
    fn a_marker_under_the_spot_is_hidden_from_both_sights() {
        // The second marker right under the spot's centre, (320, 222) px.
        let mut object = robot_scene().goal;
        object.translation = [-0.06, 0.045 - 0.35 * 18.0 / 615.0, 0.35];
        for sight in [Sight::Ideal, Sight::Rendered] {
            let settings = EyeSettings {
                sight,
                ..EyeSettings::default()
            };
            let seen = shots(&settings, false, &object);
            assert!(!seen.is_empty() && seen.iter().all(|shot| shot.visible & 2 == 0));
        }
    }

    #[test]
    fn ideal_features_have_the_noise_asked_for_and_lost_frames_leave_gaps() {
        let settings = EyeSettings {
            noise_px: 0.3,
            latency: Latency {
                drop: 0.4,
                ..Latency::default()
            },
            ..EyeSettings::default()
        };
        let goal = robot_scene().goal;
        let seen = shots(&settings, false, &goal);
        assert!((1..13).contains(&seen.len()));
        assert!(
            seen.windows(2)
                .any(|pair| pair[1].number > pair[0].number + 1)
        );
        let ideal = project(&robot_scene(), &RigidPose::new(&goal)).unwrap();
        let pairs = seen
            .iter()
            .flat_map(|shot| shot.points.iter().flatten().zip(ideal.iter().flatten()));
        let squares: Vec<f64> = pairs.map(|(a, b)| (a - b).powi(2)).collect();
        let deviation = (squares.iter().sum::<f64>() / squares.len() as f64).sqrt();
        assert!((0.15..0.45).contains(&deviation), "{deviation}");
    }
}
