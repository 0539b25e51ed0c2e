//! A gateway between ROS 2 and the shared memory of vpcd: a node that links no ROS.
//!
//! Image coordinates: px, u to the right, v down; the centre of the upper left pixel is (0, 0).
#![forbid(unsafe_code)]

pub mod config;
mod keys;

#[cfg(feature = "dds")]
pub mod agreement;
#[cfg(feature = "dds")]
pub mod arm;
#[cfg(feature = "dds")]
pub mod bridge;
#[cfg(feature = "dds")]
pub mod camera_info;
#[cfg(feature = "dds")]
pub mod diagnostics;
#[cfg(feature = "dds")]
pub mod event;
#[cfg(feature = "dds")]
pub mod eye;
#[cfg(feature = "dds")]
pub mod frames;
#[cfg(feature = "dds")]
pub mod guard;
#[cfg(feature = "dds")]
mod inbox;
#[cfg(feature = "dds")]
pub mod message;
#[cfg(feature = "dds")]
pub mod outlet;
#[cfg(feature = "dds")]
pub mod overlay;
#[cfg(feature = "dds")]
pub mod policy;
#[cfg(feature = "dds")]
pub mod refusal;
#[cfg(feature = "dds")]
pub mod ros;
#[cfg(feature = "dds")]
pub mod services;
#[cfg(feature = "dds")]
pub mod stamp;
#[cfg(feature = "dds")]
mod wire;
