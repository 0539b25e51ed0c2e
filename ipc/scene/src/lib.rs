//! The scene: everything that the controller, the builder of the memory and the emulator must agree
//! on.
//!
//! A scene file (TOML) names the camera, the pattern that it looks at, the goal, the limits, the
//! weights of the cost, what counts as success, the region of random starts, and the occlusions of
//! the image. This crate holds the types and their checks, and **no mathematics of control**:
//! controller and emulator each bring their own, so that one mistake cannot hide on both sides. The
//! `README.md` explains the decisions that may surprise.
//!
//! Without the feature `file` the crate is `no_std` and never allocates, so that the control law
//! can use it.
//!
//! ```
//! # fn main() -> Result<(), scene::FileError> {
//! let scene = scene::Scene::parse(scene::PAPER_SIM, "paper-sim.toml")?;
//! assert_eq!(scene.pattern.len(), 4);
//! assert_eq!(scene.occlusions.len(), 4);
//! # Ok(())
//! # }
//! ```
#![cfg_attr(not(feature = "file"), no_std)]
#![forbid(unsafe_code)]

mod fingerprint;
mod model;

#[cfg(feature = "file")]
mod arm;
#[cfg(feature = "file")]
mod collision;
#[cfg(feature = "file")]
mod file;
#[cfg(feature = "file")]
mod files;
#[cfg(feature = "file")]
mod shape;
#[cfg(feature = "file")]
mod starts;
#[cfg(feature = "file")]
mod text;

pub use fingerprint::Fingerprint;
pub use mask::{Area, Field, MAX_AREAS, Mask};
pub use model::{
    Arm, ArmJoint, Camera, Cost, Cuboid, Limits, MAX_BOXES, MAX_JOINTS, MAX_OCCLUSIONS, MAX_PAIRS,
    MAX_PARTS, MAX_POINTS, MAX_SHAPES, MAX_WALL_POINTS, MAX_WALLS, MIN_POINTS, Name, Occlusion,
    Other, Pair, Part, Pose, Scene, Shape, StartRegion, Success, Wall,
};

#[cfg(feature = "file")]
pub use arm::schema as arm_schema;
#[cfg(feature = "file")]
pub use file::schema;
#[cfg(feature = "file")]
pub use files::SceneFiles;
#[cfg(feature = "file")]
pub use mask::write_mask;
#[cfg(feature = "file")]
pub use starts::{parse_starts, read_starts, starts_csv};
#[cfg(feature = "file")]
pub use text::{with_mask, with_value};
#[cfg(feature = "file")]
pub use toml_schema::{Difference, FileError};

/// The text of `scenes/paper-sim.toml`: the simulated experiment of the paper.
pub const PAPER_SIM: &str = include_str!("../scenes/paper-sim.toml");

/// The text of `scenes/paper-sim-starts.csv`: 100 fixed starts for [`PAPER_SIM`].
pub const PAPER_SIM_STARTS: &str = include_str!("../scenes/paper-sim-starts.csv");

/// The text of `scenes/paper-robot.toml`: the robot experiment of the paper.
pub const PAPER_ROBOT: &str = include_str!("../scenes/paper-robot.toml");

/// The text of `scenes/paper-robot-starts.csv`: 100 fixed starts for [`PAPER_ROBOT`].
pub const PAPER_ROBOT_STARTS: &str = include_str!("../scenes/paper-robot-starts.csv");

/// The text of `scenes/tags-robot.toml`: [`PAPER_ROBOT`] with tags, whose size is given, instead of
/// points.
pub const TAGS_ROBOT: &str = include_str!("../scenes/tags-robot.toml");

/// The text of `scenes/tags-robot-starts.csv`: 100 starts for [`TAGS_ROBOT`], drawn by `vpc-memory
/// starts --seed 15`.
pub const TAGS_ROBOT_STARTS: &str = include_str!("../scenes/tags-robot-starts.csv");
