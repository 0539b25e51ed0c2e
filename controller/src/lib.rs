//! `vpcd`, the daemon: configuration, the real-time loop, telemetry, shutdown. The control law is
//! the crate `vpc`; what travels through shared memory is the crate `messages`, and its
//! transport the crate `ipc` (tour and decisions: `README.md`).
//!
//! A cycle receives, checks order and age, runs the law, asks the supervisor what may go out, and
//! sends. The crate [`decision`] decides; [`cycle`] receives before and sends after it, and
//! [`mod@replay`] repeats its decisions.
//!
//! # The workspace
//! This is the first page of the documentation of all crates: `cargo doc --workspace --no-deps`,
//! then `target/doc/controller/index.html`.
//!
//! | crate | what it is |
//! |---|---|
//! | [`vpc`] | the control law: `no_std`, no heap, no unsafe code |
//! | [`memory_blob`], [`memory_builder`](../memory_builder/index.html) | the memory of motion: its file and queries; `vpc-memory`, which builds it |
//! | [`messages`], [`ipc`] | the shared-memory contract: messages; domain and ports |
//! | [`scene`], [`mask`](../mask/index.html), [`toml_schema`] | the scene file; painted occlusions; configuration files with a JSON Schema |
//! | [`recording`], [`recorder`](../recorder/index.html) | recordings (MCAP); recording a domain for Foxglove |
//! | [`vpcctl`](../vpcctl/index.html), [`figures`](../figures/index.html) | status, live views, requests; pictures |
//! | [`hw_sim`](../hw_sim/index.html), [`panda`](../panda/index.html), [`vision`](../vision/index.html) | the emulator and its referee; the robot at 1 kHz; rendered images |
//! | [`system_tests`](../system_tests/index.html), [`testkit`](../testkit/index.html) | `demo`, `table` and the promises; what tests share |
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
pub mod panicked;
pub mod pll;
pub mod preflight;
pub mod published;
pub mod realtime;
pub mod replay;
pub mod report;
pub mod service;
pub mod shutdown;
pub mod stack;
pub mod summary;
pub mod telemetry;
pub mod usage;
