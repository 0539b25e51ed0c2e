//! Failures with their exit codes.

use std::fmt::Display;
use std::io;
use std::path::Path;

use ipc::JoinReason;
use program::Exit;
use recorder::{PlotError, RecordError};
use recording::{ReadError, WriteError};
use scene::FileError;

/// Why a command could not do what was asked: one line for standard error, and the exit code.
#[derive(Debug, thiserror::Error)]
#[error("{message}")]
pub struct Failure {
    /// The exit code.
    pub exit: Exit,
    message: String,
}

impl Failure {
    /// A failure with this message.
    pub fn new(exit: Exit, message: impl Display) -> Self {
        Self {
            exit,
            message: message.to_string(),
        }
    }

    /// The file or directory cannot be written.
    pub fn write(path: &Path) -> impl FnOnce(io::Error) -> Self {
        move |source| {
            let message = format!("{}: cannot write: {source}", path.display());
            Self::new(Exit::Software, message)
        }
    }
}

/// Lists errors of libraries with the exit codes that they lead to.
macro_rules! exits {
    ($($error:ty => $exit:expr,)+) => {$(
        impl From<$error> for Failure {
            fn from(error: $error) -> Self {
                let exit: fn(&$error) -> Exit = $exit;
                Self::new(exit(&error), error)
            }
        }
    )+};
}

exits! {
    ipc::JoinError => |error| match error.reason {
        JoinReason::NotOurs { owner, us } if owner != us => Exit::NoPermission,
        _ => Exit::Unavailable,
    },
    ipc::OpenError => |_| Exit::Unavailable,
    ipc::PublishError => |_| Exit::Unavailable,
    ipc::AskError => |_| Exit::Unavailable,
    ipc::ReceiveError => |_| Exit::Unavailable,
    io::Error => |_| Exit::Software,
    serde_json::Error => |_| Exit::Software,
    FileError => |error| match error {
        FileError::Read { .. } | FileError::Named { .. } => Exit::NoInput,
        _ => Exit::Data,
    },
    RecordError => |error| match error {
        RecordError::Write(WriteError::Exists { .. }) => Exit::Usage,
        RecordError::Write(_) | RecordError::Thread(_) | RecordError::Panicked => Exit::Software,
        _ => Exit::Unavailable,
    },
    ReadError => |error| match error {
        ReadError::Read { .. } => Exit::NoInput,
        _ => Exit::Data,
    },
    PlotError => |error| match error {
        PlotError::Scene(_) | PlotError::NoScene | PlotError::Empty => Exit::Data,
        _ => Exit::Software,
    },
}
