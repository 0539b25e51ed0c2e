//! What is counted, for the log and for Prometheus.

use std::collections::VecDeque;
use std::fmt::Write;
use std::time::Duration;

use crate::mask_check::Counts;
use crate::run::Report;

/// Durations that are kept for percentiles: the newest.
const KEPT: usize = 1 << 14;

/// Counts since the start.
#[derive(Clone, Debug)]
pub struct Metrics {
    numbers: Vec<u32>,
    /// Images that became features.
    pub frames: u64,
    /// Frames that never came.
    pub lost: u64,
    /// Images in which a tag was missing.
    pub incomplete: u64,
    /// Images of which all was looked at.
    pub whole: u64,
    /// By tag: images in which it was missing.
    missing: Vec<u64>,
    /// How often tags contradicted the scene's occlusions.
    mask: Counts,
    took: Durations,
    age: Durations,
}

impl Metrics {
    /// Counts for tags of these numbers.
    pub fn new(numbers: &[u32]) -> Self {
        Self {
            numbers: numbers.to_vec(),
            frames: 0,
            lost: 0,
            incomplete: 0,
            whole: 0,
            missing: vec![0; numbers.len()],
            mask: Counts::default(),
            took: Durations::default(),
            age: Durations::default(),
        }
    }

    /// Adds a frame.
    pub fn add(&mut self, report: &Report) {
        self.frames += 1;
        self.lost += report.lost;
        self.whole += u64::from(report.found.is_whole);
        let mut is_incomplete = false;
        for (bit, missing) in self.missing.iter_mut().enumerate() {
            let is_missing = report.found.visible >> bit & 1 == 0;
            *missing += u64::from(is_missing);
            is_incomplete |= is_missing;
        }
        self.incomplete += u64::from(is_incomplete);
        self.mask = report.mask;
        self.took.add(report.took);
        self.age.add(report.age);
    }

    /// One line for the log.
    pub fn line(&self) -> String {
        let ms = |duration: Duration| 1e3 * duration.as_secs_f64();
        let mut line = format!(
            "frames={} lost={} incomplete={} whole={} detection_ms_p50={:.2} p99={:.2} age_ms_p50={:.1} p99={:.1}",
            self.frames,
            self.lost,
            self.incomplete,
            self.whole,
            ms(self.took.quantile(0.5)),
            ms(self.took.quantile(0.99)),
            ms(self.age.quantile(0.5)),
            ms(self.age.quantile(0.99)),
        );
        for (number, missing) in self.numbers.iter().zip(&self.missing) {
            if *missing > 0 {
                let _ = write!(line, " missing_{number}={missing}");
            }
        }
        line
    }

    /// The text format of Prometheus, 0.0.4.
    pub fn text(&self) -> String {
        let mut text = String::new();
        let mut family = |kind: &str, name: &str, help: &str, samples: &[(String, f64)]| {
            let name = format!("vpc_camera_{name}");
            let _ = writeln!(text, "# HELP {name} {help}\n# TYPE {name} {kind}");
            for (labels, value) in samples {
                let _ = writeln!(text, "{name}{labels} {value}");
            }
        };
        let none = |count: u64| [(String::new(), count as f64)];
        for (name, help, count) in [
            ("frames_total", "Images that became features.", self.frames),
            ("lost_frames_total", "Frames that never came.", self.lost),
            (
                "incomplete_frames_total",
                "Images in which a tag was missing.",
                self.incomplete,
            ),
            (
                "whole_searches_total",
                "Images of which all was looked at.",
                self.whole,
            ),
            (
                "vanished_tags_total",
                "Tags that vanished where no occlusion of the scene hides them.",
                self.mask.vanished,
            ),
            (
                "seen_through_total",
                "Tags that were seen where an occlusion of the scene covers them.",
                self.mask.seen_through,
            ),
        ] {
            family("counter", name, help, &none(count));
        }
        let missing = self.numbers.iter().zip(&self.missing);
        let missing =
            missing.map(|(number, count)| (format!("{{tag=\"{number}\"}}"), *count as f64));
        let missing: Vec<_> = missing.collect();
        family(
            "counter",
            "missing_tags_total",
            "Images in which the tag was missing.",
            &missing,
        );
        for (name, help, durations) in [
            (
                "detection_seconds",
                "From an image to its features.",
                &self.took,
            ),
            (
                "age_seconds",
                "From the middle of the exposure to the features.",
                &self.age,
            ),
        ] {
            let quantiles = [0.5, 0.99].map(|share| {
                let seconds = durations.quantile(share).as_secs_f64();
                (format!("{{quantile=\"{share}\"}}"), seconds)
            });
            family("gauge", name, help, &quantiles);
        }
        text
    }
}

/// The newest durations.
#[derive(Clone, Debug, Default)]
struct Durations {
    ring: VecDeque<Duration>,
}

impl Durations {
    fn add(&mut self, duration: Duration) {
        if self.ring.len() == KEPT {
            self.ring.pop_front();
        }
        self.ring.push_back(duration);
    }

    /// The duration that this share of them does not exceed.
    fn quantile(&self, share: f64) -> Duration {
        let mut sorted = Vec::from(self.ring.clone());
        sorted.sort_unstable();
        program::quantile(&sorted, share)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::finder::Found;

    #[test]
    fn frames_are_counted() {
        let mut metrics = Metrics::new(&[3, 5]);
        for n in 1..=200_u64 {
            metrics.add(&Report {
                sequence: n,
                lost: u64::from(n == 7),
                data_ns: 1,
                found: Found {
                    visible: if n % 4 == 0 { 0b01 } else { 0b11 },
                    ..Found::default()
                },
                mask: Counts {
                    vanished: 2,
                    seen_through: 0,
                },
                took: Duration::from_millis(n),
                age: Duration::from_millis(2 * n),
            });
        }
        let line = metrics.line();
        for words in [
            "frames=200 lost=1 incomplete=50",
            "p50=100.00 p99=198.00",
            "missing_5=50",
        ] {
            assert!(line.contains(words), "{line}");
        }
        assert!(!line.contains("missing_3"), "{line}");
        let text = metrics.text();
        for words in [
            "# TYPE vpc_camera_frames_total counter\nvpc_camera_frames_total 200\n",
            "vpc_camera_vanished_tags_total 2\n",
            "vpc_camera_missing_tags_total{tag=\"5\"} 50\n",
            "vpc_camera_detection_seconds{quantile=\"0.99\"} 0.198\n",
            "vpc_camera_age_seconds{quantile=\"0.5\"} 0.2\n",
        ] {
            assert!(text.contains(words), "{text}");
        }
    }

    #[test]
    fn the_oldest_durations_are_forgotten() {
        let mut durations = Durations::default();
        assert_eq!(durations.quantile(0.5), Duration::ZERO);
        (0..KEPT).for_each(|_| durations.add(Duration::from_secs(9)));
        (0..KEPT).for_each(|_| durations.add(Duration::from_secs(1)));
        assert_eq!(durations.quantile(1.0), Duration::from_secs(1));
    }
}
