//! Configuration of the program: a file, then flags, then checks.

use std::path::PathBuf;

use clap::{ArgMatches, Args, Parser, ValueEnum};
use scene::Scene;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use smart_default::SmartDefault;
use toml_schema::{Document, FileError};

use crate::tags::NUMBERS;
use crate::tracker::Pattern;

/// Finds AprilTags (36h11) in a camera's images and publishes them as features for vpcd.
///
/// Exit codes: 0 stopped by SIGTERM, 64 usage, 66 a file is missing, 69 the images or the shared
/// memory cannot be used, 78 configuration.
#[derive(Parser, Debug)]
#[command(name = "vpc-camera", version)]
pub struct Arguments {
    /// Configuration file (TOML), documented in ipc/camera/vpc-camera.toml; flags win over it.
    #[arg(long)]
    pub config: Option<PathBuf>,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub keys: Keys,
}

/// The paths of scene and calibration are relative to the file. Each key has a flag, which wins.
#[derive(Args, Clone, Debug, SmartDefault, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
#[schemars(title = "vpc-camera", extend("required" = ["source", "scene"]))]
pub struct Keys {
    /// Where images come from.
    #[arg(long)]
    #[schemars(extend("x-allowed" = "shm, the service vpc/image"))]
    pub source: Option<String>,
    /// The scene file of vpcd: its camera is the pinhole that features are for.
    #[arg(long)]
    #[schemars(extend("x-allowed" = "a scene file, by the key `scene` or the flag --scene"))]
    pub scene: Option<PathBuf>,
    /// Numbers of the tags whose centres are the points of the scene's pattern, in its order.
    #[arg(long, value_delimiter = ',')]
    #[schemars(inner(range(min = 0, max = 586)), extend("x-default" = "0, 1, ... as many as the pattern has points"))]
    pub tags: Option<Vec<u32>>,
    /// Number of the only tag, whose corners are the points: upper left, upper right, lower right,
    /// lower left.
    #[arg(long, conflicts_with = "tags")]
    #[schemars(range(min = 0, max = 586), extend("x-default" = "none"))]
    pub corners_of: Option<u32>,
    /// Added to the source's stamps of the middle of the exposure; `vpc-calib latency` measures it.
    #[arg(long, default_value_t = 0.0, allow_negative_numbers = true)]
    #[schemars(range(min = -1000, max = 1000), extend("x-unit" = "ms"))]
    pub stamp_offset_ms: f64,
    /// Whose time it is.
    #[arg(long, value_enum, default_value_t)]
    pub clock: Clock,
    /// Directory of the shared memory.
    #[arg(long)]
    #[schemars(extend("x-default" = "/tmp/vpc-UID, the user's number"))]
    pub domain: Option<PathBuf>,
}

/// Whose time features are published in.
#[derive(
    Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum, Deserialize, Serialize, JsonSchema,
)]
#[serde(rename_all = "lowercase")]
pub enum Clock {
    /// The monotonic clock's.
    #[default]
    Fixed,
    /// The images': features are published when their image was, in simulated time.
    Lockstep,
}

/// A checked configuration.
#[derive(Clone, Debug)]
pub struct Config {
    /// The scene of vpcd.
    pub scene: Scene,
    /// What is to be found.
    pub pattern: Pattern,
    /// Added to the stamps of images, ns.
    pub stamp_offset_ns: i64,
    /// Whose time it is.
    pub clock: Clock,
    /// Directory of the shared memory.
    pub domain: PathBuf,
}

impl Config {
    /// Reads the file that the command line names, lays the flags over it, and checks the whole.
    ///
    /// # Errors
    /// [`FileError`] names the file or flag, key, value and what is allowed.
    pub fn load(matches: &ArgMatches) -> Result<Self, FileError> {
        let arguments: Arguments = toml_schema::arguments(matches)?;
        let (file, paths) = (arguments.config.as_deref(), ["scene"]);
        let document = Document::with_flags::<Arguments>(file, &paths, &arguments.keys, matches)?;
        let keys: Keys = document.check()?;
        Self::of(&document, keys)
    }

    fn of(document: &Document, keys: Keys) -> Result<Self, FileError> {
        let source = keys.source.unwrap_or_default();
        if source != "shm" {
            return Err(document.refuse("source", source, "shm".to_owned()));
        }
        let scene = Scene::read(&keys.scene.unwrap_or_default())?;
        let points = scene.pattern.len();
        let pattern = match (keys.corners_of, keys.tags) {
            (Some(_), Some(_)) => {
                let allowed = "without corners_of: the points are either centres or corners";
                return Err(document.refuse("tags", "given", allowed.to_owned()));
            }
            (Some(number), None) => Pattern::Corners(number),
            (None, Some(numbers)) => Pattern::Centres(numbers),
            (None, None) => Pattern::Centres((0..NUMBERS).take(points).collect()),
        };
        if pattern.points() != points {
            let key = match pattern {
                Pattern::Corners(_) => "corners_of",
                Pattern::Centres(_) => "tags",
            };
            let allowed = format!("{points} points, as many as the scene's pattern has");
            let found = format!("{} points", pattern.points());
            return Err(document.refuse(key, found, allowed));
        }
        if let Pattern::Centres(numbers) = &pattern {
            let twice = (1..numbers.len()).find(|&i| numbers[..i].contains(&numbers[i]));
            if let Some(i) = twice {
                let allowed = "each number once".to_owned();
                return Err(document.refuse(&format!("tags[{i}]"), numbers[i], allowed));
            }
        }
        Ok(Self {
            scene,
            pattern,
            stamp_offset_ns: (keys.stamp_offset_ms * 1e6).round() as i64,
            clock: keys.clock,
            domain: keys.domain.unwrap_or_else(ipc::default_directory),
        })
    }
}

/// Returns the JSON Schema of a configuration file.
pub fn schema() -> serde_json::Value {
    toml_schema::schema::<Keys>()
}
