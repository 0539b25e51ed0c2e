//! Builds a memory of motion off line: the paper's two algorithms, adaptive sampling, and
//! regression.
//!
//! [`build`] draws starts and collects the trajectories that [`trajectory`] finds step by step with
//! [`solution`]; starts that the controller leaves stuck go to [`planner`]. Or [`foresight`] runs
//! from them, and says which trajectories it needs. [`store`] keeps samples and way points,
//! [`subsample`] chooses those that [`regression`] is fitted to, and [`memory`] writes the file.
//! [`state`] keeps the [`progress`] of an unfinished build. Decisions, promises and times stand in
//! the crate's `README.md`.

pub mod build;
pub mod clearance;
pub mod foresight;
pub mod lbfgs;
pub mod memory;
pub mod mixture;
pub mod paint;
pub mod planner;
pub mod progress;
pub mod reach;
pub mod regression;
pub mod settings;
mod sight;
pub mod solution;
pub mod start;
pub mod state;
pub mod store;
pub mod subsample;
pub mod template;
pub mod trajectory;
