//! Configuration of the program: a file, then flags, then checks.

use std::path::PathBuf;

use clap::{ArgMatches, Args, Parser, Subcommand, ValueEnum};
use markers::Family;
use scene::Scene;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use smart_default::SmartDefault;
use toml_schema::{Document, FileError};

use crate::lens::{self, Lens};
use crate::mask;
use crate::source::Shutter;

/// Finds tags in a camera's images and publishes them as features.
///
/// Takes images from shared memory, a camera or files, finds AprilTags or ArUco markers, and
/// publishes vpc/features. Exit codes: 0 stopped by SIGTERM, or the files are over; 64 usage, 66 a
/// file is missing, 69 the source or the shared memory cannot be used, 70 a defect, 78
/// configuration.
#[derive(Parser, Debug)]
#[command(name = "vpc-camera", version, args_conflicts_with_subcommands = true)]
pub struct Arguments {
    /// Configuration file (TOML), documented in ipc/clients/camera/vpc-camera.toml; flags win over
    /// it.
    #[arg(long)]
    pub config: Option<PathBuf>,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub keys: Keys,
    /// Print what is published, a line a frame.
    #[arg(long)]
    pub print: bool,
    #[command(subcommand)]
    #[allow(missing_docs)]
    pub command: Option<Command>,
}

/// What else the program does.
#[derive(Subcommand, Debug)]
pub enum Command {
    /// Learn what hides the view from images of a camera that moves, and write a mask and a scene.
    Mask(mask::Arguments),
    /// Draw the tags of a scene in their true size, to be printed (SVG).
    #[cfg(feature = "detector")]
    Tags(crate::sheet::Arguments),
    /// Measure where printed tags lie, and write a scene with that pattern. Hold the camera so that
    /// it sees all of them, still.
    #[cfg(feature = "detector")]
    Pattern(PatternArguments),
}

/// The command line of `pattern`.
#[derive(Args, Clone, Debug)]
pub struct PatternArguments {
    /// Configuration file (TOML): source, scene, calibration and tags.
    #[arg(long, value_name = "FILE")]
    pub config: PathBuf,
    /// Width of the black square of a tag, measured on the paper, m.
    #[arg(long, value_name = "METERS")]
    pub black: f64,
    /// The scene to write: that of the configuration with this pattern; in its folder, if it names
    /// other files.
    #[arg(short, long, value_name = "FILE")]
    pub output: PathBuf,
    /// Overwrite the file.
    #[arg(long)]
    pub force: bool,
}

/// Paths are relative to the file. Most keys have a flag, which wins.
#[derive(Args, Clone, Debug, SmartDefault, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
#[schemars(title = "vpc-camera", extend("required" = ["source", "scene"]))]
pub struct Keys {
    /// Where images come from.
    #[arg(long)]
    #[schemars(extend("x-allowed" = "shm: vpc/image of the domain; v4l2:/dev/video0: a camera; files:PATH: a folder of .png and .pgm, or a .y4m video, at the scene's rate"))]
    pub source: Option<String>,
    /// The scene of vpcd; features are projected into its camera.
    #[arg(long)]
    #[schemars(extend("x-allowed" = "a file; also by --scene"))]
    pub scene: Option<PathBuf>,
    /// Calibration of the real lens.
    #[arg(long)]
    #[schemars(extend(
        "x-allowed" = "a file: YAML of ROS, OpenCV or Kalibr, or TOML",
        "x-default" = "the scene's camera"
    ))]
    pub calibration: Option<PathBuf>,
    /// Family of the tags, by OpenCV's name.
    #[arg(long, default_value_t)]
    #[schemars(extend("x-allowed" = "`DICT_` and 4X4, 5X5, 6X6 or 7X7 with _50, _100, _250 or _1000, ARUCO_ORIGINAL, ARUCO_MIP_36h12, or APRILTAG_ with 16h5, 25h9, 36h10 or 36h11"))]
    pub family: Family,
    /// Numbers of the tags at the points of the pattern, in its order.
    #[arg(long, value_delimiter = ',')]
    #[schemars(length(max = 8), extend("x-default" = "0, 1, ..."))]
    pub tags: Option<Vec<u32>>,
    /// Number of the one tag with corners that are the pattern's points: upper left, upper right,
    /// lower right, lower left.
    #[arg(long, conflicts_with = "tags")]
    #[schemars(extend("x-default" = "none"))]
    pub corners_of: Option<u32>,
    /// With v4l2: length of the exposure if the driver does not tell it.
    #[arg(long)]
    #[schemars(range(min = 0, max = 1000), extend("x-unit" = "ms", "x-default" = "the driver's"))]
    pub exposure_ms: Option<f64>,
    /// With v4l2: which rows are exposed when.
    #[arg(long, value_enum, default_value_t)]
    pub shutter: Shutter,
    /// With v4l2: time from reading the first row to reading the last.
    #[arg(long, default_value_t = 0.0)]
    #[schemars(range(min = 0, max = 1000), extend("x-unit" = "ms"))]
    pub readout_ms: f64,
    /// How features are stamped.
    #[arg(long, value_enum, default_value_t)]
    pub clock: Clock,
    /// Directory of the domain.
    #[arg(long)]
    #[schemars(extend("x-default" = "/tmp/vpc-UID"))]
    pub domain: Option<PathBuf>,
    /// Offset of each exposure stamp, as `vpc-calib` measures it.
    #[arg(long, default_value_t = 0.0, allow_negative_numbers = true)]
    #[schemars(range(min = -1000, max = 1000), extend("x-unit" = "ms"))]
    pub stamp_offset_ms: f64,
    /// SCHED_FIFO priority of the loop, below vpcd's 80; 0 is none.
    #[arg(skip)]
    #[schemars(range(min = 0, max = 99))]
    pub realtime_priority: i32,
    /// File for metrics in Prometheus' text format, rewritten every second.
    #[arg(long)]
    #[schemars(extend("x-default" = "none"))]
    pub metrics: Option<PathBuf>,
}

/// How features are stamped.
#[derive(
    Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum, Deserialize, Serialize, JsonSchema,
)]
#[serde(rename_all = "lowercase")]
pub enum Clock {
    /// By their own publication.
    #[default]
    Fixed,
    /// By the publication of the image.
    Lockstep,
}

/// Which tags are features.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Targets {
    /// The centres of these, in the pattern's order.
    Centres(Vec<u32>),
    /// The corners of this one.
    Corners(u32),
}

impl Targets {
    /// Their numbers.
    pub fn numbers(&self) -> &[u32] {
        match self {
            Self::Centres(numbers) => numbers,
            Self::Corners(number) => std::slice::from_ref(number),
        }
    }
}

/// A checked configuration.
#[derive(Clone, Debug)]
pub struct Config {
    /// Where images come from.
    pub source: SourceKind,
    /// The scene of vpcd, and its file.
    pub scene: Scene,
    #[allow(missing_docs)]
    pub scene_path: PathBuf,
    /// The real lens.
    pub lens: Lens,
    /// Family of the tags.
    pub family: Family,
    /// Which tags are features.
    pub targets: Targets,
    /// Of a camera of this computer: its exposure (ns, `None` as the driver tells it), shutter and
    /// readout (ns).
    pub exposure: (Option<u64>, Shutter, u64),
    /// How features are stamped.
    pub clock: Clock,
    /// Directory of the domain.
    pub domain: PathBuf,
    /// Added to each time of exposure, ns.
    pub stamp_offset_ns: i64,
    /// SCHED_FIFO priority of the loop; 0 is none.
    pub realtime_priority: i32,
    /// File for metrics.
    pub metrics: Option<PathBuf>,
}

/// Where images come from.
#[derive(Clone, Debug, PartialEq)]
pub enum SourceKind {
    /// `vpc/image` of the domain.
    Shm,
    /// A camera of this computer.
    V4l2(PathBuf),
    /// A folder of images, or a video.
    Files(PathBuf),
}

impl Config {
    /// Reads the file that the command line names, lays the flags over it, and checks the whole.
    ///
    /// # Errors
    /// [`FileError`] names the file or flag, key, value and what is allowed.
    pub fn load(matches: &ArgMatches) -> Result<Self, FileError> {
        let arguments: Arguments = toml_schema::arguments(matches)?;
        let (file, paths) = (arguments.config.as_deref(), ["scene", "calibration"]);
        let document = Document::with_flags::<Arguments>(file, &paths, &arguments.keys, matches)?;
        let keys: Keys = document.check()?;
        Self::of(&document, keys)
    }

    fn of(document: &Document, keys: Keys) -> Result<Self, FileError> {
        let source = keys.source.unwrap_or_default();
        let source = match source.as_str() {
            "shm" => SourceKind::Shm,
            _ => match source.split_once(':').filter(|(_, path)| !path.is_empty()) {
                Some(("v4l2", device)) => SourceKind::V4l2(device.into()),
                Some(("files", path)) => SourceKind::Files(path.into()),
                _ => {
                    let allowed = "shm, v4l2:DEVICE or files:PATH";
                    return Err(document.refuse("source", &source, allowed.to_owned()));
                }
            },
        };
        document.readable(&["scene", "calibration"])?;
        let scene_path = keys.scene.unwrap_or_default();
        let scene = Scene::read(&scene_path)?;
        let points = scene.pattern.len();
        let targets = match keys.corners_of {
            Some(_) if keys.tags.is_some() => {
                let allowed = "tags or corners_of, not both";
                return Err(document.refuse("corners_of", "given with tags", allowed.to_owned()));
            }
            Some(number) if points == 4 => Targets::Corners(number),
            Some(number) => {
                let allowed = format!("a pattern of 4 points; the scene's has {points}");
                return Err(document.refuse("corners_of", number, allowed));
            }
            None => Targets::Centres(keys.tags.unwrap_or_else(|| (0..points as u32).collect())),
        };
        let count = keys.family.count();
        if let Some(number) = targets.numbers().iter().find(|number| **number >= count) {
            let key = match targets {
                Targets::Centres(_) => "tags",
                Targets::Corners(_) => "corners_of",
            };
            let allowed = format!("0 to {} of {}", count - 1, keys.family);
            return Err(document.refuse(key, number, allowed));
        }
        if let Targets::Centres(numbers) = &targets {
            let is_double = |i: usize| numbers[..i].contains(&numbers[i]);
            if numbers.len() != points || (0..points).any(is_double) {
                let allowed =
                    format!("{points} different numbers, one for each point of the scene");
                return Err(document.refuse("tags", format!("{numbers:?}"), allowed));
            }
        }
        let lens = match &keys.calibration {
            None => Lens::pinhole(&scene.camera),
            Some(path) => {
                let lens = lens::read(path)?;
                lens.check_size([scene.camera.width as u32, scene.camera.height as u32])?;
                lens
            }
        };
        Ok(Self {
            source,
            lens,
            family: keys.family,
            targets,
            exposure: {
                let ns = |ms: f64| (1e6 * ms).round() as u64;
                (keys.exposure_ms.map(ns), keys.shutter, ns(keys.readout_ms))
            },
            clock: keys.clock,
            domain: keys.domain.unwrap_or_else(ipc::default_directory),
            stamp_offset_ns: (1e6 * keys.stamp_offset_ms).round() as i64,
            realtime_priority: keys.realtime_priority,
            metrics: keys.metrics,
            scene,
            scene_path,
        })
    }
}

/// Returns the JSON Schema of a configuration file.
pub fn schema() -> serde_json::Value {
    toml_schema::schema::<Keys>()
}
