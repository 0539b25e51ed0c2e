//! Signals: SIGTERM and SIGINT end the daemon, SIGHUP is noted.

use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use program::StartUp;
use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};

/// Set once the daemon is to stop.
#[derive(Clone, Debug, Default)]
pub struct Stop(Arc<AtomicBool>);

impl Stop {
    /// A stop flag that SIGTERM and SIGINT set. Repeating them changes nothing: an impatient
    /// operator must not cut a controlled stop short. SIGQUIT and SIGKILL end a daemon that does
    /// not stop. Until [`StartUp`] is dropped the signals end the process, which has moved nothing
    /// yet.
    ///
    /// # Errors
    /// If the operating system refuses the handlers.
    pub fn by_signals() -> io::Result<(StartUp, Self)> {
        let signals = [SIGTERM, SIGINT];
        let (start_up, stop) = (StartUp::on(signals)?, Self::default());
        for signal in signals {
            program::set_on(signal, &stop.0)?;
        }
        Ok((start_up, stop))
    }

    /// Asks for the stop.
    pub fn ask(&self) {
        self.0.store(true, Ordering::Relaxed);
    }

    /// Whether to stop. Relaxed: no other data is published with the flag.
    pub fn is_asked(&self) -> bool {
        self.0.load(Ordering::Relaxed)
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
