//! Recordings of a domain: the messages of its services as an [MCAP](https://mcap.dev) file that
//! Foxglove, the `mcap` tools and Python open without this project's code. Topics and decisions:
//! `README.md`.
//!
//! Without features, for programs that keep records of their own:
//!
//! - [`RecordingFile`] writes messages, attachments and metadata,
//! - [`Recording::read`] reads them back, bit for bit, also from a file whose writer was killed.
//!
//! With the feature `views`, for tools:
//!
//! - `record` subscribes to a domain and writes what is published and what Foxglove draws,
//! - `plot` draws figures of a recording, `Report` says how long its cycles took.
#![forbid(unsafe_code)]

mod clock;
#[cfg(feature = "views")]
mod context;
mod field;
#[cfg(feature = "views")]
mod ledger;
mod message;
#[cfg(feature = "views")]
mod plot;
mod reader;
#[cfg(feature = "views")]
mod record;
#[cfg(feature = "views")]
mod recorder;
#[cfg(feature = "views")]
mod report;
#[cfg(feature = "views")]
mod views;
mod writer;

pub use clock::WallClock;
#[cfg(feature = "views")]
pub use context::{Context, ContextError, TextFile};
pub use field::FieldError;
#[cfg(feature = "views")]
pub use ledger::{Account, Ledger, Notice};
pub use message::Recorded;
#[cfg(feature = "views")]
pub use plot::{PlotError, plot};
pub use reader::{ReadError, Recording};
#[cfg(feature = "views")]
pub use record::{Options, RecordError, record};
#[cfg(feature = "views")]
pub use recorder::Recorder;
#[cfg(feature = "views")]
pub use report::{Report, StageTimes};
#[cfg(feature = "views")]
pub use views::{Viewed, goal};
pub use writer::{RecordingFile, WriteError};

/// Name of the attached configuration of `vpcd`.
pub const CONFIG_FILE: &str = "vpcd.toml";
/// Name of the attached scene; masks are attached under the names that the scene gives them.
pub const SCENE_FILE: &str = "scene.toml";
