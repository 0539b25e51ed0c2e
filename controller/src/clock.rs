//! When a cycle starts: a grid of absolute releases, or each new features message.

use rustix::io::Errno;
use rustix::thread::clock_nanosleep_absolute;
use rustix::thread::{ClockId, Timespec};

/// A grid of releases on CLOCK_MONOTONIC. A release that passed while a cycle was still running is
/// skipped and counted, never caught up: two commands in a row would answer the same features.
#[derive(Clone, Copy, Debug)]
pub struct Grid {
    period_ns: u64,
    next_ns: u64,
    missed: u64,
}

impl Grid {
    /// A grid with its first release one period after `now_ns`; the period is at least 1 us.
    pub fn new(now_ns: u64, period_ns: u64) -> Self {
        let period_ns = period_ns.max(1000);
        Self {
            period_ns,
            next_ns: now_ns + period_ns,
            missed: 0,
        }
    }

    /// The next release, CLOCK_MONOTONIC, ns.
    pub fn next_ns(&self) -> u64 {
        self.next_ns
    }

    /// Releases missed since the start.
    pub fn missed(&self) -> u64 {
        self.missed
    }

    /// Ends the cycle of the present release at `now_ns`: moves on to the first release after it.
    /// Returns how many were missed.
    pub fn advance(&mut self, now_ns: u64) -> u64 {
        self.advance_by(self.period_ns, now_ns)
    }

    /// The same for a grid that moves: the next release comes `interval_ns` after the present one,
    /// the others each a period after that.
    pub fn advance_by(&mut self, interval_ns: u64, now_ns: u64) -> u64 {
        self.next_ns += interval_ns;
        let missed = match now_ns.checked_sub(self.next_ns) {
            Some(late) => late / self.period_ns + 1,
            None => 0,
        };
        self.next_ns += missed * self.period_ns;
        self.missed += missed;
        missed
    }
}

/// Sleeps until an instant of CLOCK_MONOTONIC, through signals: a cycle never starts before its
/// release.
pub fn sleep_until(deadline_ns: u64) {
    let deadline = Timespec {
        tv_sec: (deadline_ns / 1_000_000_000) as i64,
        tv_nsec: (deadline_ns % 1_000_000_000) as _,
    };
    // Any other error than an interruption: not to sleep is the better choice; the grid counts what
    // was missed.
    while clock_nanosleep_absolute(ClockId::Monotonic, &deadline) == Err(Errno::INTR) {}
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn releases_stand_on_one_grid() {
        let mut grid = Grid::new(5_000, 10_000);
        assert_eq!(grid.next_ns(), 15_000);
        assert_eq!(grid.advance(17_000), 0);
        assert_eq!(grid.next_ns(), 25_000);
    }

    #[test]
    fn missed_releases_are_counted_and_never_caught_up() {
        let mut grid = Grid::new(0, 10_000);
        // The cycle of release 10 us ends at 41 us: those of 20, 30 and 40 us are gone.
        assert_eq!(grid.advance(41_000), 3);
        assert_eq!((grid.next_ns(), grid.missed()), (50_000, 3));
        assert_eq!(grid.advance(52_000), 0);
        assert_eq!((grid.next_ns(), grid.missed()), (60_000, 3));
    }

    #[test]
    fn a_grid_that_moves_keeps_its_period_from_there_on() {
        let mut grid = Grid::new(0, 10_000);
        assert_eq!(grid.advance_by(10_200, 11_000), 0);
        assert_eq!(grid.next_ns(), 20_200);
        // 30.0 and 40.0 us are missed.
        assert_eq!(grid.advance_by(9_800, 41_000), 2);
        assert_eq!(grid.next_ns(), 50_000);
        assert_eq!(grid.advance(50_500), 0);
        assert_eq!(grid.next_ns(), 60_000);
    }

    #[test]
    fn a_cycle_that_ends_on_the_next_release_has_missed_it() {
        let mut grid = Grid::new(0, 10_000);
        assert_eq!(grid.advance(20_000), 1);
        assert_eq!(grid.next_ns(), 30_000);
    }

    /// Only too early an end is wrong: a busy machine wakes it late.
    #[test]
    #[allow(unsafe_code)]
    fn a_signal_does_not_end_a_sleep() {
        use std::os::unix::thread::JoinHandleExt;
        use std::sync::Arc;
        use std::sync::atomic::{AtomicBool, Ordering};
        use std::time::Duration;

        let seen = Arc::new(AtomicBool::new(false));
        program::set_on(libc::SIGURG, &seen).unwrap();
        let (sender, begun) = std::sync::mpsc::channel();
        let sleep = std::thread::spawn(move || {
            let deadline_ns = ipc::now_ns() + 200_000_000;
            sender.send(()).unwrap();
            sleep_until(deadline_ns);
            ipc::now_ns() >= deadline_ns
        });
        begun.recv().unwrap();
        while !sleep.is_finished() {
            // SAFETY: the thread was not joined yet.
            let sent = unsafe { libc::pthread_kill(sleep.as_pthread_t(), libc::SIGURG) };
            assert!(sent == 0 || sleep.is_finished());
            std::thread::sleep(Duration::from_millis(1));
        }
        assert!(sleep.join().unwrap() && seen.load(Ordering::Relaxed));
    }
}
