//! Signals: SIGTERM and SIGINT end the daemon, SIGHUP is noted.

use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
use signal_hook::flag;

/// Set once the daemon is to stop.
#[derive(Clone, Debug, Default)]
pub struct Stop {
    is_asked: Arc<AtomicBool>,
    /// Whether a signal ends the process at once.
    is_starting: Arc<AtomicBool>,
}

impl Stop {
    /// A stop flag that SIGTERM and SIGINT set. Repeating them changes nothing: an impatient
    /// operator must not cut a controlled stop short. SIGQUIT and SIGKILL end a daemon that does
    /// not stop. Until [`Stop::begin`] the signals end the process, which has moved nothing yet.
    ///
    /// # Errors
    /// If the operating system refuses the handlers.
    pub fn by_signals() -> io::Result<Self> {
        let stop = Self::default();
        stop.is_starting.store(true, Ordering::Relaxed);
        for signal in [SIGTERM, SIGINT] {
            flag::register_conditional_default(signal, Arc::clone(&stop.is_starting))?;
            flag::register(signal, Arc::clone(&stop.is_asked))?;
        }
        Ok(stop)
    }

    /// From now on the signals only set the flag.
    pub fn begin(&self) {
        self.is_starting.store(false, Ordering::Relaxed);
    }

    /// Asks for the stop.
    pub fn ask(&self) {
        self.is_asked.store(true, Ordering::Relaxed);
    }

    /// Whether to stop. Relaxed: no other data is published with the flag.
    pub fn is_asked(&self) -> bool {
        self.is_asked.load(Ordering::Relaxed)
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
        flag::register(SIGHUP, Arc::clone(&hangup.0))?;
        Ok(hangup)
    }

    /// Whether the signal came since the last call.
    pub fn take(&self) -> bool {
        self.0.swap(false, Ordering::Relaxed)
    }
}
