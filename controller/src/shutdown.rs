//! Signals: SIGTERM and SIGINT end the daemon, SIGUSR2 lets it begin again. SIGHUP ends it, as the
//! terminal that began it is closed; under a service manager it lets it begin again.

use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use program::StartUp;
use signal_hook::consts::{SIGHUP, SIGUSR2};

/// Whether a service manager began the daemon: then no terminal sends SIGHUP.
fn is_managed() -> bool {
    std::env::var_os("NOTIFY_SOCKET").is_some()
}

/// What ends the daemon.
fn ending() -> impl Iterator<Item = i32> {
    program::ending().filter(|signal| *signal != SIGHUP || !is_managed())
}

/// What lets it begin again.
pub(crate) fn renewing() -> impl Iterator<Item = i32> {
    [SIGUSR2].into_iter().chain(is_managed().then_some(SIGHUP))
}

/// Set once the daemon is to stop.
#[derive(Clone, Debug, Default)]
pub struct Stop {
    is_asked: Arc<AtomicBool>,
    is_signalled: Arc<AtomicBool>,
}

impl Stop {
    /// A stop flag that the signals which end the daemon set. Repeating them changes nothing: an
    /// impatient operator must not cut a controlled stop short. SIGQUIT and SIGKILL end a daemon
    /// that does not stop. Until [`StartUp`] is dropped the signals end the process, which has
    /// moved nothing yet.
    ///
    /// # Errors
    /// If the operating system refuses the handlers.
    pub fn by_signals() -> io::Result<(StartUp, Self)> {
        let (start_up, stop) = (StartUp::on(ending())?, Self::default());
        for signal in ending() {
            program::set_on(signal, &stop.is_signalled)?;
        }
        Ok((start_up, stop))
    }

    /// Asks for the stop.
    pub fn ask(&self) {
        self.is_asked.store(true, Ordering::Relaxed);
    }

    /// Whether to stop. Relaxed: no other data is published with the flags.
    pub fn is_asked(&self) -> bool {
        self.is_asked.load(Ordering::Relaxed) || self.is_signalled.load(Ordering::Relaxed)
    }

    /// Whether a signal has come. From here on signals end the process at once, so that none is
    /// lost.
    ///
    /// # Errors
    /// If the operating system refuses the handlers.
    pub fn last_signal(&self) -> io::Result<bool> {
        // Dropped, it would no longer be in force.
        std::mem::forget(StartUp::on(ending())?);
        Ok(self.is_signalled.load(Ordering::Relaxed))
    }
}

/// Set once the daemon is asked to begin again.
#[derive(Clone, Debug, Default)]
pub struct Renewal(Arc<AtomicBool>);

impl Renewal {
    /// A flag that the signals set, which would otherwise kill the daemon.
    ///
    /// # Errors
    /// If the operating system refuses a handler.
    pub fn by_signals() -> io::Result<Self> {
        let renewal = Self::default();
        for signal in renewing() {
            program::set_on(signal, &renewal.0)?;
        }
        Ok(renewal)
    }

    /// Whether the signal came since the last call.
    pub fn take(&self) -> bool {
        self.0.swap(false, Ordering::Relaxed)
    }
}
