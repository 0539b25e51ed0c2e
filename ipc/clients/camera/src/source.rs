//! Where images come from.

mod replay;
mod shm;
mod v4l2;

pub use replay::Replay;
pub use shm::SharedMemory;
pub use v4l2::{Camera, Request, Shutter};

use std::io;
use std::sync::atomic::AtomicBool;

use crate::grey::Grey;

/// An image in its source's memory, with its times on CLOCK_MONOTONIC.
#[derive(Clone, Copy, Debug)]
pub struct Frame<'a> {
    /// Number of the frame, from 1; lost frames leave gaps.
    pub sequence: u64,
    /// Middle of the exposure, ns.
    pub data_ns: u64,
    /// Length of the exposure, ns; 0 if unknown.
    pub exposure_ns: u64,
    /// When a simulated camera sent the image, ns; `None` of a real one.
    pub published_ns: Option<u64>,
    /// The image.
    pub image: Grey<'a>,
}

/// What a source has.
#[derive(Debug)]
pub enum Next<'a> {
    /// A new frame.
    Frame(Frame<'a>),
    /// None yet.
    Nothing,
    /// There will be none any more, or a stop was asked for.
    End,
}

/// A camera, or what stands for one.
pub trait Source {
    /// Waits for the next frame, or for a while.
    ///
    /// # Errors
    /// [`SourceError`]: there will be no more frames.
    fn next(&mut self, stop: &AtomicBool) -> Result<Next<'_>, SourceError>;
}

/// The grey level of a colour: ITU-R BT.601, as OpenCV has it.
fn luma(red: u8, green: u8, blue: u8) -> u8 {
    let [red, green, blue] = [red, green, blue].map(u32::from);
    ((299 * red + 587 * green + 114 * blue + 500) / 1000) as u8
}

/// A source cannot be opened, or gives no more frames.
#[derive(Debug, thiserror::Error)]
pub enum SourceError {
    /// The operating system refused; in words.
    #[error("{what}: {why}")]
    #[allow(missing_docs)]
    System { what: String, why: io::Error },
    /// A device, a file or its content is not what is taken.
    #[error("{what}: {found}; allowed: {allowed}")]
    #[allow(missing_docs)]
    Value {
        what: String,
        found: String,
        allowed: String,
    },
    /// The shared memory.
    #[error(transparent)]
    Open(#[from] ipc::OpenError),
    /// The shared memory fails.
    #[error(transparent)]
    Receive(#[from] ipc::ReceiveError),
}

impl SourceError {
    fn value(what: impl ToString, found: impl ToString, allowed: impl ToString) -> Self {
        Self::Value {
            what: what.to_string(),
            found: found.to_string(),
            allowed: allowed.to_string(),
        }
    }

    fn system(what: impl ToString, why: impl Into<io::Error>) -> Self {
        Self::System {
            what: what.to_string(),
            why: why.into(),
        }
    }
}
