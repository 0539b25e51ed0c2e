//! Child processes of a program that heeds signals.
//!
//! SIGINT, SIGTERM and SIGHUP end the children in order, remove the directories that they work in,
//! and end what the children had started. After SIGKILL or a crash the guardian of
//! [`testkit::command`] ends the processes; the directories stay.

use std::io::Read;
use std::path::PathBuf;
use std::process::{Child, Command, ExitCode, ExitStatus};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

use anyhow::{Context, bail};
use rustix::process::{Pid, Signal, WaitId, WaitIdOptions, kill_process, waitid};
use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};

/// Longest time for a child to end after a termination signal; then it is killed.
const PATIENCE: Duration = Duration::from_secs(5);
/// Between two looks at signals and children.
const LOOK: Duration = Duration::from_millis(10);

/// All children of this program, and the directories that they work in.
#[derive(Debug, Default)]
pub struct Children(Mutex<State>);

#[derive(Debug, Default)]
struct State {
    /// Those that have not been waited for.
    running: Vec<Pid>,
    places: usize,
    /// A signal has arrived: no more children are started.
    is_ending: bool,
}

/// Does a program's work, with children, and prints why it failed. A signal ends the children, then
/// the program, which dies of that signal.
pub fn attended(
    program: &str,
    work: impl FnOnce(&Children) -> anyhow::Result<ExitCode> + Send,
) -> ExitCode {
    let heard = Arc::new(AtomicUsize::new(0));
    // A program started with `nohup` or in the background is meant to go on.
    for signal in [SIGINT, SIGTERM, SIGHUP]
        .into_iter()
        .filter(|signal| !program::is_ignored(*signal))
    {
        let number = signal.unsigned_abs() as usize;
        if let Err(error) = signal_hook::flag::register_usize(signal, Arc::clone(&heard), number) {
            eprintln!("{program}: signal {signal}: {error}");
            return ExitCode::FAILURE;
        }
    }
    let children = Children::default();
    let outcome = thread::scope(|scope| {
        let worker = thread::Builder::new().spawn_scoped(scope, || work(&children))?;
        while !worker.is_finished() {
            let signal = heard.load(Ordering::Relaxed);
            if signal != 0 {
                children.end();
                let begin = Instant::now();
                while children.state().places > 0 && begin.elapsed() < PATIENCE {
                    thread::sleep(LOOK);
                }
                // Compilers, for instance, which cargo leaves behind.
                testkit::end_children();
                // The shell sees what it died of.
                let _ = signal_hook::low_level::emulate_default_handler(signal as i32);
            }
            thread::sleep(LOOK);
        }
        // A panic has printed its message.
        worker.join().unwrap_or(Ok(ExitCode::FAILURE))
    });
    outcome.unwrap_or_else(|error| {
        eprintln!("{program}: {error:#}");
        ExitCode::FAILURE
    })
}

/// Whether a child that has not been waited for has ended by then.
fn has_ended(child: Pid, by: Instant) -> bool {
    loop {
        // A child that is left to be waited for keeps its number.
        let options = WaitIdOptions::EXITED | WaitIdOptions::NOHANG | WaitIdOptions::NOWAIT;
        if !matches!(waitid(WaitId::Pid(child), options), Ok(None)) {
            return true;
        }
        if Instant::now() >= by {
            return false;
        }
        thread::sleep(LOOK);
    }
}

/// Sends a signal to a child that has not been waited for.
fn signal(child: Pid, signal: Signal) {
    // An error means that it is gone.
    let _ = kill_process(child, signal);
}

impl Children {
    fn state(&self) -> MutexGuard<'_, State> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Starts a command of [`testkit::command`]; `name` is for messages.
    ///
    /// # Errors
    /// It cannot be started, or this program is ending.
    pub fn start(&self, name: &'static str, mut command: Command) -> anyhow::Result<Running<'_>> {
        let mut state = self.state();
        if state.is_ending {
            bail!("cannot start {name}: a signal has ended this program");
        }
        let child = command.spawn();
        let child = child.with_context(|| format!("cannot start {name}"))?;
        state.running.push(Pid::from_child(&child));
        Ok(Running {
            name,
            child,
            children: self,
        })
    }

    /// Builds these programs beside the program that runs, with the cargo that runs it; gives their
    /// directory.
    ///
    /// # Errors
    /// Cargo cannot be run, or fails.
    pub fn build(&self, programs: &[&str]) -> anyhow::Result<PathBuf> {
        let program = std::env::current_exe()?;
        let directory = program.parent().context("no directory of binaries")?;
        for cargo in testkit::cargo_build(programs) {
            // It waits, for minutes, while another build is at work.
            eprintln!("Building {} with cargo.", programs.join(", "));
            let (status, _) = self.start("cargo", cargo)?.output()?;
            if !status.success() {
                bail!("cargo build of {}: {status}", programs.join(", "));
            }
        }
        Ok(directory.to_owned())
    }

    /// A directory for children to work in, which is removed with everything in it when it is
    /// dropped.
    pub fn place(&self, path: PathBuf) -> Place<'_> {
        self.state().places += 1;
        Place {
            path,
            children: self,
        }
    }

    /// Ends all children, the last one first, and prevents that more are started.
    fn end(&self) {
        let mut state = self.state();
        state.is_ending = true;
        state
            .running
            .iter()
            .rev()
            .for_each(|child| signal(*child, Signal::TERM));
        let end = Instant::now() + PATIENCE;
        for child in &state.running {
            if !has_ended(*child, end) {
                signal(*child, Signal::KILL);
            }
        }
    }
}

/// A child; ended when it is dropped.
#[derive(Debug)]
pub struct Running<'a> {
    name: &'static str,
    child: Child,
    children: &'a Children,
}

impl Running<'_> {
    /// Whether it has ended by itself.
    pub fn has_ended(&self) -> bool {
        has_ended(Pid::from_child(&self.child), Instant::now())
    }

    /// Waits for its end: how it ended, and its standard output where that is piped.
    ///
    /// # Errors
    /// It was ended by a signal to this program.
    pub fn output(mut self) -> anyhow::Result<(ExitStatus, String)> {
        let mut said = Vec::new();
        if let Some(mut output) = self.child.stdout.take() {
            output.read_to_end(&mut said)?;
        }
        while !has_ended(Pid::from_child(&self.child), Instant::now() + PATIENCE) {}
        let status = self.wait()?;
        if self.children.state().is_ending {
            bail!("{} was ended by a signal to this program", self.name);
        }
        Ok((status, String::from_utf8_lossy(&said).into_owned()))
    }

    /// Asks it to stop, waits for it, and tells how it ended.
    ///
    /// # Errors
    /// It had to be killed.
    pub fn terminate(mut self) -> anyhow::Result<ExitStatus> {
        signal(Pid::from_child(&self.child), Signal::TERM);
        if !has_ended(Pid::from_child(&self.child), Instant::now() + PATIENCE) {
            bail!(
                "{} did not stop within {PATIENCE:?} after SIGTERM",
                self.name
            );
        }
        Ok(self.wait()?)
    }

    /// Asks it to stop and waits for it.
    ///
    /// # Errors
    /// It ended with another exit code than 0, or had to be killed.
    pub fn stop(self) -> anyhow::Result<()> {
        let name = self.name;
        let status = self.terminate()?;
        if !status.success() {
            bail!("{name} ended with {status}");
        }
        Ok(())
    }

    /// Waits for it, once it has ended; from here on its number may be another process's.
    fn wait(&mut self) -> std::io::Result<ExitStatus> {
        let child = Pid::from_child(&self.child);
        self.children
            .state()
            .running
            .retain(|other| *other != child);
        self.child.wait()
    }
}

impl Drop for Running<'_> {
    fn drop(&mut self) {
        let child = Pid::from_child(&self.child);
        if self.children.state().running.contains(&child) {
            signal(child, Signal::TERM);
            if !has_ended(child, Instant::now() + PATIENCE) {
                signal(child, Signal::KILL);
            }
            let _ = self.wait();
        }
    }
}

/// A directory of children; removed when it is dropped.
#[derive(Debug)]
pub struct Place<'a> {
    path: PathBuf,
    children: &'a Children,
}

impl Drop for Place<'_> {
    fn drop(&mut self) {
        let mut state = self.children.state();
        let _ = std::fs::remove_dir_all(&self.path);
        state.places -= 1;
    }
}
