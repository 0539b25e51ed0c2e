//! Signals that end a program: SIGINT, SIGTERM, and SIGHUP unless `nohup` began the program.

use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
use signal_hook::flag;

use crate::Exit;

/// Between two looks for a signal.
const LOOK: Duration = Duration::from_millis(20);

/// Until this is dropped, these signals end the program at once: nothing of it moves yet, and it
/// may wait for a file or a lock.
#[derive(Debug)]
pub struct StartUp(Arc<AtomicBool>);

impl StartUp {
    /// Begins.
    ///
    /// # Errors
    /// The system refuses a handler.
    pub fn begin() -> io::Result<Self> {
        Self::on(ending())
    }

    /// Begins with other signals.
    ///
    /// # Errors
    /// As [`StartUp::begin`].
    pub fn on(signals: impl IntoIterator<Item = i32>) -> io::Result<Self> {
        let is_starting = Arc::new(AtomicBool::new(true));
        for signal in signals {
            let registered = flag::register_conditional_default(signal, Arc::clone(&is_starting));
            registered.map_err(refused(signal))?;
        }
        Ok(Self(is_starting))
    }
}

impl Drop for StartUp {
    fn drop(&mut self) {
        self.0.store(false, Ordering::Relaxed);
    }
}

/// A flag that these signals set. Repeating them changes nothing: an impatient operator must not
/// cut short how a robot is stopped. SIGQUIT and SIGKILL end a program that does not stop.
///
/// # Errors
/// The system refuses a handler.
pub fn stop_on_signals() -> io::Result<Arc<AtomicBool>> {
    let stop = Arc::new(AtomicBool::new(false));
    for signal in ending() {
        set_on(signal, &stop)?;
    }
    Ok(stop)
}

/// A flag that these signals set. A second one ends the program at once with the exit code 130: for
/// programs that move nothing.
///
/// # Errors
/// The system refuses a handler.
pub fn stop_or_end_on_signals() -> io::Result<Arc<AtomicBool>> {
    let stop = Arc::new(AtomicBool::new(false));
    for signal in ending() {
        let registered = flag::register_conditional_shutdown(signal, 130, Arc::clone(&stop));
        registered.map_err(refused(signal))?;
        set_on(signal, &stop)?;
    }
    Ok(stop)
}

/// Lets a signal set a flag.
///
/// # Errors
/// The system refuses the handler.
pub fn set_on(signal: i32, flag: &Arc<AtomicBool>) -> io::Result<()> {
    let registered = flag::register(signal, Arc::clone(flag));
    registered.map(drop).map_err(refused(signal))
}

/// Ignores a signal from here on, also in a program that this process executes.
///
/// # Errors
/// There is no such signal, or it cannot be ignored.
#[allow(unsafe_code)]
pub fn ignore(signal: i32) -> io::Result<()> {
    // SAFETY: it names no handler, so that no code of ours runs in a signal.
    match unsafe { libc::signal(signal, libc::SIG_IGN) } {
        libc::SIG_ERR => Err(refused(signal)(io::Error::last_os_error())),
        _ => Ok(()),
    }
}

/// Whether the process was begun with this signal ignored, as `nohup` does with SIGHUP.
pub fn is_ignored(signal: i32) -> bool {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let ignored = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    let ignored = ignored.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok());
    ignored.is_some_and(|mask| mask >> (signal - 1) & 1 == 1)
}

/// Ends the process where it is, with the exit code [`Exit::Attention`], if it has not ended by
/// itself within `patience` after `stop` was set. It starts a thread for that, so that nothing that
/// hangs keeps a signal from ending the program.
///
/// # Errors
/// There is no thread.
pub fn end_within(
    patience: Duration,
    stop: &Arc<AtomicBool>,
    name: &'static str,
) -> io::Result<()> {
    let stop = Arc::clone(stop);
    let watch = move || {
        while !stop.load(Ordering::Relaxed) {
            std::thread::sleep(LOOK);
        }
        std::thread::sleep(patience);
        eprintln!("{name}: not stopped within {patience:?}: ended where it is");
        std::process::exit(Exit::Attention as i32);
    };
    let thread = std::thread::Builder::new().name("end".to_owned());
    thread.spawn(watch).map(drop)
}

/// The signals that end a program.
pub fn ending() -> impl Iterator<Item = i32> {
    let hangup = (!is_ignored(SIGHUP)).then_some(SIGHUP);
    [SIGINT, SIGTERM].into_iter().chain(hangup)
}

fn refused(signal: i32) -> impl FnOnce(io::Error) -> io::Error {
    move |error| io::Error::new(error.kind(), format!("signal {signal}: {error}"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use signal_hook::consts::{SIGKILL, SIGUSR2};
    use signal_hook::low_level::raise;

    #[test]
    fn a_signal_sets_its_flag_and_no_other() {
        let [usr2, winch] = [(); 2].map(|()| Arc::new(AtomicBool::new(false)));
        set_on(SIGUSR2, &usr2).unwrap();
        set_on(signal_hook::consts::SIGWINCH, &winch).unwrap();
        raise(SIGUSR2).unwrap();
        assert!(usr2.load(Ordering::Relaxed) && !winch.load(Ordering::Relaxed));
    }

    #[test]
    fn an_ignored_signal_does_nothing() {
        ignore(signal_hook::consts::SIGALRM).unwrap();
        raise(signal_hook::consts::SIGALRM).unwrap();
        assert!(is_ignored(signal_hook::consts::SIGALRM));
        let error = ignore(SIGKILL).unwrap_err();
        assert!(error.to_string().contains("signal 9"), "{error}");
    }

    #[test]
    fn pipes_are_ignored_by_rust_and_termination_is_not() {
        assert!(is_ignored(signal_hook::consts::SIGPIPE));
        assert!(!is_ignored(SIGTERM) && !is_ignored(SIGKILL));
    }
}
