//! The phases of a cycle and their times.

use ipc::CycleRecord;

/// A part of a cycle whose time is recorded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Phase {
    /// Waking up after the release; 0 in lockstep.
    Wake,
    /// Receiving, and the gate.
    Receive,
    /// The law.
    Step,
    /// Sending.
    Send,
    /// All between waking up and having sent: receive, step and send.
    Cycle,
}

impl Phase {
    /// All of them; an index into it is `phase as usize`.
    pub const ALL: [Self; 5] = [
        Self::Wake,
        Self::Receive,
        Self::Step,
        Self::Send,
        Self::Cycle,
    ];

    /// Its name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Wake => "wake",
            Self::Receive => "receive",
            Self::Step => "step",
            Self::Send => "send",
            Self::Cycle => "cycle",
        }
    }

    /// Its time in this cycle, ns.
    pub fn of(self, record: &CycleRecord) -> u64 {
        match self {
            Self::Wake => record.wake_latency_ns,
            Self::Receive => record.receive_ns,
            Self::Step => record.step_ns,
            Self::Send => record.send_ns,
            Self::Cycle => record
                .receive_ns
                .saturating_add(record.step_ns)
                .saturating_add(record.send_ns),
        }
    }
}

/// Upper bounds of the buckets of [`Histogram`], ns: 1, 2 and 5 in each decade from 1 us to 100 ms.
pub const BOUNDS: [u64; 16] = [
    1_000,
    2_000,
    5_000,
    10_000,
    20_000,
    50_000,
    100_000,
    200_000,
    500_000,
    1_000_000,
    2_000_000,
    5_000_000,
    10_000_000,
    20_000_000,
    50_000_000,
    100_000_000,
];

/// Counts of times since the watching began.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Histogram {
    /// Times in each bucket of [`BOUNDS`], not cumulative; the last one counts those above all bounds.
    pub counts: [u64; BOUNDS.len() + 1],
    /// Sum of all times, ns.
    pub sum_ns: u64,
}

impl Histogram {
    /// Counts a time, ns. A time equal to a bound is below it, as Prometheus counts.
    pub fn count(&mut self, time_ns: u64) {
        let bucket = BOUNDS.partition_point(|&bound| bound < time_ns);
        self.counts[bucket] += 1;
        self.sum_ns = self.sum_ns.saturating_add(time_ns);
    }

    /// How many times were counted.
    pub fn total(&self) -> u64 {
        self.counts.iter().sum()
    }
}

/// Median, 99th percentile and maximum of some times, ns.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct Times {
    /// Median, ns.
    pub p50_ns: u64,
    /// 99th percentile (nearest rank), ns.
    pub p99_ns: u64,
    /// Maximum, ns.
    pub max_ns: u64,
}

impl Times {
    /// Of these times, ns; zeros where there are none.
    pub fn of(times: impl Iterator<Item = u64>) -> Self {
        let mut sorted: Vec<u64> = times.collect();
        sorted.sort_unstable();
        let rank = |percent: usize| {
            let place = (sorted.len() * percent).div_ceil(100).max(1) - 1;
            sorted.get(place).copied().unwrap_or(0)
        };
        Self {
            p50_ns: rank(50),
            p99_ns: rank(99),
            max_ns: rank(100),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percentiles_are_nearest_ranks() {
        let times = Times::of(1..=100);
        assert_eq!((times.p50_ns, times.p99_ns, times.max_ns), (50, 99, 100));
        let few = Times::of(1..=10);
        assert_eq!((few.p50_ns, few.p99_ns), (5, 10));
        let one = Times::of(std::iter::once(7));
        assert_eq!((one.p50_ns, one.p99_ns, one.max_ns), (7, 7, 7));
        assert_eq!(Times::of(std::iter::empty()), Times::default());
    }

    #[test]
    fn a_time_on_a_bound_belongs_below_it() {
        let mut histogram = Histogram::default();
        for time in [1_000, 1_001, u64::MAX] {
            histogram.count(time);
        }
        assert_eq!(histogram.counts[0], 1);
        assert_eq!(histogram.counts[1], 1);
        assert_eq!(histogram.counts[BOUNDS.len()], 1);
        assert_eq!(histogram.total(), 3);
    }

    #[test]
    fn every_phase_has_the_index_of_its_place() {
        for (index, phase) in Phase::ALL.into_iter().enumerate() {
            assert_eq!(phase as usize, index);
        }
    }
}
