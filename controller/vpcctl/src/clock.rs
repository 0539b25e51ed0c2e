//! What a command that waits knows of time: tests move it by hand.

use std::time::Duration;

/// The clock of a command that waits.
pub trait Clock {
    /// The present, CLOCK_MONOTONIC, ns.
    fn now_ns(&self) -> u64;

    /// Waits for this time.
    fn pause(&mut self, time: Duration);
}

/// The clock of the machine.
#[derive(Clone, Copy, Debug)]
pub struct Monotonic;

impl Clock for Monotonic {
    fn now_ns(&self) -> u64 {
        ipc::now_ns()
    }

    fn pause(&mut self, time: Duration) {
        std::thread::sleep(time);
    }
}

/// A span in ns.
pub fn ns(time: Duration) -> u64 {
    u64::try_from(time.as_nanos()).unwrap_or(u64::MAX)
}
