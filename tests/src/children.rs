//! Child processes that do not outlive this program, whichever way it ends.
//!
//! A signal that can be heard ends them in order, and what they worked in is removed. One that cannot (SIGKILL), or a
//! crash, leaves that to the kernel: it sends each child a SIGTERM, on which `vpcd` and `hw-sim` leave their domain as
//! they do otherwise. Only the child itself can ask the kernel for that, and safe code of ours runs nowhere between
//! fork and exec; so this program starts itself, asks, and becomes the child.

use std::path::PathBuf;
use std::process::{Child, Command, ExitCode, Output};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

use anyhow::{Context, bail};
use rustix::process::Signal;
use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};

mod becoming;
mod handle;

use becoming::become_child;
pub use becoming::command;
use handle::Handle;

/// Longest time for a child to end after a termination signal; then it is killed.
const PATIENCE: Duration = Duration::from_secs(5);
/// How soon a signal is seen.
const LOOK: Duration = Duration::from_millis(10);
/// What the main thread has; its work moves to another one.
const STACK: usize = 8 << 20;

/// All children of this program, and the directories that they work in.
#[derive(Debug, Default)]
pub struct Children(Mutex<State>);

#[derive(Debug, Default)]
struct State {
    running: Vec<Arc<Handle>>,
    places: usize,
    /// A signal was heard: nobody starts anything from here on.
    is_ending: bool,
}

/// Does a program's work, with children, and says what failed. A signal ends them, then the program, in the way of that
/// signal. To be called first thing in `main`: this program may have been started to become a child.
pub fn attended(
    program: &str,
    work: impl FnOnce(&Children) -> anyhow::Result<ExitCode> + Send,
) -> ExitCode {
    if let Some(code) = become_child() {
        return code;
    }
    let heard = Arc::new(AtomicUsize::new(0));
    for signal in [SIGINT, SIGTERM, SIGHUP] {
        // Whoever started this program with `nohup` or in the background wants it to go on.
        if is_ignored(signal) {
            continue;
        }
        let number = signal.unsigned_abs() as usize;
        if let Err(error) = signal_hook::flag::register_usize(signal, Arc::clone(&heard), number) {
            eprintln!("{program}: signal {signal}: {error}");
            return ExitCode::FAILURE;
        }
    }
    let children = Children::default();
    thread::scope(|scope| {
        let worker = thread::Builder::new()
            .stack_size(STACK)
            .spawn_scoped(scope, || work(&children));
        let worker = match worker {
            Ok(worker) => worker,
            Err(error) => {
                eprintln!("{program}: no thread: {error}");
                return ExitCode::FAILURE;
            }
        };
        loop {
            let signal = heard.load(Ordering::Relaxed);
            if signal != 0 {
                children.end();
                let begin = Instant::now();
                // What uses no directory has nothing to clear away.
                while children.state().places > 0 && begin.elapsed() < PATIENCE {
                    thread::sleep(LOOK);
                }
                // As if nobody had listened: the shell sees by what it ended.
                let _ = signal_hook::low_level::emulate_default_handler(signal as i32);
            }
            if worker.is_finished() {
                return match worker.join() {
                    Ok(Ok(code)) => code,
                    Ok(Err(error)) => {
                        eprintln!("{program}: {error:#}");
                        ExitCode::FAILURE
                    }
                    // The panic has been told.
                    Err(_) => ExitCode::FAILURE,
                };
            }
            thread::sleep(LOOK);
        }
    })
}

/// Whether this process was started with a signal ignored.
fn is_ignored(signal: i32) -> bool {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let mask = status
        .lines()
        .find_map(|line| line.strip_prefix("SigIgn:"))
        .and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok());
    mask.is_some_and(|mask| mask >> (signal - 1) & 1 == 1)
}

impl Children {
    fn state(&self) -> MutexGuard<'_, State> {
        // Lists stay lists wherever a panic came between.
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Starts a command of [`command`]; `name` is for messages. A process group of its own is ended as a whole. The
    /// calling thread outlives the child, as the kernel takes it for the parent.
    ///
    /// # Errors
    /// It cannot be started, or this program is ending.
    pub fn start(&self, name: &'static str, mut command: Command) -> anyhow::Result<Running<'_>> {
        let mut state = self.state();
        if state.is_ending {
            bail!("cannot start {name}: a signal has ended this program");
        }
        let mut child = command
            .spawn()
            .with_context(|| format!("cannot start {name}"))?;
        let handle = match Handle::of(&child) {
            Ok(handle) => Arc::new(handle),
            Err(error) => {
                let _ = child.kill();
                let _ = child.wait();
                bail!("cannot hold {name} (process {}): {error}", child.id());
            }
        };
        state.running.push(Arc::clone(&handle));
        Ok(Running {
            name,
            child: Some(child),
            handle,
            children: self,
        })
    }

    /// A directory for children to work in, which is removed with everything in it when it is dropped.
    pub fn place(&self, path: PathBuf) -> Place<'_> {
        self.state().places += 1;
        Place {
            path,
            is_kept: false,
            children: self,
        }
    }

    /// Ends all children, the last one first, and lets nobody start more of them.
    fn end(&self) {
        let mut state = self.state();
        state.is_ending = true;
        for handle in state.running.iter().rev() {
            handle.send(Signal::TERM);
        }
        let end = Instant::now() + PATIENCE;
        for handle in &state.running {
            if !handle.ends_by(end) {
                handle.send(Signal::KILL);
                handle.ends_by(Instant::now() + PATIENCE);
            }
        }
    }
}

/// A child; ended when it is dropped.
#[derive(Debug)]
pub struct Running<'a> {
    name: &'static str,
    child: Option<Child>,
    handle: Arc<Handle>,
    children: &'a Children,
}

impl Running<'_> {
    /// Waits for its end, and gives its exit code and the outputs that are piped.
    ///
    /// # Errors
    /// It cannot be waited for, or was ended with this program.
    pub fn output(mut self) -> anyhow::Result<Output> {
        let child = self.child.take().context("waited for before")?;
        let output = child
            .wait_with_output()
            .with_context(|| format!("cannot wait for {}", self.name))?;
        if self.children.state().is_ending {
            bail!("{} was ended by a signal to this program", self.name);
        }
        Ok(output)
    }

    /// Asks it to stop and waits for it.
    ///
    /// # Errors
    /// It ended with another exit code than 0, or not at all.
    pub fn stop(&mut self) -> anyhow::Result<()> {
        let (name, pid) = (self.name, self.handle.pid());
        self.handle.send(Signal::TERM);
        if !self.handle.ends_by(Instant::now() + PATIENCE) {
            bail!("{name} (process {pid}) did not stop within {PATIENCE:?} after SIGTERM");
        }
        let mut child = self.child.take().context("stopped before")?;
        let status = child.wait()?;
        if !status.success() {
            bail!("{name} ended with {status}");
        }
        Ok(())
    }
}

impl Drop for Running<'_> {
    fn drop(&mut self) {
        if let Some(child) = &mut self.child {
            self.handle.send(Signal::TERM);
            if !self.handle.ends_by(Instant::now() + PATIENCE) {
                self.handle.send(Signal::KILL);
            }
            let _ = child.wait();
        }
        let mut state = self.children.state();
        let running = &mut state.running;
        running.retain(|handle| !Arc::ptr_eq(handle, &self.handle));
    }
}

/// A directory of children; removed when it is dropped.
#[derive(Debug)]
pub struct Place<'a> {
    path: PathBuf,
    is_kept: bool,
    children: &'a Children,
}

impl Place<'_> {
    /// Leaves the directory to whoever looks for the reason of an error; not so where a signal was the reason.
    pub fn keep(&mut self) {
        self.is_kept = true;
    }
}

impl Drop for Place<'_> {
    fn drop(&mut self) {
        let is_ending = self.children.state().is_ending;
        if is_ending || !self.is_kept {
            let _ = std::fs::remove_dir_all(&self.path);
        }
        self.children.state().places -= 1;
    }
}
