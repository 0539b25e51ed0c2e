//! How late a loop wakes up: a histogram that never grows.

use serde::Serialize;

/// Width of a bin, ns.
const BIN_NS: u64 = 5_000;
/// Bins; the last one takes everything beyond.
const BINS: usize = 4000;

/// Counts of lateness.
#[derive(Clone, Debug, PartialEq)]
pub struct Lateness {
    bins: Vec<u64>,
    count: u64,
    most_ns: u64,
}

/// What the counts come to, us.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct LatenessReport {
    /// Wake-ups.
    pub count: u64,
    /// Median.
    pub p50_us: f64,
    /// 99th percentile.
    pub p99_us: f64,
    /// Maximum.
    pub max_us: f64,
}

impl Default for Lateness {
    fn default() -> Self {
        Self {
            bins: vec![0; BINS],
            count: 0,
            most_ns: 0,
        }
    }
}

impl Lateness {
    /// A wake-up that was late by this, ns.
    pub fn add(&mut self, ns: u64) {
        let bin = ((ns / BIN_NS) as usize).min(BINS - 1);
        self.bins[bin] += 1;
        self.count += 1;
        self.most_ns = self.most_ns.max(ns);
    }

    /// Percentiles, each the upper end of its bin (5 us wide), the maximum at most.
    pub fn report(&self) -> LatenessReport {
        LatenessReport {
            count: self.count,
            p50_us: self.at(0.5),
            p99_us: self.at(0.99),
            max_us: self.most_ns as f64 * 1e-3,
        }
    }

    fn at(&self, share: f64) -> f64 {
        let wanted = (share * self.count as f64).ceil() as u64;
        let mut seen = 0;
        for (bin, count) in self.bins.iter().enumerate() {
            seen += count;
            if seen >= wanted && bin + 1 < BINS {
                let end = (bin as u64 + 1) * BIN_NS;
                return end.min(self.most_ns) as f64 * 1e-3;
            }
        }
        self.most_ns as f64 * 1e-3
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percentiles_are_exact_to_a_bin() {
        let mut lateness = Lateness::default();
        (1..=1000).for_each(|k| lateness.add(k * 1000));
        let report = lateness.report();
        assert_eq!(report.count, 1000);
        assert!((report.p50_us - 500.0).abs() <= 5.0);
        assert!((report.p99_us - 990.0).abs() <= 5.0);
        assert_eq!(report.max_us, 1000.0);
    }

    #[test]
    fn what_is_beyond_all_bins_is_the_maximum() {
        let mut lateness = Lateness::default();
        lateness.add(3_000_000_000);
        assert_eq!(lateness.report().p99_us, 3e6);
        assert_eq!(Lateness::default().report().p99_us, 0.0);
    }
}
