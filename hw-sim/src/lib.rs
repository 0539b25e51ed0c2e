//! Emulates what stands behind the shared memory: a camera, what carries it, and a referee.
//!
//! Written from poses and projection, without the control law's mathematics (it must not depend on `vpc`), so that one
//! mistake cannot hide on both sides. The pure parts, which the table uses in process: [`pose`] (exact rigid motion),
//! [`FreeCamera`] (projection), [`occlusion`] (Euclidean distances), [`Referee`]. The process around them: [`config`],
//! [`carrier`] (what executes a twist; a robot slots in here), [`sensor`] (noise, delay, dropped frames),
//! [`recording`], and [`emulator`], the loop. Decisions that surprise stand in the crate's `README.md`.
#![deny(unsafe_code)] // but for the one call of `priority`

pub mod camera;
pub mod carrier;
pub mod config;
pub mod emulator;
pub mod eye;
pub mod lateness;
pub mod occlusion;
pub mod pose;
pub mod priority;
pub mod recording;
pub mod referee;
pub mod robot;
pub mod sensor;

pub use camera::{FreeCamera, Hidden, Points};
pub use referee::{Place, Referee, Verdict};
