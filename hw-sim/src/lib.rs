//! Emulates what stands behind the shared memory: a camera, what carries it, and a referee.
//!
//! Written from poses and projection, without the mathematics of the control law (it must not
//! depend on `vpc`), so that one mistake cannot hide on both sides. Nor do robot, camera and
//! referee use `arm`, the model that bridges have of a robot: [`robot::bridge`] alone does, which
//! stands for the user's bridge (`tests/truth.rs` keeps this). [`emulator`] is the loop of the
//! process. It steps a [`cell::Cell`]: the [`free::FreeCell`], which moves as told, or the
//! [`rig::Rig`], a Panda. Cells know neither clocks nor ports; the table of results steps them,
//! too.
//!
//! - [`emulator`]: the loop: run after run, expose, publish, obey, record
//! - [`cell`]: camera, carrier and referee in simulated time: [`free`], a free-flying camera;
//!   [`rig`], a robot with camera and task
//! - [`robot`]: [`robot::arm`], [`robot::described`] (by a file) and [`robot::bridge`] (30 Hz to
//!   1 kHz), [`robot::sequence`] (the task), [`robot::inspector`] (the arm's referee)
//! - [`camera`], [`mod@pose`]: projection; exact rigid motion under a constant twist; [`motion`], of
//!   the pattern
//! - [`eye`]: the camera in the robot's hand: features or rendered images, late and lossy
//! - [`referee`]: arrival and violations, from the true poses; [`occlusion`], [`painted`]: distances
//! - `examples/own_robot/`: the smallest bridge to a robot of your own
#![forbid(unsafe_code)]

pub mod camera;
pub mod cell;
pub mod config;
pub mod cost;
pub mod emulator;
pub mod eye;
pub mod following;
pub mod free;
pub mod late_frames;
pub mod lateness;
pub mod motion;
pub mod occlusion;
pub mod outcome;
pub mod painted;
mod picture;
mod port;
pub mod pose;
pub mod progress;
pub mod recording;
pub mod referee;
pub mod rig;
pub mod robot;
pub mod sensor;
mod stamps;
pub mod standing;

pub use camera::{FreeCamera, Hidden, Points};
pub use referee::{End, Referee};
