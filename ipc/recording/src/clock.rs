//! From the monotonic clock, which the contract uses, to the wall clock, which recordings are shown by.

use std::time::{SystemTime, UNIX_EPOCH};

/// A pair of readings taken together; every stamp of a recording is translated by the same difference, so that
/// intervals stay exact whatever the wall clock does later.
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
        let wall = SystemTime::now().duration_since(UNIX_EPOCH);
        Self {
            monotonic_ns: ipc::now_ns(),
            // A machine that believes in a year before 1970 gets recordings from 1970.
            wall_ns: wall.map_or(0, |since| since.as_nanos() as u64),
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
