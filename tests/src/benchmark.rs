//! The benchmark of `cargo benchmark`: peers from other fields, and statistics over the runs of
//! several tables.

use std::collections::BTreeMap;
use std::path::Path;

use testkit::python::Environment;

use crate::column::{self, Column};
use crate::external::Method;
use crate::root;
use crate::run::{Reason, Run};
use crate::statistics::wilson;

/// What the peers need.
const PEERS: Environment = Environment {
    name: "python-peers",
    requirements: &["tests/peers/requirements.txt"],
    packages: &[],
};
/// acados brings a CasADi of its own.
const ACADOS: Environment = Environment {
    name: "python-acados",
    requirements: &["tests/peers/requirements-acados.txt"],
    packages: &[],
};

/// Rows of peers: name, environment, program in `tests/peers` and its arguments.
const METHODS: [(&str, &Environment, &str); 8] = [
    ("IBVS", &PEERS, "ibvs.py"),
    ("CBF-QP", &PEERS, "cbf.py"),
    ("MPPI", &PEERS, "mppi.py"),
    ("acados-3", &ACADOS, "nmpc.py 3"),
    ("acados-10", &ACADOS, "nmpc.py 10"),
    ("acados-30", &ACADOS, "nmpc.py 30"),
    ("FDDP", &PEERS, "fddp.py"),
    ("FDDP-memory", &PEERS, "fddp.py --memory MEMORY"),
];

/// The peers, with this memory of motion for the one that takes it. If packages of a peer cannot be
/// installed, it is left out, after [`testkit::not_run`].
pub fn methods(memory: &Path) -> Vec<Method> {
    let each = METHODS.iter().filter_map(|(name, environment, words)| {
        let python = environment.python(&format!("the peer {name}"))?;
        let memory = memory.display().to_string();
        let program = root().join("tests/peers").join(words);
        let program = program.display().to_string();
        Some(Method {
            name: (*name).to_owned(),
            words: format!("{} {}", python.display(), program).replace("MEMORY", &memory),
        })
    });
    each.collect()
}

/// The runs in one scene: of each strategy or method, by its name, from all starts.
pub type Runs = Vec<(String, Vec<Run>)>;

/// A strategy or method over all scenes.
#[derive(Debug, Default)]
struct Row {
    name: String,
    /// Arrivals in each scene.
    arrived: Vec<usize>,
    runs: usize,
    violations: usize,
    /// Cost and cycles of runs that arrived, beyond the best of the table from the same start, %.
    beyond: [Vec<f64>; 2],
    deepest_px: f64,
    cycles_us: Vec<f64>,
    changes: Vec<f64>,
}

impl Row {
    fn add(&mut self, run: &Run, best: Option<&[f64; 2]>) {
        self.runs += 1;
        let is_violation = |reason| matches!(reason, Reason::Violation | Reason::LostSight);
        self.violations += usize::from(run.reason.is_some_and(is_violation));
        let least = run.least_clearance_px.min(run.least_between_px);
        self.deepest_px = self.deepest_px.max(-least);
        self.cycles_us.extend(&run.cycles_us);
        self.changes.extend(run.change);
        if let (true, Some(best)) = (run.success, best) {
            for (k, value) in [run.cost, run.steps as f64].into_iter().enumerate() {
                self.beyond[k].push(100.0 * (value / best[k] - 1.0));
            }
        }
    }

    fn sort(&mut self) {
        for values in self.beyond.iter_mut().chain([&mut self.cycles_us]) {
            values.sort_by(f64::total_cmp);
        }
    }
}

/// The columns.
const COLUMNS: [Column<Row>; 9] = [
    Column::always("", |row| row.name.clone()),
    Column::always("arrived, by scene", |row| {
        let each: Vec<_> = row.arrived.iter().map(usize::to_string).collect();
        each.join(", ")
    }),
    Column::always("of all, % (95 %)", |row| {
        let arrived: usize = row.arrived.iter().sum();
        let [low, high] = wilson(arrived, row.runs).map(|rate| 100.0 * rate);
        let rate = 100.0 * arrived as f64 / row.runs.max(1) as f64;
        format!("{rate:.0} ({low:.0} to {high:.0})")
    }),
    Column::always("violations", |row| row.violations.to_string()),
    Column::always("cost: beyond, %", |row| beyond(row, 0)),
    Column::always("cycles: beyond, %", |row| beyond(row, 1)),
    Column::always("deepest, px", |row| format!("{:.1}", row.deepest_px)),
    Column::always("p50, p99, ms", |row| {
        let at = |share| program::quantile(&row.cycles_us, share) / 1e3;
        format!("{:.3}, {:.3}", at(0.5), at(0.99))
    }),
    Column::always("change, %", |row| {
        let sum: f64 = row.changes.iter().sum();
        format!("{:.2}", 100.0 * sum / row.changes.len().max(1) as f64)
    }),
];

/// The median and nine of ten.
fn beyond(row: &Row, which: usize) -> String {
    let at = |share| program::quantile(&row.beyond[which], share);
    format!("{:.0}, {:.0}", at(0.5), at(0.9))
}

/// The rows of all methods over these scenes.
pub fn markdown(scenes: &[Runs]) -> String {
    let mut rows: Vec<Row> = Vec::new();
    for (scene, methods) in scenes.iter().enumerate() {
        // Least cost and cycles from each start.
        let mut best: BTreeMap<usize, [f64; 2]> = BTreeMap::new();
        for (start, run) in methods.iter().flat_map(|(_, runs)| runs.iter().enumerate()) {
            if run.success {
                let least = best.entry(start).or_insert([f64::INFINITY; 2]);
                *least = [least[0].min(run.cost), least[1].min(run.steps as f64)];
            }
        }
        for (name, runs) in methods {
            let found = rows.iter().position(|row| row.name == *name);
            let index = found.unwrap_or_else(|| {
                rows.push(Row {
                    name: name.clone(),
                    arrived: vec![0; scenes.len()],
                    ..Row::default()
                });
                rows.len() - 1
            });
            for (start, run) in runs.iter().enumerate() {
                rows[index].add(run, best.get(&start));
                rows[index].arrived[scene] += usize::from(run.success);
            }
        }
    }
    rows.iter_mut().for_each(Row::sort);
    column::markdown(&COLUMNS, &rows, false)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn costs_are_beside_the_best_run_from_the_same_start() {
        let run = |success: bool, cost: f64, steps: usize| Run {
            success,
            reason: (!success).then_some(Reason::Violation),
            steps,
            cost,
            least_clearance_px: -1.5,
            least_between_px: f64::INFINITY,
            cycles_us: vec![1000.0, 3000.0],
            ..Run::default()
        };
        let a = vec![run(true, 12.0, 40), run(true, 3.0, 20)];
        let b = vec![run(true, 10.0, 50), run(false, 1.0, 2)];
        let text = markdown(&[vec![("a".to_owned(), a), ("b".to_owned(), b)]]);
        let cells = |name: &str| -> Vec<String> {
            let line = text
                .lines()
                .find(|line| line.starts_with(&format!("| {name}")));
            let cells = line.unwrap().split('|').map(|cell| cell.trim().to_owned());
            cells.skip(2).collect()
        };
        let (a, b) = (cells("a"), cells("b"));
        assert_eq!(
            a[..5],
            ["2", "100 (34 to 100)", "0", "0, 20", "0, 0"],
            "{text}"
        );
        assert_eq!(
            b[..5],
            ["1", "50 (9 to 91)", "1", "0, 0", "25, 25"],
            "{text}"
        );
        assert_eq!(a[5..7], ["1.5", "1.000, 3.000"], "{text}");
    }
}
