//! Why a message is not taken.

use std::collections::BTreeMap;

use crate::camera_info::Misfit;
use crate::stamp::StampError;

/// Why a message is not taken.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[allow(missing_docs)]
pub enum Refusal {
    #[error(transparent)]
    Stamp(#[from] StampError),
    #[error("frame_id = {found:?}; allowed: {allowed}")]
    Frame { found: String, allowed: String },
    #[error("tag {0} is there twice")]
    TwiceTag(i32),
    #[error("tag {0} was not seen since the start, and the law needs all points")]
    NeverSeen(u32),
    #[error("{found} points; allowed: {allowed}, the points of the scene's pattern")]
    Points { found: usize, allowed: usize },
    #[error("{0} is not finite")]
    NotFinite(&'static str),
    #[error("z = {0} of a point; allowed: 0, as x and y are px")]
    Depth(f32),
    #[error("no CameraInfo has come yet on {0}")]
    NoInfo(String),
    #[error("the camera is not the scene's: {0}")]
    Camera(#[from] Misfit),
    #[error("joint {0:?} is not in it")]
    Joint(String),
    #[error("joint {0:?} is there twice")]
    TwiceJoint(String),
    #[error(
        "{names} names, {positions} positions, {velocities} velocities; allowed: as many of each"
    )]
    Lengths {
        names: usize,
        positions: usize,
        velocities: usize,
    },
    #[error("no fresh JointState on {0}, whose joints are configured (robot.joints)")]
    NoJoints(String),
    #[error("no fresh pose of the tool on {0}, which this frame needs")]
    NoPose(String),
    #[error("it cannot be read: {0}")]
    Unreadable(String),
}

impl Refusal {
    /// A name for the counter.
    pub fn kind(&self) -> &'static str {
        match self {
            Self::Stamp(error) => error.kind(),
            Self::Frame { .. } => "other frame_id",
            Self::TwiceTag(_) | Self::TwiceJoint(_) => "name twice",
            Self::NeverSeen(_) => "incomplete",
            Self::Points { .. } | Self::Lengths { .. } => "wrong length",
            Self::NotFinite(_) | Self::Depth(_) => "bad number",
            Self::NoInfo(_) => "no CameraInfo",
            Self::Camera(_) => "other camera",
            Self::Joint(_) | Self::NoJoints(_) => "joints missing",
            Self::NoPose(_) => "pose missing",
            Self::Unreadable(_) => "unreadable",
        }
    }
}

/// Refuses what is not finite.
pub(crate) fn finite<'a>(
    name: &'static str,
    numbers: impl IntoIterator<Item = &'a f64>,
) -> Result<(), Refusal> {
    match numbers.into_iter().all(|x| x.is_finite()) {
        true => Ok(()),
        false => Err(Refusal::NotFinite(name)),
    }
}

/// Refuses a frame that is not that of the configuration.
pub(crate) fn check_frame(found: &str, allowed: &str) -> Result<(), Refusal> {
    match found == allowed {
        true => Ok(()),
        false => Err(Refusal::Frame {
            found: found.to_owned(),
            allowed: allowed.to_owned(),
        }),
    }
}

/// What came on a topic.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Counts {
    /// Messages that were taken.
    pub taken: u64,
    /// Messages that are of no concern.
    pub passed_over: u64,
    /// Messages that were refused, by kind.
    pub refused: BTreeMap<&'static str, u64>,
    /// When the last one was taken, CLOCK_MONOTONIC, ns; 0: none was.
    pub last_ns: u64,
    /// Its age when it came, ns.
    pub age_ns: u64,
}
