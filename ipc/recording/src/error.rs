//! Errors.

use std::io;

use mcap::McapError;

/// Why a recording was not written.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs)]
pub enum WriteError {
    #[error("{path}: exists; allowed: a new file, or --force")]
    Exists { path: String },
    #[error("{path}: cannot create the recording: {source}")]
    Create { path: String, source: io::Error },
    #[error("{path}: cannot write the recording: {source}")]
    Write { path: String, source: McapError },
}

/// Why a recording could not be read.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs)]
pub enum ReadError {
    #[error("{path}: cannot read the recording: {source}")]
    Read { path: String, source: io::Error },
    #[error("{path}: not a recording: {source}")]
    Format { path: String, source: McapError },
    #[error("{path}: {length} bytes become more than {most} bytes of records; allowed: up to that")]
    Bomb {
        path: String,
        length: u64,
        most: usize,
    },
    /// A message that is not what its topic says.
    #[error("{path}: message {sequence} of {topic}: {reason}")]
    Message {
        path: String,
        topic: String,
        sequence: u32,
        reason: String,
    },
}

/// Why a message could not be read.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{field} = {found}; allowed: {allowed}")]
pub struct FieldError {
    /// Name of the field, with the index in an array.
    pub field: String,
    /// What was found.
    pub found: String,
    /// What is allowed.
    pub allowed: String,
}
