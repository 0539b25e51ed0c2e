//! `vpcd`, the daemon: configuration, the real-time loop, telemetry, shutdown. The control law is
//! the crate `vpc`; what travels through shared memory is the crate `messages`, and its
//! transport the crate `ipc` (decisions: `README.md`).
//!
//! A cycle receives, checks order and age, runs the law, asks the supervisor what may go out, and
//! sends. The crate [`decision`] decides; [`cycle`] receives before and sends after it, and
//! [`mod@replay`] repeats its decisions.
//!
//! - [`daemon`]: from the command line to the exit code
//! - [`config`]: TOML and flags to a checked [`config::Config`]
//! - [`start`]: the files that it begins with, also after it was asked to begin again ([`reload`])
//! - [`cycle`]: the loop: wake, receive, decide, send, rehearse; [`clock`], [`pll`] set its releases
//! - [`world`]: the clocks, ports and files that the loop meets; [`machine`] is the real one
//! - [`decision`]: decide: gate, law, robot watch, supervisor; a crate of pure functions, which a
//!   replay repeats
//! - [`telemetry`]: the ordinary thread: publishes records, writes the log, feeds the watchdog
//! - [`flight`], [`mod@replay`]: the flight record and its replay (`FLIGHT.md`)
#![deny(unsafe_code)]

pub mod arguments;
pub mod clock;
pub mod config;
pub mod cycle;
pub mod daemon;
pub mod flight;
pub mod histogram;
pub mod instance;
pub mod loaded;
pub mod log;
pub mod lossy;
pub mod machine;
pub mod panicked;
pub mod pll;
pub mod preflight;
pub mod published;
pub mod realtime;
pub mod reload;
pub mod replay;
pub mod report;
pub mod service;
pub mod shutdown;
pub mod stack;
pub mod start;
pub mod summary;
pub mod telemetry;
pub mod usage;
pub mod world;
