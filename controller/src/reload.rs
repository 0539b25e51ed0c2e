//! SIGUSR2: the daemon begins again with its files as they are now, and disarmed.
//!
//! Another process of the same program checks the files (`--check-only`) while the loop goes on; if
//! they are wrong, nothing changes. It leaves what it has read on a memory file. Then the daemon
//! ends as by SIGTERM, and the process executes its program again: it keeps its number, so that a
//! service manager knows it. What was left is the new one's standard input, for where the files
//! have changed for the worse meanwhile ([`crate::start`]).

use std::ffi::OsString;
use std::fs::File;
use std::io;
use std::os::unix::ffi::OsStringExt;
use std::os::unix::process::CommandExt;
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::{self, Sender};
use std::sync::{Arc, OnceLock};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use rustix::fs::{MemfdFlags, memfd_create};
use signal_hook::consts::SIGUSR1;
use tracing::{error, info};

use crate::shutdown::{Renewal, Stop, renewing};

/// Longest check of the files.
const CHECK: Duration = Duration::from_secs(5);
/// Stack of the thread that waits, bytes: real-time scheduling locks it in memory.
const STACK: usize = 64 * 1024;
/// What Linux adds to the path of a program that was replaced, by an update for instance.
const REPLACED: &[u8] = b" (deleted)";

/// Answers a request to begin again, in the ordinary thread.
#[derive(Debug, Default)]
pub struct Reload {
    renewal: Renewal,
    stop: Stop,
    again: Again,
    check: Option<Check>,
}

/// A check under way.
#[derive(Debug)]
struct Check {
    process: Child,
    /// What it has read.
    checked: File,
    until: Instant,
}

/// Set once the daemon is to end in order to begin again: the files that were checked.
#[derive(Clone, Debug, Default)]
pub struct Again(Arc<OnceLock<File>>);

impl Again {
    /// Asks for it, once.
    pub(crate) fn ask(&self, checked: File) {
        self.0.get_or_init(|| checked);
    }

    /// Whether it is to begin again.
    pub fn is_asked(&self) -> bool {
        self.0.get().is_some()
    }
}

impl Reload {
    /// Answers `renewal` by `stop`, once `again` is set.
    pub fn new(renewal: Renewal, stop: Stop, again: Again) -> Self {
        Self {
            renewal,
            stop,
            again,
            check: None,
        }
    }

    /// One look, every few milliseconds.
    pub fn tend(&mut self) {
        if self.stop.is_asked() {
            return;
        }
        let outcome = match self.check.as_mut() {
            Some(check) => check.outcome(),
            None if self.renewal.take() => {
                info!("asked to begin again: checks the files");
                Check::begin().map(|check| {
                    self.check = Some(check);
                    None
                })
            }
            None => return,
        };
        match outcome {
            Ok(None) => return,
            Ok(Some(checked)) => {
                info!("begins again with the files as they are now, disarmed");
                self.again.ask(checked);
                self.stop.ask();
            }
            Err(why) => error!("goes on with what it has read before: {why}"),
        }
        self.check = None;
    }
}

impl Check {
    #[expect(clippy::disallowed_methods, reason = "it ends by itself")]
    fn begin() -> io::Result<Self> {
        let checked = File::from(memfd_create("vpcd-checked", MemfdFlags::CLOEXEC)?);
        let mut command = Command::new(file()?);
        command.args(arguments(0)).arg("--check-only");
        command.stdin(Stdio::null()).stdout(checked.try_clone()?);
        Ok(Self {
            checked,
            process: command.stderr(Stdio::piped()).spawn()?,
            until: Instant::now() + CHECK,
        })
    }

    /// The files if they are good; `None` while that is not known.
    fn outcome(&mut self) -> io::Result<Option<File>> {
        let Some(status) = self.process.try_wait()? else {
            if Instant::now() < self.until {
                return Ok(None);
            }
            self.process.kill()?;
            self.process.wait()?;
            let message = format!("the check took more than {} s", CHECK.as_secs());
            return Err(io::Error::new(io::ErrorKind::TimedOut, message));
        };
        if status.success() {
            return self.checked.try_clone().map(Some);
        }
        let told = self.process.stderr.take().map(io::read_to_string);
        let told = told.transpose()?.unwrap_or_default();
        Err(io::Error::other(format!("{} ({status})", told.trim())))
    }
}

/// A thread that is never real-time, and executes the program again: the new one has the scheduling
/// of the thread by which it begins.
#[derive(Debug)]
pub struct Successor {
    go: Sender<(u32, Again)>,
    thread: JoinHandle<Option<io::Error>>,
}

impl Successor {
    /// Starts the thread, which waits. To be called before the caller takes real-time scheduling.
    ///
    /// # Errors
    /// There is no thread.
    pub fn ready() -> io::Result<Self> {
        let (go, is_time) = mpsc::channel();
        let thread = std::thread::Builder::new().name("again".to_owned());
        // Where nobody says so, it ends.
        let wait = move || is_time.recv().ok().map(execute);
        let thread = thread.stack_size(STACK).spawn(wait)?;
        Ok(Self { go, thread })
    }

    /// Executes the program again, under the veto of this name; of this one nothing is left but
    /// its process, and what was checked.
    pub fn begin(self, veto: u32, again: Again) -> io::Error {
        let _ = self.go.send((veto, again));
        let why = self.thread.join().ok().flatten();
        why.unwrap_or_else(|| io::Error::other("the thread that begins again died"))
    }
}

/// Executes the program again; returns only if that failed.
#[expect(clippy::disallowed_methods, reason = "it begins no child")]
fn execute((veto, again): (u32, Again)) -> io::Error {
    let prepared = || {
        // Until the new one listens, they would end it.
        renewing().chain([SIGUSR1]).try_for_each(program::ignore)?;
        let checked = again.0.get().map(File::try_clone).transpose()?;
        Ok((file()?, checked.map_or_else(Stdio::null, Stdio::from)))
    };
    match prepared() {
        Ok((file, checked)) => Command::new(file)
            .args(arguments(veto))
            .stdin(checked)
            .exec(),
        Err(error) => error,
    }
}

/// The program's file, which an update may have replaced.
fn file() -> io::Result<PathBuf> {
    let path = std::env::current_exe()?.into_os_string().into_vec();
    let path = path.strip_suffix(REPLACED).unwrap_or(&path).to_vec();
    Ok(OsString::from_vec(path).into())
}

/// The command line, with `--again`.
fn arguments(veto: u32) -> impl Iterator<Item = OsString> {
    let given = std::env::args_os().skip(1);
    let kept = given.filter(|word| !word.as_encoded_bytes().starts_with(b"--again="));
    kept.chain([format!("--again={veto}").into()])
}
