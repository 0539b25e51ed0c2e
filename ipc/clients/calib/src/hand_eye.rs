//! Where the camera is mounted, from poses of the robot and views of a target: the camera on the
//! flange and the target still, or the camera still and the target on the flange.
//!
//! Source: F. Park and B. Martin, "Robot sensor calibration: solving AX = XB on the Euclidean
//! group" (1994), for the start; then least squares on poses, which also tells what is wrong with
//! them; then, where corners are known, mounting, target and an error of each robot pose at once,
//! by least squares on reprojection errors. The robot's accuracy is estimated with them.

mod cause;
mod corners;
mod poses;
mod report;

use std::fmt;

use vision_calibration_core::{Iso3, Vec3};
use vision_calibration_optim::HandeyeMode;

pub use self::cause::{Cause, Reason, Scale, Spread};
use self::poses::Poses;
use crate::camera::Camera;
use crate::motion::{AXES, MotionError, ROTATION_DEG};
use crate::pose;
use crate::pose_file::RobotPose;
use crate::target::Target;
use crate::view::View;

/// Fewest pairs that are solved, and fewest of a good result.
pub const FEWEST: usize = 5;
const ENOUGH: usize = 8;

/// A pose of the robot and what its camera saw there.
#[derive(Clone, Debug)]
pub struct Pair {
    /// The flange in the base (O_T_F), m.
    pub flange: Iso3,
    /// What was seen.
    pub view: View,
}

/// What the flange carries; the other one stands still.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Mounting {
    /// The camera.
    #[default]
    EyeInHand,
    /// The target.
    EyeToHand,
}

impl Mounting {
    /// Frames that camera and target are fixed in.
    pub fn frames(self) -> [&'static str; 2] {
        match self {
            Self::EyeInHand => ["flange", "base"],
            Self::EyeToHand => ["base", "flange"],
        }
    }

    /// The camera's frame in that of the target, given the flange in the base.
    fn robot(self, flange: &Iso3) -> Iso3 {
        match self {
            Self::EyeInHand => *flange,
            Self::EyeToHand => flange.inverse(),
        }
    }

    fn mode(self) -> HandeyeMode {
        match self {
            Self::EyeInHand => HandeyeMode::EyeInHand,
            Self::EyeToHand => HandeyeMode::EyeToHand,
        }
    }
}

/// A result.
#[derive(Clone, Debug)]
pub struct HandEye {
    /// What is mounted where.
    pub mounting: Mounting,
    /// The camera in the flange frame (F_T_C), or in the base, m.
    pub camera: Iso3,
    /// The target in the base (O_T_B), or in the flange frame, m.
    pub target: Iso3,
    /// Standard deviations of the camera's place and turn, along and about its axes, m and rad;
    /// `Err` has what the pairs do not determine.
    pub sigma: Result<[f64; 6], String>,
    /// What robot and camera are estimated to miss each other by, one standard deviation along or
    /// about an axis: m, rad. With images, the camera's share is known and left out.
    pub robot: [f64; 2],
    /// Distance of the target, as each pose has it, from its mean, RMS, m.
    pub scatter: f64,
    /// Reprojection error of a corner, RMS, px; `None` without images.
    pub rms_px: Option<f64>,
    /// Each pair that was used.
    pub pairs: Vec<PairFit>,
    /// The size of the target.
    pub scale: Option<Scale>,
    /// What explains the misses, if anything does better than chance.
    pub cause: Option<Cause>,
    /// Which way poses miss.
    pub spread: Spread,
}

/// How well a pair fits.
#[derive(Clone, Debug)]
pub struct PairFit {
    /// The image's name.
    pub name: String,
    /// Reprojection error of a corner, RMS, px; `None` without images.
    pub rms_px: Option<f64>,
    /// By how much the robot's pose would have to be moved and turned, m and rad.
    pub miss: [f64; 2],
}

/// There is no result.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum HandEyeError {
    /// Too few pairs.
    #[error(
        "{found} poses at which the board was seen; {FEWEST} at least, {ENOUGH} for a good result"
    )]
    #[allow(missing_docs)]
    TooFew { found: usize },
    /// The motions say too little.
    #[error(
        "the arm turned about {found} axes only, {AXES} are needed; take poses in which the flange is turned by {ROTATION_DEG} deg or more about its x axis, its y axis and its z axis"
    )]
    #[allow(missing_docs)]
    Axes { found: usize },
    /// Robot and camera saw different motions.
    #[error(transparent)]
    Motion(#[from] MotionError),
    /// Least squares on poses found no mounting.
    #[error("the poses do not determine a mounting; is each pose that of its image?")]
    Unsolved,
    /// The library found none.
    #[error("no mounting explains these pairs: {0}")]
    Corners(String),
}

/// Finds the mounting from views of the target.
///
/// # Errors
/// [`HandEyeError`] says what is wrong with the pairs.
pub fn calibrate(
    pairs: &[Pair],
    mounting: Mounting,
    camera: &Camera,
    target: &Target,
) -> Result<HandEye, HandEyeError> {
    let unsolved = |error: &dyn fmt::Display| HandEyeError::Corners(error.to_string());
    let mut pairs = pairs.to_vec();
    for pair in &mut pairs {
        pair.view.keep_known(target);
    }
    let views: Vec<View> = pairs.iter().map(|pair| pair.view.clone()).collect();
    let seen = pose::poses(camera, &views, target).map_err(|error| unsolved(&error))?;
    let known = pairs.into_iter().zip(seen);
    let (pairs, seen): (Vec<_>, Vec<_>) =
        known.filter_map(|(pair, seen)| Some((pair, seen?))).unzip();
    let poses = Poses {
        names: pairs.iter().map(|pair| pair.view.name.clone()).collect(),
        robots: pairs
            .iter()
            .map(|pair| mounting.robot(&pair.flange))
            .collect(),
        seen,
    };
    let start = solve(&poses, mounting)?;
    corners::refine(start, &pairs, camera, target, &poses).map_err(|error| unsolved(&error))
}

/// Finds the mounting from poses of the target; those without one are left out.
///
/// # Errors
/// As [`calibrate`].
pub fn calibrate_poses(poses: &[RobotPose], mounting: Mounting) -> Result<HandEye, HandEyeError> {
    let known = || poses.iter().filter_map(|pose| Some((pose, pose.board?)));
    let poses = Poses {
        names: known().map(|(pose, _)| pose.image.clone()).collect(),
        robots: known()
            .map(|(pose, _)| mounting.robot(&pose.flange))
            .collect(),
        seen: known().map(|(_, board)| board).collect(),
    };
    solve(&poses, mounting)
}

fn solve(poses: &Poses, mounting: Mounting) -> Result<HandEye, HandEyeError> {
    let fit = poses.fit()?;
    let miss = |(name, miss): (&String, &Option<[Vec3; 2]>)| PairFit {
        name: name.clone(),
        rms_px: None,
        miss: miss.map_or([0.0; 2], |miss| miss.map(|part| part.norm())),
    };
    Ok(HandEye {
        mounting,
        camera: fit.state.mount,
        target: fit.state.target,
        sigma: Ok(std::array::from_fn(|k| fit.covariance[(k, k)].sqrt())),
        robot: fit.sigma,
        scatter: poses.scatter(&fit.state.mount),
        rms_px: None,
        pairs: poses.names.iter().zip(&fit.misses).map(miss).collect(),
        scale: cause::scale(poses, &fit),
        cause: cause::find(poses, &fit),
        spread: cause::spread(poses, &fit),
    })
}
