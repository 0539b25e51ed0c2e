//! The calibrations against known truth.

mod boards;
mod drawn;
mod hand_eye;
mod intrinsics;
mod latency;
mod program;
mod rendered;
mod sheet;
mod station;
mod synthetic;
