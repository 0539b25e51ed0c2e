//! A memory of motion: its file, its checks, and its queries.
//!
//! The core (`no_std`, no heap) is what the control cycle touches: [`Memory`], a borrowed view with
//! [`Samples`] (k-nearest neighbours) and [`Gpr`] (Gaussian-process regression). With the feature
//! `file` (default) come [`Contents`] (what a writer fills in) and [`MemoryFile`] (what a reader
//! opens, verified, sealed and mapped). The format is described in `FORMAT.md`; decisions, promises
//! and times are in the crate's `README.md`.
#![cfg_attr(not(feature = "file"), no_std)]
#![cfg_attr(not(feature = "file"), forbid(unsafe_code))]
#![deny(unsafe_code)]

mod exp;
mod gpr;
mod query;
mod samples;
mod scaling;
mod view;

#[cfg(feature = "file")]
mod contents;
#[cfg(feature = "file")]
mod draft;
#[cfg(feature = "file")]
mod file;
#[cfg(feature = "file")]
mod format;
#[cfg(feature = "file")]
mod header;
#[cfg(feature = "file")]
mod layout;
#[cfg(feature = "file")]
mod numbers;
#[cfg(feature = "file")]
mod order;
#[cfg(feature = "file")]
mod probe;
#[cfg(feature = "file")]
mod report;
#[cfg(feature = "file")]
mod sealed;
#[cfg(feature = "file")]
mod tensors;
#[cfg(feature = "file")]
mod unpack;
#[cfg(feature = "file")]
mod write;

pub use gpr::Gpr;
pub use query::QueryError;
pub use samples::{BLOCK, BLOCKS_PER_GROUP, Nearest, Samples};
pub use scaling::Scaling;
pub use view::Memory;

#[cfg(feature = "file")]
pub use contents::{Contents, Regression, WriteError};
#[cfg(feature = "file")]
pub use draft::Draft;
#[cfg(feature = "file")]
pub use file::{MemoryFile, OpenError};
#[cfg(feature = "file")]
pub use format::hex;
#[cfg(feature = "file")]
pub use report::Report;

/// Most entries of an input x = (s, area, angle): eight points.
pub const MAX_INPUTS: usize = 18;
/// Most entries of an output y = (v, way point): eight points.
pub const MAX_OUTPUTS: usize = 22;
/// Most samples in a file.
pub const MAX_SAMPLES: usize = 10_000_000;
/// Most neighbours that a query averages.
pub const MAX_NEIGHBOURS: usize = 64;
