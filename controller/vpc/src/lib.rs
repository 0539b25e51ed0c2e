//! The control law of `vpcd`: visual predictive control with a memory of motion.
//!
//! `no_std`, no heap, no unsafe: a cycle that allocates does not compile. A cycle runs through the
//! modules in this order:
//!
//! *measured features* -> [`gate`] (refuse what cannot be trusted) -> [`delay`] (from their
//! exposure to now) -> [`recall`] (warm start and way point from the memory, when features come
//! near a constraint), [`foresight`] (what is tracked) -> [`solver`] (bounded sequential quadratic
//! programming over the [`prediction`]) -> [`limit`] (never more than allowed) -> *camera twist*.
//! [`Law::step`] follows it.
//!
//! # Symbols
//! | Paper | Here | Meaning, unit |
//! |---|---|---|
//! | s, s* | `points`, `goal` | stacked image points u1 v1 u2 v2 ..., px; pairs in `Points` |
//! | v, V | `twist`, `plan` | camera velocity in the camera frame, m/s and rad/s; Nc of them |
//! | N_p, N_c | `np`, `nc` | steps previewed, free commands |
//! | T_s | `ts` | sampling time, s |
//! | L | `interaction` | interaction matrix |
//! | Q = k_Q I, R | `k_q`, `r` | weights of image error and velocity |
//! | eps | `mismatch` | measured minus predicted features, px |
//! | a, alpha | [`features::area`], [`features::angle`] | of the pattern's polygon, px^2 and rad |
//!
//! ```
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! use vpc::{Law, Measurement, Settings};
//! let scene = scene::Scene::parse(scene::PAPER_SIM, "paper-sim.toml")?;
//! // The law needs no heap: an array that lives long enough will do as well.
//! let mut law = Law::new(&scene, Settings::default(), |len| vec![0.0; len])?;
//! let points = [[700.0, 500.0], [900.0, 500.0], [900.0, 700.0], [700.0, 700.0]];
//! let step = law.step(&Measurement::from_points(&points), None)?;
//! assert!(step.twist[0].abs() <= scene.limits.linear);
//! # Ok(())
//! # }
//! ```
#![cfg_attr(not(test), no_std)]
#![forbid(unsafe_code)]
#![deny(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::indexing_slicing
)]
#![cfg_attr(
    test,
    allow(
        clippy::unwrap_used,
        clippy::expect_used,
        clippy::panic,
        clippy::indexing_slicing
    )
)]

#[cfg(feature = "file")]
extern crate alloc;

pub mod arm;
mod blind;
pub mod camera;
pub mod clearance;
mod command;
pub mod constraint;
pub mod cost;
pub mod course;
mod crossing;
pub mod delay;
pub mod draft;
pub mod drift;
pub mod features;
pub mod field;
mod follow;
pub mod foresight;
mod frozen;
pub mod gate;
mod guess;
pub mod guide;
mod ibvs;
mod interaction;
pub(crate) mod intersample;
pub mod joint_path;
pub mod lag;
pub mod law;
pub mod limit;
pub mod measurement;
pub mod motion;
pub mod obstacle;
pub mod patience;
pub mod pose;
pub mod prediction;
pub mod problem;
#[doc(hidden)]
#[expect(clippy::len_without_is_empty, reason = "public for vpc-bench alone")]
pub mod qp;
mod random;
pub mod recall;
pub mod refine;
pub mod row;
pub mod settings;
mod size;
pub mod solver;
pub mod span;
mod sqp;
pub mod state;
pub mod strategy;
pub mod task;
pub mod view;
pub mod way;
pub mod work;
mod workspace;

pub use features::Points;
pub use law::{Law, Step};
pub use measurement::{Measurement, Refusal};
pub use prediction::Model;
pub use problem::{SolverOptions, Status};
pub use recall::{Asked, MotionMemory};
pub use settings::{Settings, SettingsError};
pub use state::State;
pub use strategy::Strategy;
pub use task::{Task, TaskError};

/// Most points of a pattern.
pub const MAX_POINTS: usize = scene::MAX_POINTS;
/// Longest preview window, steps.
pub const MAX_NP: usize = 40;
/// Most free commands of a preview window.
pub const MAX_NC: usize = 4;
/// Components of a twist.
pub const DOF: usize = 6;
/// Most variables of the optimal-control problem.
pub const MAX_VARIABLES: usize = DOF * MAX_NC;

/// A camera velocity (vx vy vz in m/s, wx wy wz in rad/s), expressed in the camera frame.
pub type Twist = [f64; DOF];
