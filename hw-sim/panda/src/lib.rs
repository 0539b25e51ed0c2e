#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]
#![deny(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
#![cfg_attr(test, allow(clippy::unwrap_used, clippy::expect_used, clippy::panic))]

pub mod brake;
pub mod errors;
pub mod generator;
pub mod ik;
pub mod interface;
pub mod kinematics;
pub mod limits;
pub mod mode;
pub mod placement;
pub mod robot;
pub mod servo;
pub mod settings;
pub mod state;

pub use errors::{Errors, Flag};
pub use interface::{Command, Motion, MotionKind};
pub use kinematics::{Chain, JOINTS, Jacobian, Joints, Pose, READY, Twist};
pub use limits::{Described, Limits, Model};
pub use mode::{Mode, RequestError};
pub use placement::{DriveError, PlacementError, drive, place};
pub use robot::Robot;
pub use settings::{RobotError, RobotSettings, Walls};
pub use state::State;
