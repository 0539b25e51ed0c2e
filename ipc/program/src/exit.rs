//! Exit codes.

use std::fmt::Display;
use std::process::ExitCode;

use toml_schema::FileError;

/// How a program ends. Small numbers are answers; those from 64 on are those of `sysexits.h`, so
/// that a service manager can tell what failed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Exit {
    /// Done, or stopped by a signal. `vpcctl status`: moving or arrived.
    Ok = 0,
    /// Done, and something needs attention: a finding, a machine that is unfit for real time, a
    /// replay that differs. `vpcctl status`: stopped, holding or braking.
    Attention = 1,
    /// `vpcctl`: the daemon refused the request. `vpcctl init`: a file exists already.
    Refused = 2,
    /// `vpcctl`: no daemon runs in the domain.
    NoDaemon = 3,
    /// `vpcctl`: a daemon runs and does not answer, or its cycles have stopped.
    NoAnswer = 4,
    /// `vpcctl status`: disarmed.
    Disarmed = 5,
    /// The command line is wrong.
    Usage = 64,
    /// A file has wrong contents, or a memory was built for another task.
    Data = 65,
    /// A file is missing or cannot be read.
    NoInput = 66,
    /// Something outside cannot be used: a camera, a robot, the shared memory, an address.
    Unavailable = 69,
    /// A defect of the program.
    Software = 70,
    /// A file cannot be written.
    CannotCreate = 73,
    /// `vpcctl`: the domain is another user's.
    NoPermission = 77,
    /// The configuration is wrong.
    Config = 78,
}

impl Exit {
    /// Prints `error` to standard error under the program's name, and returns the exit code.
    pub fn say(self, name: &str, error: impl Display) -> ExitCode {
        eprintln!("{name}: {error}");
        self.into()
    }
}

impl From<Exit> for ExitCode {
    fn from(exit: Exit) -> Self {
        Self::from(exit as u8)
    }
}

impl From<&FileError> for Exit {
    /// For the configuration of a program.
    fn from(error: &FileError) -> Self {
        match error {
            FileError::Read { .. } | FileError::Named { .. } => Self::NoInput,
            _ => Self::Config,
        }
    }
}
