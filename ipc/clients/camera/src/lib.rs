//! Finds AprilTags in a camera's images and publishes them as features.
//!
//! Image coordinates: px, u to the right, v down; the centre of the upper left pixel is (0, 0).
#![deny(unsafe_code)]

#[cfg(feature = "detector")]
mod blur;
pub mod config;
pub mod distance;
#[cfg(all(test, feature = "detector"))]
mod drawn;
#[cfg(feature = "detector")]
pub mod finder;
pub mod grey;
pub mod lens;
pub mod mask;
pub mod mask_check;
#[cfg(feature = "detector")]
pub mod metrics;
#[cfg(feature = "detector")]
pub mod pattern;
#[cfg(feature = "detector")]
pub mod plane;
#[cfg(feature = "detector")]
mod registration;
#[cfg(feature = "detector")]
pub mod run;
#[cfg(feature = "detector")]
pub mod sheet;
pub mod source;
#[cfg(feature = "detector")]
pub mod tags;
#[cfg(feature = "detector")]
mod template;
#[cfg(feature = "detector")]
pub mod tracker;
