//! A row of the table: statistics over all runs of one strategy.

use hw_sim::following::FollowingReport;
use serde::Serialize;

use crate::column::{self, Column, Shown};
use crate::run::{Reason, Run};
use crate::statistics::{mean, wilson};

/// The paper's Table I for one strategy, and what the paper does not show.
#[derive(Clone, Debug, Serialize)]
pub struct Row {
    /// Name of the strategy, or an external method.
    pub strategy: String,
    /// Steps previewed; an external method tells nothing of them.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub np: Option<usize>,
    /// Share of successful runs, 0 to 1.
    pub success_rate: f64,
    /// Its 95 % interval (Wilson).
    pub success_interval: [f64; 2],
    /// Mean running cost over Np of all runs.
    pub mean_cost: f64,
    /// Time of a cycle of the law.
    pub cycle_us: CycleTime,
    /// Time of foresight after it; zeros without.
    pub slack_us: CycleTime,
    /// Mean time of a simulated step, us; 0 without.
    pub simulated_us: f64,
    /// The deepest that a point was inside an occlusion or outside the image at any of twelve
    /// instants a period, px.
    pub deepest_px: f64,
    /// Runs with a violated constraint (or a point lost).
    pub violations: usize,
    /// Runs that did not arrive in time.
    pub not_converged: usize,
    /// Runs in which the daemon disarmed, or sent a command beyond the limits.
    pub faults: usize,
    /// Mean change of the command from one period to the next after arrival, as a share of the
    /// limit; 0 if no run arrived.
    pub change: f64,
    /// Mean iterations of the solver a cycle.
    pub iterations: f64,
    /// Share of cycles in which the solver did not converge, 0 to 1.
    pub solver_not_converged: f64,
    /// Mean cycles to arrival of the successful runs: features within the threshold, as the paper's
    /// referee has it.
    pub steps: f64,
    /// Mean time to standstill at the goal of the runs that came to it, s.
    pub standstill_s: f64,
    /// Greatest error of the pose at the end of the successful runs, mm and mrad.
    pub pose_error: [f64; 2],
    /// How well the successful runs followed, all their frames together.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub following: Option<FollowingReport>,
    /// Whether that was asked for.
    #[serde(skip)]
    pub is_following: bool,
}

/// Times of a cycle, us.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct CycleTime {
    /// Mean.
    pub mean: f64,
    /// Median.
    pub p50: f64,
    /// 99th percentile.
    pub p99: f64,
    /// Maximum.
    pub max: f64,
}

impl CycleTime {
    fn of(mut times: Vec<f64>) -> Self {
        times.sort_by(f64::total_cmp);
        let at = |share| program::quantile(&times, share);
        let mean = times.iter().sum::<f64>() / times.len().max(1) as f64;
        Self {
            mean,
            p50: at(0.5),
            p99: at(0.99),
            max: at(1.0),
        }
    }
}

impl Row {
    /// The row of a strategy's runs, or of an external method's without `np`, which shows how well
    /// they followed if it `is_following`.
    pub fn of(strategy: String, np: Option<usize>, runs: &[Run], is_following: bool) -> Self {
        let count = runs.len().max(1) as f64;
        let cycles: Vec<f64> = runs
            .iter()
            .flat_map(|run| run.cycles_us.iter().copied())
            .collect();
        let slack = runs.iter().flat_map(|run| run.slack_us.iter().copied());
        let slack: Vec<f64> = slack.collect();
        let simulated: u64 = runs.iter().map(|run| run.simulated).sum();
        let simulated_us = match simulated {
            0 => 0.0,
            count => slack.iter().sum::<f64>() / count as f64,
        };
        let least = runs
            .iter()
            .map(|run| run.least_clearance_px.min(run.least_between_px));
        let per_cycle = |total: u64| total as f64 / cycles.len().max(1) as f64;
        let successes = runs.iter().filter(|run| run.success).count();
        let because = |reasons: &[Reason]| {
            runs.iter()
                .filter(|run| run.reason.is_some_and(|r| reasons.contains(&r)))
                .count()
        };
        let steps: usize = runs
            .iter()
            .filter(|run| run.success)
            .map(|run| run.steps)
            .sum();
        Self {
            strategy,
            np,
            success_rate: successes as f64 / count,
            success_interval: wilson(successes, runs.len()),
            mean_cost: runs.iter().map(|run| run.cost).sum::<f64>() / count,
            violations: because(&[Reason::Violation, Reason::LostSight]),
            not_converged: because(&[Reason::NotConverged]),
            faults: because(&[Reason::Disarmed, Reason::BeyondLimits]),
            change: mean(runs.iter().filter_map(|run| run.change)).unwrap_or(0.0),
            iterations: per_cycle(runs.iter().map(|run| run.iterations).sum()),
            solver_not_converged: per_cycle(runs.iter().map(|run| run.not_converged).sum()),
            steps: steps as f64 / successes.max(1) as f64,
            standstill_s: mean(runs.iter().filter_map(|run| run.standstill_s)).unwrap_or(0.0),
            pose_error: (runs.iter().filter_map(|run| run.pose_error))
                .fold([0.0; 2], |most, error| {
                    [0, 1].map(|k| error[k].max(most[k]))
                }),
            cycle_us: CycleTime::of(cycles),
            slack_us: CycleTime::of(slack),
            simulated_us,
            deepest_px: -least.fold(0.0, f64::min),
            following: FollowingReport::of(runs.iter().filter_map(|run| run.following.as_ref())),
            is_following,
        }
    }
}

const IS_FOLLOWING: Shown<Row> = |_, row| row.is_following;
const SHOWS_MORE: Shown<Row> = |is_wide, row| is_wide || row.is_following;

/// The columns in their order. A new figure is a field of [`Row`] and a line here.
pub const COLUMNS: [Column<Row>; 23] = [
    Column::always("strategy", |row| match row.np {
        Some(np) => format!("{}:{np}", row.strategy),
        None => row.strategy.clone(),
    }),
    Column::always("success", |row| percent(row.success_rate)),
    Column::wide("95 % interval", |row| {
        let [low, high] = row.success_interval.map(|rate| 100.0 * rate);
        format!("{low:.1} to {high:.1}")
    }),
    Column::always("cost", |row| format!("{:.2}", row.mean_cost)),
    Column::always("cycles", |row| format!("{:.0}", row.steps)),
    Column::always("p99 (us)", |row| format!("{:.1}", row.cycle_us.p99)),
    Column::always("failures", |row| {
        column::failures(&[
            (row.violations, "violation"),
            (row.not_converged, "timeout"),
            (row.faults, "fault"),
        ])
    }),
    Column::when("deepest (px)", SHOWS_MORE, |row| {
        format!("{:.1}", row.deepest_px)
    }),
    Column::when("follows to (px RMS, most)", IS_FOLLOWING, |row| {
        column::followed_px(row.following.as_ref())
    }),
    Column::when("(mm RMS: camera, object)", IS_FOLLOWING, |row| {
        column::followed_mm(row.following.as_ref())
    }),
    Column::when("change a frame", IS_FOLLOWING, |row| {
        column::followed_change(row.following.as_ref())
    }),
    Column::wide("at rest (s)", |row| {
        of_law(row, format!("{:.1}", row.standstill_s))
    }),
    Column::wide("pose error (mm, mrad)", |row| {
        let [mm, mrad] = row.pose_error;
        format!("{mm:.2}, {mrad:.2}")
    }),
    Column::wide("change at the goal", |row| percent(row.change)),
    Column::wide("iterations", |row| {
        of_law(row, format!("{:.1}", row.iterations))
    }),
    Column::wide("not converged", |row| {
        of_law(row, percent(row.solver_not_converged))
    }),
    Column::wide("mean (us)", |row| format!("{:.1}", row.cycle_us.mean)),
    Column::wide("p50 (us)", |row| format!("{:.1}", row.cycle_us.p50)),
    Column::wide("max (us)", |row| format!("{:.1}", row.cycle_us.max)),
    Column::wide("slack p50 (us)", |row| {
        of_law(row, format!("{:.0}", row.slack_us.p50))
    }),
    Column::wide("slack p99 (us)", |row| {
        of_law(row, format!("{:.0}", row.slack_us.p99))
    }),
    Column::wide("slack max (us)", |row| {
        of_law(row, format!("{:.0}", row.slack_us.max))
    }),
    Column::wide("simulated step (us)", |row| {
        of_law(row, format!("{:.1}", row.simulated_us))
    }),
];

/// A figure of our law; `-` for an external method.
fn of_law(row: &Row, figure: String) -> String {
    row.np.map_or("-".to_owned(), |_| figure)
}

fn percent(share: f64) -> String {
    format!("{:.1} %", 100.0 * share)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_narrow_table_fits_into_a_hundred_characters() {
        let time = CycleTime {
            mean: 12345.6,
            p50: 12345.6,
            p99: 12345.6,
            max: 12345.6,
        };
        let row = Row {
            strategy: "foresight".to_owned(),
            np: Some(30),
            success_rate: 1.0,
            success_interval: [0.963, 1.0],
            mean_cost: 1234.567,
            cycle_us: time,
            slack_us: time,
            simulated_us: 100.0,
            deepest_px: 12.0,
            violations: 333,
            not_converged: 333,
            faults: 333,
            change: 0.1,
            iterations: 2.0,
            solver_not_converged: 0.01,
            steps: 450.0,
            standstill_s: 12.34,
            pose_error: [1.0, 2.0],
            following: None,
            is_following: false,
        };
        let rows = [row];
        let narrow = column::markdown(&COLUMNS, &rows, false);
        let longest = narrow.lines().map(str::len).max();
        assert!(longest.is_some_and(|length| length <= 100), "{narrow}");
        let wide = column::markdown(&COLUMNS, &rows, true);
        assert!(wide.contains("96.3 to 100.0"), "{wide}");
    }
}
