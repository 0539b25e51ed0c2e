//! Finds AprilTags in a camera's images and publishes them as features.
//!
//! Image coordinates: px, u to the right, v down; the centre of the upper left pixel is (0, 0).
#![deny(unsafe_code)]

#[cfg(feature = "program")]
mod blur;
pub mod config;
#[cfg(all(test, feature = "program"))]
mod drawn;
#[cfg(feature = "program")]
pub mod finder;
#[cfg(feature = "program")]
pub mod grey;
pub mod lens;
#[cfg(feature = "program")]
pub mod metrics;
#[cfg(feature = "program")]
pub mod plane;
#[cfg(feature = "program")]
pub mod priority;
#[cfg(feature = "program")]
mod registration;
#[cfg(feature = "program")]
pub mod run;
#[cfg(feature = "program")]
pub mod source;
#[cfg(feature = "program")]
pub mod tags;
#[cfg(feature = "program")]
mod template;
#[cfg(feature = "program")]
pub mod tracker;
