#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]
#![deny(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
#![cfg_attr(test, allow(clippy::unwrap_used, clippy::expect_used, clippy::panic))]

pub mod kinematics;
pub mod mount;

pub use kinematics::{Chain, JOINTS, Jacobian, Joints, Pose, READY, Twist};
pub use mount::Mount;
