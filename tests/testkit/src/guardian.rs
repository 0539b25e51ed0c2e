//! Children that end with the process that started them, however it ends.
//!
//! The first [`command`] starts the *guardian*: a shell that leads a process group and reads a pipe
//! whose only writer is this process. Every command runs in that group. When this process ends, be
//! it by SIGKILL or by an abort, the kernel closes the pipe, and the guardian ends the group.
//!
//! What children start belongs to the group as well, unless it makes a group of its own, as
//! `timeout` without `--foreground` does. The kernel's signal at the death of a parent
//! (`PR_SET_PDEATHSIG`) is no substitute: it comes when the *thread* that started the child ends,
//! and the children of a child never get it.

use std::ffi::OsStr;
use std::os::unix::process::CommandExt;
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};
use std::sync::{Mutex, OnceLock, PoisonError};

use rustix::process::Pid;

/// What the guardian does. `vpcd` and `hw-sim` leave their domain on SIGTERM; what is left after 5
/// s is killed. A line of `/proc/PID/stat` has state, parent and group behind the name in brackets.
const SCRIPT: &str = r#"
trap '' HUP INT TERM
trap 'rm -rf "$STATE"' EXIT
read -r _
kill -TERM 0
kill -CONT 0
round=0
while [ $round -lt 100 ]; do
    left=
    for stat in /proc/[0-9]*/stat; do
        read -r line <"$stat" || continue
        set -- ${line##*) }
        [ "$3" = $$ ] && [ "$1" != Z ] && [ "$stat" != /proc/$$/stat ] && left=$stat && break
    done
    [ "$left" ] || exit 0
    sleep 0.05
    round=$((round + 1))
done
rm -rf "$STATE"
kill -KILL 0
"#;

static GUARDIAN: OnceLock<Mutex<Child>> = OnceLock::new();

/// A command whose process, and what that starts in turn, ends with this process: SIGTERM, and
/// SIGKILL 5 s later. Clippy refuses any other way to make a command (`clippy.toml`).
///
/// # Panics
/// If there is no `sh`.
pub fn command(program: impl AsRef<OsStr>) -> Command {
    let guardian = GUARDIAN.get_or_init(|| Mutex::new(guardian()));
    let guardian = guardian.lock().unwrap_or_else(PoisonError::into_inner);
    let group = Pid::from_child(&guardian).as_raw_nonzero();
    let mut command = bare(program);
    command.process_group(group.get());
    // Notes of daemons that were killed are not the user's, nor another user's.
    command
        .env("XDG_STATE_HOME", state())
        .env_remove("STATE_DIRECTORY");
    command
}

/// Where daemons note how they ended; removed with the guardian.
fn state() -> PathBuf {
    std::env::temp_dir().join(format!("state-of-vpc-tests-{}", std::process::id()))
}

/// Ends all children of this process that still run, and what they started, as its end would;
/// returns when none is left. No more can be started.
pub fn end_children() {
    if let Some(guardian) = GUARDIAN.get() {
        let mut guardian = guardian.lock().unwrap_or_else(PoisonError::into_inner);
        drop(guardian.stdin.take());
        let _ = guardian.wait();
    }
}

fn guardian() -> Child {
    let mut shell = bare("/bin/sh");
    shell.args(["-c", SCRIPT]).process_group(0).current_dir("/");
    shell.env("STATE", state());
    shell.stdin(Stdio::piped());
    // Whoever waits for the end of this process's output does not wait for the guardian.
    shell.stdout(Stdio::null()).stderr(Stdio::null());
    let shell = shell.spawn();
    shell.unwrap_or_else(|error| panic!("/bin/sh, which ends children: {error}"))
}

#[expect(clippy::disallowed_methods, reason = "the one place that may")]
fn bare(program: impl AsRef<OsStr>) -> Command {
    Command::new(program)
}
