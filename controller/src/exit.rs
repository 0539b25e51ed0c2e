//! Exit codes, after `sysexits.h`, so that a service manager can tell what failed.

/// How the daemon ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Exit {
    /// Stopped by a signal or after the cycles asked for.
    Ok = 0,
    /// The machine is unfit for real time, or a replay differs.
    No = 1,
    /// The command line is wrong.
    Usage = 64,
    /// A scene or a memory is wrong, or the memory was built for another task.
    Data = 65,
    /// A file is missing or cannot be read.
    NoInput = 66,
    /// The shared memory cannot be used: another controller is at work, or the domain is not ours.
    Unavailable = 69,
    /// The daemon failed by itself.
    Software = 70,
    /// A file that was asked for cannot be written.
    CannotCreate = 73,
    /// The configuration is wrong.
    Config = 78,
}

impl From<Exit> for std::process::ExitCode {
    fn from(exit: Exit) -> Self {
        Self::from(exit as u8)
    }
}
