//! Finds AprilTags in a camera's images and publishes them as features.
//!
//! Image coordinates: px, u to the right, v down; the centre of the upper left pixel is (0, 0).
#![deny(unsafe_code)]

mod blur;
pub mod config;
#[cfg(test)]
mod drawn;
pub mod finder;
pub mod grey;
pub mod lens;
pub mod metrics;
pub mod plane;
pub mod priority;
mod registration;
pub mod run;
pub mod source;
pub mod tags;
mod template;
pub mod tracker;
