//! Counts and times of a while, for the log.

use std::fmt;
use std::time::Duration;

/// What happened since the last report.
#[derive(Clone, Debug, Default)]
pub struct Report {
    /// Frames that were searched.
    pub frames: u64,
    /// Numbers that no frame had.
    pub lost: u64,
    /// Frames by the tags that were missing: none, one, two and so on.
    pub missing: Vec<u64>,
    /// Frames in which the whole image was searched.
    pub whole: u64,
    /// From image to features, us.
    times: Vec<f64>,
}

impl Report {
    /// Counts a frame in which so many points were missing.
    pub fn add(&mut self, missing: usize, is_whole: bool, took: Duration) {
        self.frames += 1;
        self.whole += u64::from(is_whole);
        if self.missing.len() <= missing {
            self.missing.resize(missing + 1, 0);
        }
        self.missing[missing] += 1;
        self.times.push(1e6 * took.as_secs_f64());
    }

    /// A quantile of the times from image to features, us; 0 without frames.
    pub fn time_us(&self, share: f64) -> f64 {
        let mut times = self.times.clone();
        times.sort_by(f64::total_cmp);
        let last = times.len().saturating_sub(1);
        times
            .get((share * last as f64).round() as usize)
            .copied()
            .unwrap_or_default()
    }
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let whole = self.missing.first().copied().unwrap_or_default();
        write!(
            f,
            "{} frames, {} lost before they came; {} with all points, whole image searched in {}; image to features {:.0} us (p99 {:.0})",
            self.frames,
            self.lost,
            whole,
            self.whole,
            self.time_us(0.5),
            self.time_us(0.99)
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_are_counted_by_what_they_miss() {
        let mut report = Report::default();
        for missing in [0, 0, 2] {
            report.add(missing, missing > 0, Duration::from_micros(100));
        }
        assert_eq!((report.frames, report.whole), (3, 1));
        assert_eq!(report.missing, [2, 0, 1]);
        assert!((report.time_us(0.99) - 100.0).abs() < 1e-6);
    }
}
