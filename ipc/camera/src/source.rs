//! Where images come from.

mod shm;

pub use shm::SharedMemory;

use std::io;

use crate::grey::Grey;

/// An image in its source's memory, with its times on CLOCK_MONOTONIC.
#[derive(Clone, Copy, Debug)]
pub struct Frame<'a> {
    /// Number of the frame, from 1; lost frames leave gaps.
    pub sequence: u64,
    /// Middle of the exposure, ns; 0 if unknown.
    pub data_ns: u64,
    /// Length of the exposure, ns; 0 if unknown.
    pub exposure_ns: u64,
    /// When the image was sent, ns; `None` where it comes from a device or a file.
    pub published_ns: Option<u64>,
    /// The image.
    pub image: Grey<'a>,
}

/// What a source has.
#[derive(Clone, Copy, Debug)]
pub enum Next<'a> {
    /// A new image.
    Frame(Frame<'a>),
    /// None yet.
    Nothing,
    /// There will be none any more.
    End,
}

/// A camera, or what stands for one.
pub trait Source {
    /// Waits for the next frame, some 20 ms at most.
    ///
    /// # Errors
    /// [`SourceError`]: there will be no more frames.
    fn next(&mut self) -> Result<Next<'_>, SourceError>;
}

/// A source cannot be opened, or gives no more frames.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs)]
pub enum SourceError {
    /// The operating system refused; in words.
    #[error("{what}: {why}")]
    System { what: String, why: io::Error },
    /// A device, a file or its content is not what is taken.
    #[error("{what}: {found}; allowed: {allowed}")]
    Value {
        what: String,
        found: String,
        allowed: String,
    },
    /// The service of images cannot be opened.
    #[error(transparent)]
    Open(#[from] ipc::OpenError),
    /// The service of images gives none.
    #[error(transparent)]
    Receive(#[from] ipc::ReceiveError),
}
