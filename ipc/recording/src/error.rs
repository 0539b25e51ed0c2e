//! Why a recording was not written.

use mcap::McapError;

/// Why a recording was not written.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs)]
pub enum WriteError {
    #[error("{path}: exists; allowed: a new file, or --force")]
    Exists { path: String },
    #[error("{path}: cannot create the recording: {source}")]
    Create {
        path: String,
        source: std::io::Error,
    },
    #[error("{path}: cannot write the recording: {source}")]
    Write { path: String, source: McapError },
}
