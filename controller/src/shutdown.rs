//! Signals: SIGTERM and SIGINT end the daemon, SIGHUP lets it begin again.

use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use program::StartUp;
use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};

/// What ends the daemon.
const SIGNALS: [i32; 2] = [SIGTERM, SIGINT];

/// Set once the daemon is to stop.
#[derive(Clone, Debug, Default)]
pub struct Stop {
    is_asked: Arc<AtomicBool>,
    is_signalled: Arc<AtomicBool>,
}

impl Stop {
    /// A stop flag that SIGTERM and SIGINT set. Repeating them changes nothing: an impatient
    /// operator must not cut a controlled stop short. SIGQUIT and SIGKILL end a daemon that does
    /// not stop. Until [`StartUp`] is dropped the signals end the process, which has moved nothing
    /// yet.
    ///
    /// # Errors
    /// If the operating system refuses the handlers.
    pub fn by_signals() -> io::Result<(StartUp, Self)> {
        let (start_up, stop) = (StartUp::on(SIGNALS)?, Self::default());
        for signal in SIGNALS {
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
        std::mem::forget(StartUp::on(SIGNALS)?);
        Ok(self.is_signalled.load(Ordering::Relaxed))
    }
}

/// Set by SIGHUP, which would otherwise kill the daemon.
#[derive(Clone, Debug, Default)]
pub struct Hangup(Arc<AtomicBool>);

impl Hangup {
    /// A flag that SIGHUP sets.
    ///
    /// # Errors
    /// If the operating system refuses the handler.
    pub fn by_signal() -> io::Result<Self> {
        let hangup = Self::default();
        program::set_on(SIGHUP, &hangup.0)?;
        Ok(hangup)
    }

    /// Whether the signal came since the last call.
    pub fn take(&self) -> bool {
        self.0.swap(false, Ordering::Relaxed)
    }
}
