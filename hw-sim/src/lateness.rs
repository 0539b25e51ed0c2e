//! How late a loop wakes up.

use serde::Serialize;

/// The lateness of each wake-up, us.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Lateness(Vec<f64>);

/// Percentiles, us.
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

impl Lateness {
    /// A wake-up that was late by this, ns.
    pub fn add(&mut self, ns: u64) {
        self.0.push(ns as f64 / 1e3);
    }

    /// Percentiles by rank.
    pub fn report(&self) -> LatenessReport {
        let mut sorted = self.0.clone();
        sorted.sort_unstable_by(f64::total_cmp);
        let at = |share: f64| program::quantile(&sorted, share);
        LatenessReport {
            count: sorted.len() as u64,
            p50_us: at(0.5),
            p99_us: at(0.99),
            max_us: at(1.0),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percentiles_are_those_of_the_ranks() {
        let mut lateness = Lateness::default();
        (1..=1000).for_each(|k| lateness.add(k * 1000));
        let report = lateness.report();
        assert_eq!(report.count, 1000);
        assert_eq!(
            (report.p50_us, report.p99_us, report.max_us),
            (500.0, 990.0, 1000.0)
        );
        lateness.add(3_000_000_000);
        assert_eq!(lateness.report().max_us, 3e6);
        assert_eq!(Lateness::default().report().p99_us, 0.0);
    }
}
