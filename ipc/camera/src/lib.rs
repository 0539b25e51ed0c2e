//! Finds AprilTags in a camera's images and publishes them as features.
//!
//! Image coordinates: px, u to the right, v down; the centre of the upper left pixel is (0, 0).
#![deny(unsafe_code)]

mod blur;
pub mod config;
pub mod grey;
mod registration;
pub mod report;
pub mod run;
pub mod source;
pub mod tags;
mod template;
pub mod tracker;
