//! A row of the table: statistics over all runs of one strategy.

use serde::Serialize;

use crate::run::{Reason, Run};
use crate::spec::Spec;

/// The paper's Table I for one strategy, and what the paper does not show.
#[derive(Clone, Debug, Serialize)]
pub struct Row {
    /// Name of the strategy.
    pub strategy: String,
    /// Steps previewed.
    pub np: usize,
    /// Share of successful runs, 0 to 1.
    pub success_rate: f64,
    /// Mean running cost over Np of all runs.
    pub mean_cost: f64,
    /// Time of a cycle of the law.
    pub cycle_us: CycleTime,
    /// Runs with a violated constraint (or a point lost).
    pub violations: usize,
    /// Runs that did not arrive in time.
    pub not_converged: usize,
    /// Mean iterations of the solver a cycle.
    pub iterations: f64,
    /// Share of cycles in which the solver did not converge, 0 to 1.
    pub solver_not_converged: f64,
    /// Mean cycles to arrival of the successful runs.
    pub steps: f64,
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
        let at = |share: f64| {
            let index = (share * times.len() as f64) as usize;
            times
                .get(index.min(times.len().saturating_sub(1)))
                .copied()
                .unwrap_or(0.0)
        };
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
    /// The row of a strategy's runs.
    pub fn of(spec: Spec, runs: &[Run]) -> Self {
        let count = runs.len().max(1) as f64;
        let cycles: Vec<f64> = runs
            .iter()
            .flat_map(|run| run.cycles_us.iter().copied())
            .collect();
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
            strategy: spec.strategy.to_string(),
            np: spec.np,
            success_rate: successes as f64 / count,
            mean_cost: runs.iter().map(|run| run.cost).sum::<f64>() / count,
            violations: because(&[Reason::Violation, Reason::LostSight]),
            not_converged: because(&[Reason::NotConverged]),
            iterations: per_cycle(runs.iter().map(|run| run.iterations).sum()),
            solver_not_converged: per_cycle(runs.iter().map(|run| run.not_converged).sum()),
            steps: steps as f64 / successes.max(1) as f64,
            cycle_us: CycleTime::of(cycles),
        }
    }
}

/// The rows as a Markdown table.
pub fn markdown(rows: &[Row]) -> String {
    let mut text = String::from(
        "| strategy | Np | success (%) | mean cycle (us) | mean cost l/Np | p50 (us) | p99 (us) | max (us) | \
         violations | not converged | iterations | solver not conv. (%) | cycles to arrival |\n\
         |---|--:|--:|--:|--:|--:|--:|--:|--:|--:|--:|--:|--:|\n",
    );
    for row in rows {
        let t = &row.cycle_us;
        text += &format!(
            "| {} | {} | {:.1} | {:.1} | {:.2} | {:.1} | {:.1} | {:.1} | {} | {} | {:.2} | {:.2} | {:.0} |\n",
            row.strategy,
            row.np,
            100.0 * row.success_rate,
            t.mean,
            row.mean_cost,
            t.p50,
            t.p99,
            t.max,
            row.violations,
            row.not_converged,
            row.iterations,
            100.0 * row.solver_not_converged,
            row.steps,
        );
    }
    text
}
