//! The calibrations against known truth.

mod hand_eye;
mod intrinsics;
mod latency;
mod synthetic;
