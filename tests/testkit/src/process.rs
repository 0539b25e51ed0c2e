use std::borrow::BorrowMut;
use std::io::{self, Read};
use std::os::unix::process::ExitStatusExt;
use std::process::{Child, Command, ExitStatus, Output};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

use rustix::process::{Pid, Signal, WaitId, WaitIdOptions, kill_process, waitid};

use crate::{PATIENCE, eventually, within};

/// How a process ended, and what it printed to the outputs that were piped.
#[derive(Clone, Debug)]
pub struct Ended {
    /// The exit code; `None` if a signal ended it.
    pub code: Option<i32>,
    /// The signal that ended it.
    pub signal: Option<i32>,
    /// Standard output.
    pub stdout: String,
    /// Standard error.
    pub stderr: String,
}

impl Ended {
    /// The exit code, -1 for a signal, and standard error.
    pub fn log(self) -> (i32, String) {
        (self.code.unwrap_or(-1), self.stderr)
    }
}

impl From<Output> for Ended {
    fn from(output: Output) -> Self {
        Self {
            code: output.status.code(),
            signal: output.status.signal(),
            stdout: String::from_utf8_lossy(&output.stdout).into_owned(),
            stderr: String::from_utf8_lossy(&output.stderr).into_owned(),
        }
    }
}

/// Runs a command to its end; both outputs are piped.
///
/// # Panics
/// If it cannot be started.
pub fn ended(mut command: impl BorrowMut<Command>) -> Ended {
    let command = command.borrow_mut();
    let output = command.output();
    output
        .unwrap_or_else(|error| panic!("{command:?}: {error}"))
        .into()
}

/// A child process, killed when it is dropped. Outputs that are piped are read all the time.
#[derive(Debug)]
pub struct Running {
    child: Child,
    stdout: Reader,
    stderr: Reader,
}

impl Running {
    /// Starts a command.
    ///
    /// # Panics
    /// If it cannot be started.
    pub fn start(mut command: impl BorrowMut<Command>) -> Self {
        let command = command.borrow_mut();
        let child = command.spawn();
        let mut child = child.unwrap_or_else(|error| panic!("{command:?}: {error}"));
        Self {
            stdout: Reader::new(child.stdout.take()),
            stderr: Reader::new(child.stderr.take()),
            child,
        }
    }

    /// Its process number.
    pub fn id(&self) -> u32 {
        self.child.id()
    }

    /// Sends it a signal.
    pub fn signal(&self, signal: Signal) {
        let sent = kill_process(Pid::from_child(&self.child), signal);
        sent.unwrap_or_else(|error| panic!("process {}: {error}", self.id()));
    }

    /// Sends it SIGKILL or SIGSTOP, and waits until it has ended or stands: on another processor it
    /// goes on for a moment.
    pub fn halt(&self, signal: Signal) {
        self.signal(signal);
        let options = WaitIdOptions::EXITED | WaitIdOptions::STOPPED | WaitIdOptions::NOWAIT;
        let halted = waitid(WaitId::Pid(Pid::from_child(&self.child)), options);
        halted.unwrap_or_else(|error| panic!("process {}: {error}", self.id()));
    }

    /// Returns whether it has not ended.
    pub fn is_running(&mut self) -> bool {
        self.status().is_none()
    }

    fn status(&mut self) -> Option<ExitStatus> {
        self.child.try_wait().expect("our child")
    }

    /// What it has printed to standard output so far.
    pub fn stdout(&self) -> String {
        self.stdout.text()
    }

    /// What it has printed to standard error so far.
    pub fn stderr(&self) -> String {
        self.stderr.text()
    }

    /// Waits for a line with these words on either output; the line.
    pub fn line(&mut self, words: &str) -> String {
        eventually(words, || {
            // Asked first, so that what it printed last is read.
            let has_ended = !self.is_running();
            if has_ended {
                self.stdout.finish();
                self.stderr.finish();
            }
            let text = self.stdout() + &self.stderr();
            let whole = text
                .split_inclusive('\n')
                .filter(|line| line.ends_with('\n'));
            let found = whole.map(str::trim_end).find(|line| line.contains(words));
            assert!(
                found.is_some() || !has_ended,
                "it ended without `{words}`: {text}"
            );
            found.map(str::to_owned)
        })
    }

    /// Waits for its end.
    ///
    /// # Panics
    /// If it has not ended after [`PATIENCE`].
    pub fn ended(self) -> Ended {
        self.ended_within(PATIENCE)
    }

    /// Waits for its end.
    ///
    /// # Panics
    /// If it has not ended in this time.
    pub fn ended_within(mut self, patience: Duration) -> Ended {
        let status = within(patience, || self.status());
        let Some(status) = status else {
            let said = self.stdout() + &self.stderr();
            panic!(
                "process {} has not ended after {patience:?}: {said}",
                self.id()
            );
        };
        Ended {
            code: status.code(),
            signal: status.signal(),
            stdout: self.stdout.finish(),
            stderr: self.stderr.finish(),
        }
    }

    /// Sends SIGTERM and waits for its end.
    pub fn terminated(self) -> Ended {
        self.signal(Signal::TERM);
        self.ended()
    }

    /// Kills it (SIGKILL).
    pub fn kill(self) {}
}

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Reads a pipe to its end in a thread of its own.
#[derive(Debug)]
struct Reader {
    read: Arc<Mutex<Vec<u8>>>,
    thread: Option<JoinHandle<()>>,
}

impl Reader {
    fn new(pipe: Option<impl Read + Send + 'static>) -> Self {
        let read = Arc::default();
        let thread = pipe.map(|mut pipe| {
            let read: Arc<Mutex<Vec<u8>>> = Arc::clone(&read);
            std::thread::spawn(move || {
                let mut buffer = [0; 4096];
                loop {
                    match pipe.read(&mut buffer) {
                        Ok(0) => return,
                        Ok(n) => read
                            .lock()
                            .unwrap_or_else(PoisonError::into_inner)
                            .extend(&buffer[..n]),
                        Err(error) if error.kind() == io::ErrorKind::Interrupted => (),
                        Err(_) => return,
                    }
                }
            })
        });
        Self { read, thread }
    }

    fn text(&self) -> String {
        let read = self.read.lock().unwrap_or_else(PoisonError::into_inner);
        String::from_utf8_lossy(&read).into_owned()
    }

    /// Reads to the end, which comes when every process that has the pipe is gone.
    fn finish(&mut self) -> String {
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
        self.text()
    }
}
