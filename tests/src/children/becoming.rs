//! This program, started by itself, becomes the child that it was started for, after it asked the kernel for a signal at
//! its parent's end.

use std::ffi::{OsStr, OsString};
use std::os::unix::process::CommandExt;
use std::process::{Command, ExitCode};

use rustix::process::{Pid, Signal, getppid, set_parent_process_death_signal};

/// First argument of this program where it is to become a child; the parent, the program and its arguments follow.
const BECOME: &str = "--become-child-of";
/// Exit code of a shell for a program that cannot be run.
const NO_PROGRAM: u8 = 127;

/// What [`Children::start`](super::Children::start) takes: a program that ends with this one.
pub fn command(program: impl AsRef<OsStr>) -> Command {
    // Its link, not its name: the file may have been built anew in the meantime.
    let mut command = Command::new("/proc/self/exe");
    command.arg(BECOME).arg(std::process::id().to_string());
    command.arg(program);
    command
}

/// Becomes the child that this program was started for; an exit code where that is not possible, `None` where it was
/// started for itself.
pub fn become_child() -> Option<ExitCode> {
    let mut words = std::env::args_os().skip(1);
    if words.next()? != BECOME {
        return None;
    }
    let parent: Option<i32> = words.next().and_then(|word| word.to_str()?.parse().ok());
    let program: OsString = words.next().unwrap_or_default();
    let asked = set_parent_process_death_signal(Some(Signal::TERM));
    // Gone before the kernel was asked?
    if asked.is_err() || getppid().map(Pid::as_raw_pid) != parent {
        return Some(ExitCode::from(NO_PROGRAM));
    }
    // The request outlives this; not so where the file has capabilities of its own.
    let error = Command::new(&program).args(words).exec();
    eprintln!("{}: {error}", program.display());
    Some(ExitCode::from(NO_PROGRAM))
}
