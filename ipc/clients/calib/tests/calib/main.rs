//! The calibrations against known truth.

mod boards;
mod emulator;
mod hand_eye;
mod intrinsics;
mod latency;
mod opencv;
mod program;
mod real;
mod rendered;
mod sheet;
mod synthetic;
