//! Durations in fixed buckets: eight for each doubling, so that a percentile is right to 13 %.

use crate::report::Percentiles;

/// Buckets for each doubling.
const PER_OCTAVE: usize = 8;
/// From 1 ns to 2^40 ns, 18 minutes.
const BUCKETS: usize = 40 * PER_OCTAVE;

/// A histogram of durations.
#[derive(Clone, Debug)]
pub struct Histogram {
    buckets: [u64; BUCKETS],
    count: u64,
    max_ns: u64,
}

impl Default for Histogram {
    fn default() -> Self {
        Self {
            buckets: [0; BUCKETS],
            count: 0,
            max_ns: 0,
        }
    }
}

impl Histogram {
    /// Adds a duration, ns.
    pub fn add(&mut self, ns: u64) {
        let bucket = ((ns.max(1) as f64).log2() * PER_OCTAVE as f64) as usize;
        self.buckets[bucket.min(BUCKETS - 1)] += 1;
        self.count += 1;
        self.max_ns = self.max_ns.max(ns);
    }

    /// The duration (ns) that this share (0 to 1) of all durations does not exceed: upper edge of
    /// its bucket.
    pub fn quantile(&self, share: f64) -> u64 {
        let rank = (share * self.count as f64).ceil() as u64;
        let mut seen = 0;
        for (bucket, count) in self.buckets.iter().enumerate() {
            seen += count;
            if seen >= rank {
                let edge = 2_f64.powf((bucket + 1) as f64 / PER_OCTAVE as f64);
                return (edge as u64).min(self.max_ns);
            }
        }
        self.max_ns
    }

    /// The percentiles of a report, ns.
    pub fn percentiles(&self) -> Percentiles {
        Percentiles {
            p50: self.quantile(0.5),
            p99: self.quantile(0.99),
            p999: self.quantile(0.999),
            max: self.max_ns,
        }
    }

    /// The longest duration, ns.
    pub fn max_ns(&self) -> u64 {
        self.max_ns
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_are_right_to_a_bucket() {
        let mut histogram = Histogram::default();
        (1..=1000).for_each(|us| histogram.add(us * 1000));
        for (share, exact) in [(0.5, 500_000.0), (0.99, 990_000.0)] {
            let ratio = histogram.quantile(share) as f64 / exact;
            assert!((1.0..1.14).contains(&ratio), "{share}: {ratio}");
        }
        assert_eq!(
            (histogram.quantile(1.0), histogram.max_ns()),
            (1_000_000, 1_000_000)
        );
    }

    #[test]
    fn an_empty_histogram_says_zero() {
        assert_eq!(Histogram::default().quantile(0.99), 0);
    }
}
