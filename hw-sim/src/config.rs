//! Configuration of the process: file, then flags, then checks.

use std::path::{Path, PathBuf};

use clap::{Parser, ValueEnum};
use scene::{Pose, Scene, read_starts};
use serde::Deserialize;

use crate::sensor::Flaws;

/// Emulates the camera of a scene, and what carries it, behind shared memory.
///
/// Publishes features, executes the twists that answer them, and judges the run. Prints its verdict as one JSON line.
/// Exit codes: 0 arrived, 1 not arrived, 64 usage, 66 a file is missing, 69 another camera is at work or nobody
/// answers, 78 configuration.
#[derive(Parser, Debug, Default)]
#[command(name = "hw-sim", version)]
pub struct Arguments {
    /// Configuration file (TOML); every key has a flag that overrides it. See hw-sim/hw-sim.toml.
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
}

/// A checked configuration.
#[derive(Clone, Debug)]
pub struct Config {
    /// The scene.
    pub scene: Scene,
    /// Its file, for messages and recordings.
    pub scene_file: String,
    /// Where the object is at first.
    pub start: Pose,
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
        let start = *starts.get(index).ok_or_else(|| ConfigError::Value {
            key: "start",
            value: index.to_string(),
            allowed: format!("0 to {} ({})", starts.len() - 1, starts_path.display()),
        })?;
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
        let time_limit = arguments
            .time_limit
            .or(raw.time_limit_s)
            .unwrap_or(scene.success.time_s);
        Ok(Self {
            scene_file: scene_path.display().to_string(),
            start,
            clock: arguments.clock.or(raw.clock).unwrap_or(Clock::Fixed),
            domain: arguments
                .domain
                .clone()
                .or(raw.domain)
                .unwrap_or_else(ipc::default_directory),
            record: arguments.record.clone().or(raw.record),
            flaws: Flaws {
                noise_px: number(
                    "noise_px",
                    arguments.noise.or(raw.noise_px).unwrap_or(0.0),
                    0.0,
                    100.0,
                )?,
                delay_frames: delay,
                drop: number("drop", arguments.drop.or(raw.drop).unwrap_or(0.0), 0.0, 1.0)?,
                seed: arguments.seed.or(raw.seed).unwrap_or(1),
            },
            time_limit_s: number("time_limit_s", time_limit, 0.1, 86_400.0)?,
            progress: arguments.progress,
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
        let directory = std::env::temp_dir().join(format!("hw-sim-config-{}", std::process::id()));
        std::fs::create_dir_all(&directory).unwrap();
        let file = directory.join(format!("{:?}.toml", std::thread::current().id()));
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
        ] {
            let message = load(text).unwrap_err();
            assert!(words.iter().all(|word| message.contains(word)), "{message}");
        }
    }
}
