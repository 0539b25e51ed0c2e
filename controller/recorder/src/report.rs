//! How long the cycles of a recording took.

use std::fmt;

use messages::{ClockMode, CycleRecord, TwistState};
use program::quantile;
use serde::Serialize;

use recording::Recording;

/// Widest bar of the text's histograms, characters.
const BAR: usize = 40;

/// Latencies and misses of a recording.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Report {
    /// Cycles recorded.
    pub cycles: u64,
    /// From the first wake-up to the last, s.
    pub duration_s: f64,
    /// Cycles missing in the file, by the sequence numbers.
    pub missing_cycles: u64,
    /// Records lost in the daemon.
    pub lost_records: u64,
    /// Releases missed: deadlines that were not kept.
    pub overruns: u64,
    /// False in lockstep, where nothing can be late.
    pub has_deadlines: bool,
    /// Median time between wake-ups, ms.
    pub period_ms: f64,
    /// Cycles in each state, by its name.
    pub states: Vec<(String, u64)>,
    /// The stages of a cycle in order, their sum, and the age of the features at wake-up.
    pub stages: Vec<StageTimes>,
    /// Why reading ended before the end of the file.
    pub cut: Option<String>,
}

/// Times of one stage.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct StageTimes {
    /// `wake`, `receive` and so on.
    pub name: &'static str,
    /// Cycles that had it.
    pub count: u64,
    /// Mean, us.
    pub mean_us: f64,
    /// Median, us.
    pub p50_us: f64,
    /// Exceeded by one in ten, us.
    pub p90_us: f64,
    /// Exceeded by one in a hundred, us.
    pub p99_us: f64,
    /// Exceeded by one in a thousand, us.
    pub p999_us: f64,
    /// Longest, us.
    pub max_us: f64,
    /// Upper end (us; 1, 2, 5, 10, 20, ...) and count of each bar.
    pub histogram: Vec<(f64, u64)>,
    /// The times, us, in the order of the cycles.
    #[serde(skip)]
    pub values_us: Vec<f64>,
}

/// Reads a time of a cycle, ns.
type Clocked = fn(&CycleRecord) -> Option<u64>;

/// The stages of a cycle.
const STAGES: [(&str, Clocked); 6] = [
    ("wake", |c| (!is_lockstep(c)).then_some(c.wake_latency_ns)),
    ("receive", |c| Some(c.receive_ns)),
    // Without features no step was computed.
    ("step", |c| (c.status != 0).then_some(c.step_ns)),
    ("send", |c| Some(c.send_ns)),
    ("wake to sent", |c| {
        Some(c.wake_latency_ns + c.receive_ns + c.step_ns + c.send_ns)
    }),
    ("age of features", |c| {
        (c.features_sequence != 0).then_some(c.features_age_ns)
    }),
];

fn is_lockstep(cycle: &CycleRecord) -> bool {
    cycle.clock == ClockMode::Lockstep.code()
}

impl Report {
    /// The report as JSON, indented.
    pub fn to_json(&self) -> String {
        // Only keys that are not strings and broken writers fail, and there are none.
        serde_json::to_string_pretty(self).unwrap_or_default() + "\n"
    }

    /// The report of a recording.
    pub fn of(recording: &Recording) -> Self {
        let cycles = &recording.cycles;
        let wakes = cycles.iter().map(|cycle| cycle.stamp.data_ns);
        let (first, last) = (wakes.clone().min(), wakes.max());
        let span = last.unwrap_or(0) - first.unwrap_or(0);
        let mut gaps: Vec<f64> = cycles
            .windows(2)
            .filter(|pair| pair[1].cycle == pair[0].cycle.wrapping_add(1))
            .map(|pair| us(pair[1].stamp.data_ns.saturating_sub(pair[0].stamp.data_ns)) / 1e3)
            .collect();
        gaps.sort_by(f64::total_cmp);
        // A counter falls where the daemon was restarted.
        let growth = |count: fn(&CycleRecord) -> u64| -> u64 {
            let pairs = cycles.windows(2);
            pairs
                .map(|pair| count(&pair[1]).saturating_sub(count(&pair[0])))
                .sum()
        };
        let mut states = Vec::new();
        for state in (0..16).filter_map(TwistState::from_code) {
            let count = cycles.iter().filter(|c| c.state == state.code()).count();
            if count > 0 {
                states.push((state.to_string(), count as u64));
            }
        }
        Self {
            cycles: cycles.len() as u64,
            duration_s: rounded(span as f64 / 1e9),
            missing_cycles: Recording::missing(cycles),
            lost_records: growth(|cycle| cycle.lost_records),
            overruns: growth(|cycle| cycle.overruns),
            has_deadlines: cycles.iter().any(|cycle| !is_lockstep(cycle)),
            period_ms: rounded(quantile(&gaps, 0.5)),
            states,
            stages: STAGES
                .iter()
                .map(|(name, clocked)| {
                    let times = cycles.iter().filter_map(clocked).map(us);
                    StageTimes::of(name, times.collect())
                })
                .filter(|stage| stage.count > 0)
                .collect(),
            cut: recording.cut.clone(),
        }
    }
}

/// The report as text: a table, then a histogram of each stage.
impl fmt::Display for Report {
    fn fmt(&self, to: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            to,
            "{} cycles in {:.1} s, period {:.2} ms",
            self.cycles, self.duration_s, self.period_ms
        )?;
        if self.has_deadlines {
            let releases = self.cycles + self.overruns + self.missing_cycles;
            let share = 100.0 * self.overruns as f64 / releases.max(1) as f64;
            writeln!(to, "deadlines missed: {} ({share:.3} %)", self.overruns)?;
        } else {
            writeln!(to, "lockstep: no deadlines")?;
        }
        writeln!(
            to,
            "records missing: {} in this file, {} lost in the daemon",
            self.missing_cycles, self.lost_records
        )?;
        for (state, count) in &self.states {
            writeln!(to, "{state}: {count} cycles")?;
        }
        if let Some(cut) = &self.cut {
            writeln!(to, "the file is cut short: {cut}")?;
        }
        writeln!(
            to,
            "\n{:<16} {:>8} {:>10} {:>10} {:>10} {:>10} {:>10} {:>10}",
            "us", "count", "mean", "p50", "p90", "p99", "p99.9", "max"
        )?;
        for stage in &self.stages {
            let row = [
                stage.mean_us,
                stage.p50_us,
                stage.p90_us,
                stage.p99_us,
                stage.p999_us,
                stage.max_us,
            ];
            write!(to, "{:<16} {:>8}", stage.name, stage.count)?;
            for us in row {
                write!(to, " {us:>10.1}")?;
            }
            writeln!(to)?;
        }
        for stage in &self.stages {
            writeln!(to, "\n{}", stage.name)?;
            let most = stage.histogram.iter().map(|(_, n)| *n).max().unwrap_or(1);
            for (end, count) in &stage.histogram {
                let bar = "#".repeat((*count as usize * BAR).div_ceil(most.max(1) as usize));
                writeln!(to, "  up to {end:>9} us {count:>8} {bar}")?;
            }
        }
        Ok(())
    }
}

impl StageTimes {
    fn of(name: &'static str, values_us: Vec<f64>) -> Self {
        let mut sorted = values_us.clone();
        sorted.sort_by(f64::total_cmp);
        let mut histogram: Vec<(f64, u64)> = Vec::new();
        for value in &sorted {
            let end = round_up(*value);
            match histogram.last_mut() {
                Some((last, count)) if *last == end => *count += 1,
                _ => histogram.push((end, 1)),
            }
        }
        Self {
            name,
            count: sorted.len() as u64,
            mean_us: rounded(sorted.iter().sum::<f64>() / sorted.len().max(1) as f64),
            p50_us: quantile(&sorted, 0.5),
            p90_us: quantile(&sorted, 0.9),
            p99_us: quantile(&sorted, 0.99),
            p999_us: quantile(&sorted, 0.999),
            max_us: sorted.last().copied().unwrap_or(0.0),
            histogram,
            values_us,
        }
    }
}

fn us(ns: u64) -> f64 {
    ns as f64 / 1e3
}

/// The least of 0.1, 0.2, 0.5, 1, 2, 5, ... that a time does not exceed, us.
fn round_up(us: f64) -> f64 {
    // Whole nanoseconds are exact, and below 2^64 there are at most 18 tenfolds of three steps.
    let mut end_ns = 100_u64;
    for step in 0..51 {
        if us * 1e3 <= end_ns as f64 {
            break;
        }
        end_ns = match step % 3 {
            1 => end_ns / 2 * 5,
            _ => end_ns * 2,
        };
    }
    end_ns as f64 / 1e3
}

/// Rounds to three digits after the point: times are whole nanoseconds, and their means are no
/// better.
fn rounded(x: f64) -> f64 {
    (x * 1e3).round() / 1e3
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn histograms_end_at_round_numbers() {
        for (us, end) in [
            (0.0, 0.1),
            (0.3, 0.5),
            (1.0, 1.0),
            (1.1, 2.0),
            (33_333.0, 50_000.0),
        ] {
            assert_eq!(round_up(us), end, "{us}");
        }
        let stage = StageTimes::of("step", vec![7.0, 3.0, 4.0, 180.0]);
        assert_eq!(stage.histogram, [(5.0, 2), (10.0, 1), (200.0, 1)]);
    }

    #[test]
    fn misses_are_what_the_counter_grew_by_also_over_a_restart() {
        let cycle = |sequence, cycle, overruns| {
            let mut record = CycleRecord {
                cycle,
                overruns,
                status: 1,
                ..CycleRecord::default()
            };
            record.stamp.sequence = sequence;
            record.stamp.data_ns = 33_000_000 * sequence;
            record
        };
        let recording = Recording {
            // Numbers 4 and 5 are missing; then the daemon starts again.
            cycles: vec![
                cycle(2, 2, 7),
                cycle(3, 3, 9),
                cycle(6, 6, 10),
                cycle(1, 1, 0),
                cycle(2, 2, 1),
            ],
            ..Recording::default()
        };
        let report = Report::of(&recording);
        assert_eq!((report.overruns, report.missing_cycles), (4, 2));
        assert_eq!(report.period_ms, 33.0);
        assert!(report.to_string().contains("deadlines missed: 4"));
    }
}
