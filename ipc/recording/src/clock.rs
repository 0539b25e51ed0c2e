//! Monotonic time, as in messages, to wall time, as in recordings.

use std::time::{Duration, SystemTime, UNIX_EPOCH};

use rustix::time::{ClockId, clock_gettime};

/// Readings of both clocks taken together. All stamps of a recording are translated by the same
/// difference, so that intervals stay exact even if the wall clock jumps.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct WallClock {
    /// CLOCK_MONOTONIC, ns.
    pub monotonic_ns: u64,
    /// CLOCK_REALTIME at the same moment, ns since 1970.
    pub wall_ns: u64,
}

impl WallClock {
    /// Reads both clocks.
    pub fn now() -> Self {
        let ns = |since: Duration| since.as_nanos() as u64;
        let monotonic = Duration::try_from(clock_gettime(ClockId::Monotonic));
        let wall = SystemTime::now().duration_since(UNIX_EPOCH);
        Self {
            // It starts at 0 when the machine does.
            monotonic_ns: monotonic.map_or(0, ns),
            // A machine that believes in a year before 1970 gets recordings from 1970.
            wall_ns: wall.map_or(0, ns),
        }
    }

    /// The wall time of a monotonic stamp, ns since 1970.
    pub fn wall_of(self, monotonic_ns: u64) -> u64 {
        let since = monotonic_ns.wrapping_sub(self.monotonic_ns) as i64;
        self.wall_ns.saturating_add_signed(since)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn intervals_stay_as_they_were() {
        let clock = WallClock {
            monotonic_ns: 1_000,
            wall_ns: 5_000_000,
        };
        assert_eq!(clock.wall_of(1_000), 5_000_000);
        assert_eq!(clock.wall_of(1_777), 5_000_777);
        assert_eq!(clock.wall_of(400), 4_999_400);
    }
}
