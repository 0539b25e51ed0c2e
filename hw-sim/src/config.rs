//! Configuration of the process: file, then flags, then checks.

use std::path::{Path, PathBuf};

use clap::{Parser, ValueEnum};
use scene::{Pose, Scene, read_starts};
use serde::Deserialize;

use crate::eye::Sight;
use crate::robot::bridge::Shaping;
use crate::robot::calibration::{HandEye, Truth};
use crate::robot::rig::RigSettings;
use crate::sensor::Flaws;

/// Emulates the camera of a scene, and what carries it, behind shared memory.
///
/// Publishes features, executes the twists that answer them, and judges the run. Prints its verdict as one JSON line.
/// Exit codes: 0 arrived, 1 not arrived, 64 usage, 66 a file is missing, 69 another camera is at work or nobody
/// answers, 78 configuration.
#[derive(Parser, Debug, Default)]
#[command(name = "hw-sim", version, allow_negative_numbers = true)]
pub struct Arguments {
    /// Configuration file (TOML), documented in hw-sim/hw-sim.toml; flags win over it.
    #[arg(long)]
    pub config: Option<PathBuf>,
    /// Scene file.
    #[arg(long)]
    pub scene: Option<PathBuf>,
    /// File of start poses.
    #[arg(long)]
    pub starts: Option<PathBuf>,
    /// Which of them, from 0.
    #[arg(long)]
    pub start: Option<usize>,
    /// Runs every start from that one on, one after another, each as a new run.
    #[arg(long, conflicts_with = "record")]
    pub all: bool,
    /// Begins again after the last start, until it is stopped. Between two runs the camera rests at the goal.
    #[arg(long = "loop", conflicts_with = "record")]
    pub repeat: bool,
    /// Whose time it is.
    #[arg(long, value_enum)]
    pub clock: Option<Clock>,
    /// Directory of the shared memory.
    #[arg(long)]
    pub domain: Option<PathBuf>,
    /// Records every frame to this file (JSON lines).
    #[arg(long)]
    pub record: Option<PathBuf>,
    /// Pixel noise, standard deviation, px.
    #[arg(long)]
    pub noise: Option<f64>,
    /// Frames between exposure and delivery.
    #[arg(long)]
    pub delay: Option<usize>,
    /// Probability that a frame is lost.
    #[arg(long)]
    pub drop: Option<f64>,
    /// Seed of noise and losses.
    #[arg(long)]
    pub seed: Option<u64>,
    /// Seconds until the run ends; the scene's time where none is given.
    #[arg(long)]
    pub time_limit: Option<f64>,
    /// Shows a line of progress.
    #[arg(long)]
    pub progress: bool,
    /// What carries the camera.
    #[arg(long, value_enum)]
    pub robot: Option<Body>,
    /// Panda: where features come from.
    #[arg(long, value_enum)]
    pub camera: Option<Sight>,
    /// Panda: from the middle of an exposure to its delivery, ms.
    #[arg(long)]
    pub latency_ms: Option<f64>,
    /// Panda: deviation of that to either side, ms.
    #[arg(long)]
    pub jitter_ms: Option<f64>,
    /// Panda: sends the 30 Hz staircase to the robot as it is, to see what it says.
    #[arg(long)]
    pub unshaped: bool,
}

/// What carries the camera.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, ValueEnum)]
#[serde(rename_all = "lowercase")]
pub enum Body {
    /// Nothing: it moves exactly as told, at once.
    #[default]
    Free,
    /// A Franka Emika Panda behind its 1 kHz velocity interface.
    Panda,
}

/// Whose time it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, ValueEnum)]
#[serde(rename_all = "lowercase")]
pub enum Clock {
    /// Frames at the camera's rate on the monotonic clock.
    Fixed,
    /// A frame for each answer: as fast as the controller.
    Lockstep,
}

#[derive(Deserialize, Default)]
#[serde(deny_unknown_fields)]
struct RawConfig {
    scene: Option<PathBuf>,
    starts: Option<PathBuf>,
    start: Option<usize>,
    clock: Option<Clock>,
    domain: Option<PathBuf>,
    record: Option<PathBuf>,
    noise_px: Option<f64>,
    delay_frames: Option<usize>,
    drop: Option<f64>,
    seed: Option<u64>,
    time_limit_s: Option<f64>,
    robot: Option<Body>,
    camera: Option<Sight>,
    latency_ms: Option<f64>,
    jitter_ms: Option<f64>,
    exposure_ms: Option<f64>,
    readout_ms: Option<f64>,
    dwell_s: Option<f64>,
    retreat_m: Option<f64>,
    hand_eye: Option<HandEye>,
    truth: Option<Truth>,
}

/// A checked configuration.
#[derive(Clone, Debug)]
pub struct Config {
    /// The scene.
    pub scene: Scene,
    /// Its file, for messages and recordings.
    pub scene_file: String,
    /// Where the object is at first, run after run, with the number of each start.
    pub starts: Vec<(usize, Pose)>,
    /// Whether to begin again after the last of them.
    pub repeat: bool,
    /// Whose time it is.
    pub clock: Clock,
    /// Directory of the shared memory.
    pub domain: PathBuf,
    /// Where to record.
    pub record: Option<PathBuf>,
    /// Flaws of the camera.
    pub flaws: Flaws,
    /// Seconds until the run ends.
    pub time_limit_s: f64,
    /// Whether to show progress.
    pub progress: bool,
    /// What carries the camera.
    pub robot: Body,
    /// The robot's cell, where a robot does.
    pub rig: RigSettings,
}

/// Why a configuration was refused.
#[derive(Debug, thiserror::Error)]
pub enum ConfigError {
    /// A file could not be read.
    #[error("{path}: cannot read: {source}")]
    Read {
        /// The file.
        path: String,
        /// The operating system's reason.
        source: std::io::Error,
    },
    /// The file is not the TOML of a configuration.
    #[error("{path}: {message}")]
    Syntax {
        /// The file.
        path: String,
        /// Line, column, what was expected.
        message: String,
    },
    /// A value is out of range, or missing.
    #[error("{key} = {value}; allowed: {allowed}")]
    Value {
        /// The key.
        key: &'static str,
        /// What was found.
        value: String,
        /// What is allowed.
        allowed: String,
    },
    /// The scene was refused.
    #[error(transparent)]
    Scene(#[from] scene::SceneError),
    /// The starts were refused.
    #[error(transparent)]
    Starts(#[from] scene::StartsError),
}

impl ConfigError {
    /// The sysexits code that says it: 66 where a file is missing, else 78.
    pub fn exit_code(&self) -> u8 {
        match self {
            Self::Read { .. }
            | Self::Scene(scene::SceneError::Read { .. })
            | Self::Starts(scene::StartsError::Read { .. }) => 66,
            _ => 78,
        }
    }
}

impl Config {
    /// The configuration that file and flags make. Paths in the file are relative to the file.
    ///
    /// # Errors
    /// [`ConfigError`] names the file or key, the value and what is allowed.
    pub fn load(arguments: &Arguments) -> Result<Self, ConfigError> {
        let raw = arguments
            .config
            .as_deref()
            .map(read_file)
            .transpose()?
            .unwrap_or_default();
        let missing = |key, allowed: &str| ConfigError::Value {
            key,
            value: "nothing".into(),
            allowed: allowed.into(),
        };
        let scene_path = arguments.scene.clone().or(raw.scene);
        let scene_path =
            scene_path.ok_or_else(|| missing("scene", "a scene file (--scene FILE)"))?;
        let starts_path = arguments.starts.clone().or(raw.starts);
        let starts_path =
            starts_path.ok_or_else(|| missing("starts", "a file of starts (--starts FILE)"))?;
        let scene = Scene::read(&scene_path)?;
        let starts = read_starts(&starts_path)?;
        let index = arguments.start.or(raw.start).unwrap_or(0);
        if index >= starts.len() {
            return Err(ConfigError::Value {
                key: "start",
                value: index.to_string(),
                allowed: format!("0 to {} ({})", starts.len() - 1, starts_path.display()),
            });
        }
        let many = if arguments.all { usize::MAX } else { 1 };
        let starts = starts.into_iter().enumerate().skip(index).take(many);
        let number = |key, value: f64, low: f64, high: f64| {
            if (low..=high).contains(&value) {
                Ok(value)
            } else {
                let allowed = format!("{low} to {high}");
                Err(ConfigError::Value {
                    key,
                    value: value.to_string(),
                    allowed,
                })
            }
        };
        let delay = arguments.delay.or(raw.delay_frames).unwrap_or(0);
        number("delay_frames", delay as f64, 0.0, 100.0)?;
        let robot = arguments.robot.or(raw.robot).unwrap_or_default();
        let clock = arguments.clock.or(raw.clock).unwrap_or(Clock::Fixed);
        let mut rig = RigSettings::new(&scene);
        rig.is_live = clock == Clock::Fixed;
        let eye = &mut rig.eye;
        eye.sight = arguments.camera.or(raw.camera).unwrap_or_default();
        let nanoseconds = |key, ms: Option<f64>, default_ns: u64, most: f64| {
            let ms = ms.unwrap_or(default_ns as f64 * 1e-6);
            Ok::<u64, ConfigError>((number(key, ms, 0.0, most)? * 1e6).round() as u64)
        };
        let latency_ms = arguments.latency_ms.or(raw.latency_ms);
        eye.latency.latency_ns =
            nanoseconds("latency_ms", latency_ms, eye.latency.latency_ns, 900.0)?;
        let jitter_ms = arguments.jitter_ms.or(raw.jitter_ms);
        let most = eye.latency.latency_ns as f64 * 1e-6;
        eye.latency.jitter_ns = nanoseconds("jitter_ms", jitter_ms, 0, most)?;
        eye.exposure_ns = nanoseconds("exposure_ms", raw.exposure_ms, eye.exposure_ns, 33.0)?;
        eye.readout_ns = nanoseconds("readout_ms", raw.readout_ms, eye.readout_ns, 33.0)?;
        let dwell_s = number("dwell_s", raw.dwell_s.unwrap_or(0.5), 0.0, 60.0)?;
        rig.sequence.dwell_ns = (dwell_s * 1e9) as u64;
        rig.sequence.retreat_m = number("retreat_m", raw.retreat_m.unwrap_or(0.04), 0.0, 0.3)?;
        rig.arm.hand_eye = raw.hand_eye.unwrap_or_default();
        for x in rig.arm.hand_eye.translation {
            number("hand_eye.translation", x, -1.0, 1.0)?;
        }
        for x in rig.arm.hand_eye.rotation_deg {
            number("hand_eye.rotation_deg", x, -360.0, 360.0)?;
        }
        rig.arm.truth = raw.truth.unwrap_or_default();
        for (key, value, low, high) in rig.arm.truth.ranges() {
            number(key, value, low, high)?;
        }
        if arguments.unshaped {
            rig.arm.shaping = Shaping::Off;
        }
        if robot == Body::Panda && delay > 0 {
            return Err(ConfigError::Value {
                key: "delay_frames",
                value: delay.to_string(),
                allowed: "0 with robot = \"panda\", whose camera has latency_ms".into(),
            });
        }
        let time_limit = arguments
            .time_limit
            .or(raw.time_limit_s)
            .unwrap_or(scene.success.time_s);
        let flaws = Flaws {
            noise_px: number(
                "noise_px",
                arguments.noise.or(raw.noise_px).unwrap_or(0.0),
                0.0,
                100.0,
            )?,
            delay_frames: delay,
            drop: number("drop", arguments.drop.or(raw.drop).unwrap_or(0.0), 0.0, 1.0)?,
            seed: arguments.seed.or(raw.seed).unwrap_or(1),
        };
        (rig.eye.noise_px, rig.eye.seed) = (flaws.noise_px, flaws.seed);
        (rig.eye.latency.drop, rig.eye.latency.seed) = (flaws.drop, flaws.seed);
        rig.time_limit_s = number("time_limit_s", time_limit, 0.1, 86_400.0)?;
        Ok(Self {
            scene_file: scene_path.display().to_string(),
            starts: starts.collect(),
            repeat: arguments.repeat,
            clock,
            domain: arguments
                .domain
                .clone()
                .or(raw.domain)
                .unwrap_or_else(ipc::default_directory),
            record: arguments.record.clone().or(raw.record),
            flaws,
            time_limit_s: rig.time_limit_s,
            progress: arguments.progress,
            robot,
            rig,
            scene,
        })
    }
}

fn read_file(path: &Path) -> Result<RawConfig, ConfigError> {
    let name = path.display().to_string();
    let text = std::fs::read_to_string(path).map_err(|source| ConfigError::Read {
        path: name.clone(),
        source,
    })?;
    let mut raw: RawConfig = toml::from_str(&text).map_err(|e| ConfigError::Syntax {
        path: name,
        message: e.to_string().trim_end().to_owned(),
    })?;
    let directory = path.parent().unwrap_or(Path::new(""));
    for file in [&mut raw.scene, &mut raw.starts].into_iter().flatten() {
        *file = directory.join(&*file);
    }
    Ok(raw)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn load(text: &str) -> Result<Config, String> {
        let directory = tempfile::TempDir::new().unwrap();
        let file = directory.path().join("hw-sim.toml");
        let scenes = concat!(env!("CARGO_MANIFEST_DIR"), "/../ipc/scene/scenes/");
        let base = format!(
            "scene = \"{scenes}paper-sim.toml\"\nstarts = \"{scenes}paper-sim-starts.csv\"\n"
        );
        std::fs::write(&file, base + text).unwrap();
        let arguments = Arguments {
            config: Some(file),
            ..Arguments::default()
        };
        Config::load(&arguments).map_err(|e| e.to_string())
    }

    #[test]
    fn the_defaults_are_the_scenes() {
        let config = load("").unwrap();
        assert_eq!((config.clock, config.time_limit_s), (Clock::Fixed, 15.0));
        assert_eq!(
            config.flaws,
            Flaws {
                seed: 1,
                ..Flaws::default()
            }
        );
    }

    #[test]
    fn calibration_and_truth_reach_the_cell() {
        let config = load(
            "robot = \"panda\"\nlatency_ms = 50.0\nnoise_px = 0.3\n[hand_eye]\ntranslation = [0.1, 0.0, 0.0]\n\
             rotation_deg = [0.0, 0.0, 90.0]\n[truth]\nhand_eye_m = [0.0, 0.01, 0.0]\ndepth = 0.1\n",
        )
        .unwrap();
        assert_eq!(config.robot, Body::Panda);
        let rig = config.rig;
        assert_eq!(rig.arm.hand_eye.translation, [0.1, 0.0, 0.0]);
        assert_eq!(rig.arm.truth.depth, 0.1);
        assert_eq!(
            (rig.eye.latency.latency_ns, rig.eye.noise_px),
            (50_000_000, 0.3)
        );
        // One centimetre along the camera's y axis, which is the flange's -x here.
        let believed = rig.arm.hand_eye.mount();
        let mount = rig.arm.truth.mount(&believed).flange_from_camera;
        assert!((mount.translation.vector - nalgebra::Vector3::new(0.09, 0.0, 0.0)).norm() < 1e-12);
        assert!(load("").unwrap().rig.arm.truth.is_exact());
    }

    #[test]
    fn refusals_name_key_value_and_range() {
        for (text, words) in [
            ("noise_px = nan", ["noise_px", "NaN", "0 to 100"]),
            ("drop = 1.5", ["drop", "1.5", "0 to 1"]),
            ("start = 100", ["start", "100", "0 to 99"]),
            (
                "time_limit_s = -1.0",
                ["time_limit_s", "-1", "0.1 to 86400"],
            ),
            ("speed = 1", ["speed", "unknown field", "delay_frames"]),
            ("clock = \"slow\"", ["clock", "slow", "lockstep"]),
            ("robot = \"kuka\"", ["robot", "kuka", "panda"]),
            ("latency_ms = 1e4", ["latency_ms", "10000", "0 to 900"]),
            ("jitter_ms = 111.0", ["jitter_ms", "111", "0 to 110"]),
            (
                "[truth]\nfocal = 0.9",
                ["truth.focal", "0.9", "-0.5 to 0.5"],
            ),
            (
                "[truth]\nhand_eye_m = [0.0, nan, 0.0]",
                ["truth.hand_eye_m", "NaN", "-0.2 to 0.2"],
            ),
            (
                "robot = \"panda\"\ndelay_frames = 3",
                ["delay_frames", "3", "latency_ms"],
            ),
        ] {
            let message = load(text).unwrap_err();
            assert!(words.iter().all(|word| message.contains(word)), "{message}");
        }
    }
}
