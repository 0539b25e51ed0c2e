//! Exit codes for scripts, and the failures that lead to them.

use std::io;

/// How the command ends. Small numbers are answers, those from 64 are `vpcd`'s (after `sysexits.h`).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Exit {
    /// `status`: moving or arrived. A request: done. `doctor`: nothing to mend.
    Ok = 0,
    /// `status`: the camera stands or brakes: stopped, holding, braking. `doctor`: something must be mended.
    Attention = 1,
    /// A request: refused by the controller.
    Refused = 2,
    /// No daemon is at work in the domain.
    NoDaemon = 3,
    /// A daemon is at work and does not answer, or its cycles have stopped.
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
    /// vpcctl failed by itself, or could not write.
    Software = 70,
}

impl From<Exit> for std::process::ExitCode {
    fn from(exit: Exit) -> Self {
        Self::from(exit as u8)
    }
}

/// Why a command could not do what was asked.
#[derive(Debug, thiserror::Error)]
pub enum Failure {
    /// Nobody serves the domain.
    #[error(
        "domain {domain}: no vpcd is at work; start it (vpcd --domain {domain} ...), or name its domain with --domain"
    )]
    NoDaemon {
        /// The domain's directory.
        domain: String,
    },
    /// Nobody answered.
    #[error(
        "domain {domain}: {process} did not answer within {seconds} s; see `vpcctl doctor`, or end it with `kill -TERM` (zero twist, controlled stop)"
    )]
    NoAnswer {
        /// The domain's directory.
        domain: String,
        /// Who should have.
        process: String,
        /// How long was waited.
        seconds: f64,
    },
    /// The domain cannot be joined.
    #[error(transparent)]
    Join(#[from] ipc::JoinError),
    /// A port cannot be opened.
    #[error(transparent)]
    Open(#[from] ipc::OpenError),
    /// A request cannot be sent, or its answer cannot be read.
    #[error(transparent)]
    Ask(#[from] ipc::AskError),
    /// Records cannot be received.
    #[error(transparent)]
    Receive(#[from] ipc::ReceiveError),
    /// The scene is wrong.
    #[error(transparent)]
    Scene(#[from] scene::SceneError),
    /// The view needs a terminal.
    #[error("watch: standard output is no terminal; use `vpcctl status`, --json for scripts")]
    NoTerminal,
    /// The address is not of this machine alone.
    #[error(
        "--listen {address}: other machines reach this address; allowed: 127.0.0.0/8 and [::1] (see them from afar with `ssh -L`), others with --expose"
    )]
    Exposed {
        /// The address.
        address: String,
    },
    /// Commands over the network.
    #[error(
        "--control: token and commands would be readable on the network; allowed: with 127.0.0.0/8 and [::1] (from afar: ssh -L 9470:127.0.0.1:9470 HOST)"
    )]
    ExposedControl,
    /// The address cannot be used.
    #[error(
        "--listen {address}: {source}; allowed: a free address of this machine (port 0: any free port)"
    )]
    Listen {
        /// The address.
        address: String,
        /// The operating system's reason.
        source: io::Error,
    },
    /// A file cannot be written.
    #[error("{path}: cannot write: {source}")]
    Write {
        /// The file.
        path: String,
        /// The operating system's reason.
        source: io::Error,
    },
    /// Scene or configuration of a recording.
    #[error(transparent)]
    Context(#[from] recording::ContextError),
    /// A recording cannot be made.
    #[error(transparent)]
    Record(#[from] recording::RecordError),
    /// A recording cannot be read.
    #[error(transparent)]
    Recording(#[from] recording::ReadError),
    /// A recording cannot be drawn.
    #[error(transparent)]
    Plot(#[from] recording::PlotError),
    /// A program that does the work is missing.
    #[error("{program}: cannot run: {source}; allowed: beside vpcctl, or in PATH")]
    Program {
        /// The program.
        program: String,
        /// The operating system's reason.
        source: io::Error,
    },
    /// The output cannot be written.
    #[error("cannot write the output: {0}")]
    Output(#[from] io::Error),
}

impl Failure {
    /// The exit code that goes with it.
    pub fn exit(&self) -> Exit {
        use recording::{ContextError, PlotError, ReadError, RecordError, WriteError};
        match self {
            Self::Record(RecordError::Join(_) | RecordError::Open(_) | RecordError::Receive(_)) => {
                Exit::Unavailable
            }
            Self::Record(RecordError::Write(WriteError::Exists { .. })) => Exit::Usage,
            Self::Context(ContextError::Read { .. })
            | Self::Recording(ReadError::Read { .. })
            | Self::Program { .. } => Exit::NoInput,
            Self::Context(_)
            | Self::Recording(_)
            | Self::Plot(PlotError::NoScene | PlotError::Empty) => Exit::Data,
            Self::Record(_) | Self::Plot(_) => Exit::Software,
            Self::NoDaemon { .. } => Exit::NoDaemon,
            Self::NoAnswer { .. } => Exit::NoAnswer,
            Self::Join(_) | Self::Open(_) | Self::Ask(_) | Self::Receive(_) => Exit::Unavailable,
            Self::NoTerminal | Self::Exposed { .. } | Self::ExposedControl => Exit::Usage,
            Self::Listen { .. } => Exit::Unavailable,
            Self::Scene(scene::SceneError::Read { .. }) => Exit::NoInput,
            Self::Scene(_) => Exit::Data,
            Self::Write { .. } | Self::Output(_) => Exit::Software,
        }
    }
}
