//! `vpcd`, the daemon: configuration, clock, the real-time cycle, telemetry, shutdown. The law itself is the crate
//! `vpc`; what travels through shared memory is the crate `ipc` (tour and decisions: `README.md`).
//!
//! A cycle is *Wake -> Receive -> Step -> Send -> Slack*; its modules in that order:
//! [`clock`] (when), [`pilot`] (the decision, a pure function: [`gate`], whether the features can be trusted, [`law`],
//! what to command, [`supervisor`], whether it may go out), [`cycle`] (the loop itself), [`telemetry`] (what an ordinary
//! thread makes of the records).
#![deny(unsafe_code)]

pub mod arguments;
pub mod clock;
pub mod config;
pub mod cycle;
pub mod daemon;
pub mod exit;
pub mod flight;
pub mod gate;
pub mod histogram;
pub mod instance;
pub mod law;
pub mod log;
pub mod lossy;
pub mod phase;
pub mod pilot;
pub mod preflight;
pub mod realtime;
pub mod report;
pub mod robot;
pub mod service;
pub mod shutdown;
pub mod stack;
pub mod supervisor;
pub mod takeover;
pub mod telemetry;
pub mod usage;
