//! `vpcd`, the daemon: configuration, the real-time loop, telemetry, shutdown. The control law is
//! the crate `vpc`; what travels through shared memory is the crate `ipc` (tour and decisions:
//! `README.md`).
//!
//! A cycle receives, checks order and age, runs the law, asks the supervisor what may go out, and
//! sends: [`input`] -> [`gate`] -> [`law`] -> [`supervisor`] -> [`cycle`]. The three in
//! the middle make [`control`], a pure function of inputs and state that [`mod@replay`] repeats.
#![deny(unsafe_code)]

pub mod arguments;
pub mod clock;
pub mod config;
pub mod contract;
pub mod control;
pub mod cycle;
pub mod daemon;
pub mod decision;
pub mod exit;
pub mod flight;
pub mod gate;
pub mod histogram;
pub mod input;
pub mod instance;
pub mod law;
pub mod loaded;
pub mod log;
pub mod lossy;
pub mod pll;
pub mod preflight;
pub mod realtime;
pub mod replay;
pub mod report;
pub mod robot;
pub mod scene_files;
pub mod service;
pub mod shutdown;
pub mod snapshot;
pub mod stack;
pub mod summary;
pub mod supervisor;
pub mod telemetry;
pub mod usage;
