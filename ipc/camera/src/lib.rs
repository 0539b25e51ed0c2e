//! Finds AprilTags in a camera's images and publishes them as features.
//!
//! Image coordinates: px, u to the right, v down; the centre of the upper left pixel is (0, 0).
#![deny(unsafe_code)]

pub mod grey;
pub mod lens;
