//! Recordings of a domain: the messages of its services as an [MCAP](https://mcap.dev) file that
//! Foxglove, the `mcap` tools and Python open without this project's code. Topics and decisions:
//! `README.md`.
//!
//! - [`RecordingFile`] writes messages, attachments and metadata,
//! - [`Recording::read`] reads them back, bit for bit, also from a file whose writer was killed.
//!
//! `vpcd` writes flight records with it. The crate `recorder` records a domain, adds what Foxglove
//! draws, and draws figures.
#![forbid(unsafe_code)]

mod clock;
mod error;
mod field;
mod message;
mod reader;
mod sink;
mod writer;

pub use clock::WallClock;
pub use error::{FieldError, ReadError, WriteError};
pub use message::{Encoding, Recorded};
pub use reader::Recording;
pub use sink::Sink;
pub use writer::{CONFIG_FILE, RecordingFile, SCENE_FILE};
