//! The stages of a cycle and statistics of their durations.

use messages::CycleRecord;
use program::quantile;
use serde::Serialize;

/// The stages of a cycle: waking up after the release (0 in lockstep), receiving and checking,
/// deciding, sending; and all from waking up to having sent.
pub const STAGES: [&str; 5] = ["wake", "receive", "step", "send", "cycle"];
/// Index of the wake-up latency in [`STAGES`].
pub const WAKE: usize = 0;
/// Index of the whole cycle in [`STAGES`].
pub const CYCLE: usize = 4;

/// The duration of each of [`STAGES`] in this cycle, ns.
pub fn durations(record: &CycleRecord) -> [u64; STAGES.len()] {
    let (receive, step, send) = (record.receive_ns, record.step_ns, record.send_ns);
    let cycle = receive.saturating_add(step).saturating_add(send);
    [record.wake_latency_ns, receive, step, send, cycle]
}

/// Upper bounds of the buckets of [`Histogram`], ns: 1, 2 and 5 in each decade from 1 us to 100 ms.
pub const BOUNDS: [u64; 16] = {
    let mut bounds = [1_000; 16];
    let mut i = 1;
    while i < bounds.len() {
        bounds[i] = if i % 3 == 2 {
            bounds[i - 1] / 2 * 5
        } else {
            bounds[i - 1] * 2
        };
        i += 1;
    }
    bounds
};

/// Durations since the start of watching, counted.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Histogram {
    /// Count of each bucket of [`BOUNDS`], not cumulative; the last one is above all bounds.
    pub counts: [u64; BOUNDS.len() + 1],
    /// Sum of all durations, ns.
    pub sum_ns: u64,
}

impl Histogram {
    /// Counts a duration, ns. One that equals a bound is below it, as Prometheus counts.
    pub fn count(&mut self, ns: u64) {
        let bucket = BOUNDS.partition_point(|&bound| bound < ns);
        self.counts[bucket] += 1;
        self.sum_ns = self.sum_ns.saturating_add(ns);
    }
}

/// Percentiles of durations, ns, by nearest rank.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[allow(missing_docs)]
pub struct Percentiles {
    pub p50_ns: u64,
    pub p99_ns: u64,
    pub max_ns: u64,
}

impl Percentiles {
    /// Of these durations, ns; zeros if there are none.
    pub fn of(durations: impl Iterator<Item = u64>) -> Self {
        let mut sorted: Vec<u64> = durations.collect();
        sorted.sort_unstable();
        Self {
            p50_ns: quantile(&sorted, 0.5),
            p99_ns: quantile(&sorted, 0.99),
            max_ns: quantile(&sorted, 1.0),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percentiles_are_nearest_ranks() {
        let of_100 = Percentiles::of(1..=100);
        assert_eq!((of_100.p50_ns, of_100.p99_ns, of_100.max_ns), (50, 99, 100));
        let few = Percentiles::of(1..=10);
        assert_eq!((few.p50_ns, few.p99_ns), (5, 10));
        let one = Percentiles::of(std::iter::once(7));
        assert_eq!((one.p50_ns, one.p99_ns, one.max_ns), (7, 7, 7));
        assert_eq!(Percentiles::of(std::iter::empty()), Percentiles::default());
    }

    #[test]
    fn bounds_are_round_and_a_duration_on_one_belongs_below_it() {
        assert_eq!(BOUNDS[..4], [1_000, 2_000, 5_000, 10_000]);
        assert_eq!(BOUNDS.last(), Some(&100_000_000));
        let mut histogram = Histogram::default();
        for ns in [1_000, 1_001, u64::MAX] {
            histogram.count(ns);
        }
        assert_eq!(histogram.counts[..2], [1, 1]);
        assert_eq!(histogram.counts[BOUNDS.len()], 1);
    }

    #[test]
    fn the_cycle_is_the_sum_of_what_follows_the_wake_up() {
        let record = CycleRecord {
            wake_latency_ns: 1,
            receive_ns: 20,
            step_ns: 300,
            send_ns: 4000,
            ..CycleRecord::default()
        };
        let durations = durations(&record);
        assert_eq!((durations[WAKE], durations[CYCLE]), (1, 4320));
    }
}
