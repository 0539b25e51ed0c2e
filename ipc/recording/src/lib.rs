//! Recordings of a domain: what its services carried, as an [MCAP](https://mcap.dev) file that Foxglove, the `mcap`
//! tools and Python open without this project's code (tour, topics and decisions: `README.md`).
//!
//! - [`record`] subscribes to a domain and writes ([`RecordingFile`] writes without a domain),
//! - [`Recording::read`] reads a file back, bit for bit, also one whose recorder was killed,
//! - [`plot()`] draws it, [`Report`] tells how long its cycles took,
//! - `replay` (a feature) runs the law on it again.
#![forbid(unsafe_code)]

mod clock;
mod context;
mod field;
mod file;
mod foxglove;
mod geometry;
mod ledger;
mod message;
#[cfg(feature = "replay")]
mod outcome;
mod outline;
mod plot;
mod reader;
mod recorder;
#[cfg(feature = "replay")]
pub mod replay;
mod report;

pub use clock::WallClock;
pub use context::{Context, ContextError, MaskFile, Text};
pub use field::FieldError;
pub use file::{CONFIG_FILE, RecordingFile, SCENE, SCENE_FILE, WriteError};
pub use geometry::goal;
pub use ledger::{Account, Ledger, Notice};
pub use message::Recorded;
pub use plot::{PlotError, plot};
pub use reader::{ReadError, Recording};
pub use recorder::{Options, RecordError, record};
pub use report::{Phase, Report};
