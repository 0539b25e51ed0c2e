//! The command line.

use std::path::{Path, PathBuf};

use clap::{Args, Parser, Subcommand};
use markers::Family;
use scene::Scene;
use tag_board::Board;
use toml_schema::FileError;

use crate::hand_eye::Mounting;
use crate::target::Target;

/// Calibrates a camera on a robot's wrist.
///
/// Prints what was found, how certain it is, and whether it is good enough; writes files only if it
/// is, and never over others without --force. Exit codes: 0 good, 1 not good enough, 64 usage, 66 a
/// file is missing, 69 the shared memory cannot be used or nothing comes, 70 a defect, 73 a file
/// exists or cannot be written, 78 a file is wrong.
#[derive(Parser, Debug)]
#[command(name = "vpc-calib", version)]
pub struct Arguments {
    #[command(subcommand)]
    #[allow(missing_docs)]
    pub command: Command,
}

/// What is calibrated.
#[derive(Subcommand, Debug)]
pub enum Command {
    /// Draw a board of AprilTags to print (SVG, exact sizes in mm)
    Board(BoardArguments),
    /// Focal lengths, principal point and distortion, from views of a board
    Intrinsics(IntrinsicsArguments),
    /// Where the camera is mounted, from poses of the robot and views of a board
    HandEye(HandEyeArguments),
    /// How far the stamps of images are off, from a camera that is wiggled
    Latency(LatencyArguments),
}

/// What is looked at.
#[derive(Args, Clone, Debug, Default)]
pub struct TargetArguments {
    /// File of the board (TOML), documented in ipc/clients/calib/board/board.toml; default: that
    /// one.
    #[arg(long, value_name = "FILE")]
    pub board: Option<PathBuf>,
    /// A scene instead: tags 0, 1, ... at the points of its pattern.
    #[arg(long, value_name = "FILE", conflicts_with = "board")]
    pub scene: Option<PathBuf>,
}

/// Files that are written.
#[derive(Args, Clone, Debug, Default)]
pub struct OutputArguments {
    /// File that the result is written to; may be given several times.
    #[arg(short, long, value_name = "FILE")]
    pub output: Vec<PathBuf>,
    /// Overwrite files.
    #[arg(long)]
    pub force: bool,
}

/// Where images come from.
#[derive(Args, Clone, Debug)]
pub struct ImageArguments {
    /// A folder of images (PNG) instead of those that come now.
    #[arg(long, value_name = "FOLDER", conflicts_with_all = ["domain", "config", "views", "save"])]
    pub images: Option<PathBuf>,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub stream: StreamArguments,
    /// Views to take, one whenever nothing moves.
    #[arg(long, default_value_t = 15, value_parser = clap::value_parser!(u32).range(4..=200))]
    pub views: u32,
    /// New folder that the views are saved to, for --images.
    #[arg(long, value_name = "FOLDER")]
    pub save: Option<PathBuf>,
}

/// Where images and joints come from that come now.
#[derive(Args, Clone, Debug, Default)]
pub struct StreamArguments {
    /// Directory of the shared memory.
    #[arg(long, value_name = "FOLDER")]
    pub domain: Option<PathBuf>,
    /// Configuration of vpc-camera, to take its source instead of vpc/image: a V4L2 camera.
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
}

#[derive(Args, Debug)]
#[allow(missing_docs)]
pub struct BoardArguments {
    /// File of the board (TOML), documented in ipc/clients/calib/board/board.toml; default: that
    /// one.
    #[arg(long, value_name = "FILE")]
    pub board: Option<PathBuf>,
    #[command(flatten)]
    pub output: OutputArguments,
}

#[derive(Args, Debug)]
#[allow(missing_docs)]
pub struct IntrinsicsArguments {
    #[command(flatten)]
    pub images: ImageArguments,
    #[command(flatten)]
    pub target: TargetArguments,
    /// Estimate k3, too, for lenses that distort strongly.
    #[arg(long)]
    pub k3: bool,
    #[command(flatten)]
    pub output: OutputArguments,
}

#[derive(Args, Debug)]
#[allow(missing_docs)]
pub struct HandEyeArguments {
    #[command(flatten)]
    pub images: ImageArguments,
    /// Poses of the robot (CSV); default: poses.csv in the folder of the images. Without --images:
    /// with the board's poses in the camera.
    #[arg(long, value_name = "FILE", conflicts_with_all = ["domain", "config", "views", "save"])]
    pub poses: Option<PathBuf>,
    /// The camera stands still, the flange carries the board.
    #[arg(long)]
    pub eye_to_hand: bool,
    /// Calibration of the camera, as intrinsics writes it.
    #[arg(long, value_name = "FILE", required_unless_present = "poses")]
    pub camera: Option<PathBuf>,
    #[command(flatten)]
    pub target: TargetArguments,
    #[command(flatten)]
    pub output: OutputArguments,
}

impl HandEyeArguments {
    /// What the flange carries.
    pub fn mounting(&self) -> Mounting {
        match self.eye_to_hand {
            true => Mounting::EyeToHand,
            false => Mounting::EyeInHand,
        }
    }
}

#[derive(Args, Debug)]
#[allow(missing_docs)]
pub struct LatencyArguments {
    #[command(flatten)]
    pub stream: StreamArguments,
    /// Time to watch; Ctrl-C ends it before.
    #[arg(long, value_name = "S", default_value_t = 20.0)]
    pub seconds: f64,
    /// Calibration of the camera, as intrinsics writes it.
    #[arg(long, value_name = "FILE", required_unless_present = "robot_poses")]
    pub camera: Option<PathBuf>,
    /// The camera on the flange, as hand-eye writes it.
    #[arg(long, value_name = "FILE", required_unless_present = "robot_poses")]
    pub hand_eye: Option<PathBuf>,
    /// Instead of images: poses of the flange in the base (CSV).
    #[arg(long, value_name = "FILE", requires = "board_poses",
        conflicts_with_all = ["domain", "config", "seconds", "camera", "hand_eye", "board", "scene"])]
    pub robot_poses: Option<PathBuf>,
    /// Poses of the board in the camera (CSV), at its stamps.
    #[arg(long, value_name = "FILE", requires = "robot_poses")]
    pub board_poses: Option<PathBuf>,
    #[command(flatten)]
    pub target: TargetArguments,
}

/// The board of a file, or the default one.
///
/// # Errors
/// [`FileError`].
pub fn board(path: Option<&Path>) -> Result<Board, FileError> {
    path.map_or_else(|| Ok(Board::default()), Board::read)
}

impl TargetArguments {
    /// What is looked at; a board with its layout.
    ///
    /// # Errors
    /// [`FileError`]: the file is wrong, or a scene has no tags.
    pub fn read(&self) -> Result<(Target, Option<Board>), FileError> {
        let Some(path) = &self.scene else {
            let board = board(self.board.as_deref())?;
            return Ok((Target::from(&board), Some(board)));
        };
        let scene = Scene::read(path)?;
        if scene.marker_size <= 0.0 {
            let (path, key) = (path.display().to_string(), "pattern.marker_size");
            let allowed = "above 0: the side of a tag with its white border, m";
            return Err(FileError::value(&path, key, scene.marker_size, allowed));
        }
        let target = Target::of_scene(&scene, Family::default().black_share() * scene.marker_size);
        Ok((target, None))
    }
}
