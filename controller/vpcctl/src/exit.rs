//! Exit codes, and failures with their exit codes.

use std::fmt::Display;
use std::io;
use std::path::Path;

use recorder::live::LiveError;
use recorder::{PlotError, RecordError};
use recording::{ReadError, WriteError};
use scene::FileError;

/// How the command ends. Small numbers are answers; those from 64 on are those of `sysexits.h`, as
/// `vpcd` uses them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Exit {
    /// `status`: moving or arrived. A request: done. `doctor`: no failure.
    Ok = 0,
    /// `status`: stopped, holding or braking. `doctor`, `check-bridge`: at least one failure.
    Attention = 1,
    /// The daemon refused the request. `init`: a file is there already.
    Refused = 2,
    /// No daemon runs in the domain.
    NoDaemon = 3,
    /// A daemon runs and does not answer, or its cycles have stopped.
    NoAnswer = 4,
    /// `status`: disarmed.
    Disarmed = 5,
    /// The command line is wrong.
    Usage = 64,
    /// A file has wrong contents.
    Data = 65,
    /// A file is missing or cannot be read.
    NoInput = 66,
    /// The shared memory, a port or an address cannot be used.
    Unavailable = 69,
    /// vpcctl itself failed, or could not write.
    Software = 70,
}

impl From<Exit> for std::process::ExitCode {
    fn from(exit: Exit) -> Self {
        Self::from(exit as u8)
    }
}

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

    /// No daemon runs in the domain of this directory.
    pub fn no_daemon(directory: &Path) -> Self {
        let domain = directory.display();
        let message = format!(
            "domain {domain}: no vpcd is at work; start it (vpcd --domain {domain} ...), or name its domain with --domain"
        );
        Self::new(Exit::NoDaemon, message)
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
    ipc::JoinError => |_| Exit::Unavailable,
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
        RecordError::Join(_) | RecordError::Open(_) | RecordError::Receive(_) => Exit::Unavailable,
        RecordError::Write(WriteError::Exists { .. }) => Exit::Usage,
        _ => Exit::Software,
    },
    LiveError => |error| match error {
        LiveError::Write(_) | LiveError::Thread(_) => Exit::Software,
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
