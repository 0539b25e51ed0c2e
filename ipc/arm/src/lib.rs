#![doc = include_str!("../README.md")]
#![cfg_attr(not(test), no_std)]
#![forbid(unsafe_code)]
#![deny(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
#![cfg_attr(test, allow(clippy::unwrap_used, clippy::expect_used, clippy::panic))]

pub mod bridge;
pub mod capsule;
pub mod collision;
pub mod damper;
pub mod description;
pub mod elbow;
pub mod ik;
pub mod kinematics;
pub mod limits;
pub mod mount;
pub mod ramp;
pub mod reserve;
pub mod shaper;
pub mod singularity;
pub mod slack;

pub use bridge::{Bridge, Caps, Driver, Limited, Measured, Room};
pub use capsule::{Capsule, Cuboid};
pub use damper::{Bound, Cause, Dampers};
pub use description::{Arm, Other, Pair, Shapes, Wall};
pub use kinematics::{Chain, JOINTS, Jacobian, Joints, Pose, READY, Screw, Twist, joints};
pub use limits::{JointLimits, Limits, Model, PERIOD, Setpoint};
pub use mount::Mount;
pub use ramp::Ramp;
pub use reserve::Reserve;
pub use shaper::{Echo, Shaper, ShaperError, ShaperSettings};
pub use slack::Slack;
