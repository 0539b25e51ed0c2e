//! A dense quadratic program with hard bounds and elastic rows, by a dual active-set method.
//!
//! minimise 1/2 d^T H d + g^T d + rho sum_i max(0, -(a_i^T d + c_i))  subject to  lower <= d <= upper
//!
//! The exact (L1) penalty caps the multiplier of a row at rho. The dual method starts at the unconstrained minimum
//! and adds violated constraints one by one; when a row's multiplier reaches its cap the row *yields*: it stays
//! violated, its pull rho a_i joins the linear term, and from then on it counts as violated when it is satisfied.
//! Bounds never yield, so the answer is inside them whatever the rows ask for, and the program always has a solution.
//!
//! Source: D. Goldfarb and A. Idnani, "A numerically stable dual method for solving strictly convex quadratic
//! programs", Math. Programming 27 (1983); the cap on multipliers is ours.

use libm::sqrt;

use crate::MAX_VARIABLES;
use crate::prediction::Plan;

/// Most elastic rows.
pub const MAX_ROWS: usize = 1536;

/// A row a^T d + c >= 0 in px: the linearised clearance of one previewed point from one constraint.
#[derive(Clone, Copy, Debug)]
pub struct Row {
    /// Gradient with respect to the plan.
    pub gradient: Plan,
    /// Clearance at d = 0, px.
    pub clearance: f64,
}

/// The rows of a program, in a store of fixed size.
#[derive(Clone, Debug)]
pub struct Rows {
    rows: [Row; MAX_ROWS],
    /// Turned rows have yielded.
    yielded: [bool; MAX_ROWS],
    len: usize,
}

impl Rows {
    /// No rows.
    pub const fn new() -> Self {
        let row = Row {
            gradient: [0.0; MAX_VARIABLES],
            clearance: 0.0,
        };
        Self {
            rows: [row; MAX_ROWS],
            yielded: [false; MAX_ROWS],
            len: 0,
        }
    }

    /// Forgets all rows.
    pub fn clear(&mut self) {
        self.len = 0;
    }

    /// Adds a row; `false` where the store is full.
    pub fn push(&mut self, row: Row) -> bool {
        let Some(slot) = self.rows.get_mut(self.len) else {
            return false;
        };
        *slot = row;
        self.len += 1;
        true
    }

    /// The rows.
    pub fn as_slice(&self) -> &[Row] {
        self.rows.get(..self.len).unwrap_or(&[])
    }
}

impl Default for Rows {
    fn default() -> Self {
        Self::new()
    }
}

/// How a program ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum QpStatus {
    /// Optimal.
    Solved,
    /// Stopped at the bound on iterations; the answer is inside the bounds.
    IterationLimit,
    /// The Hessian is not positive definite, or a number is not finite; the answer is zero.
    NumericalFailure,
}

/// What a solved program reports.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct QpReport {
    /// How it ended.
    pub status: QpStatus,
    /// Changes of the active set.
    pub iterations: u32,
    /// Rows that yielded: violated at the answer although rho pulls at them.
    pub yielded: u32,
}

/// Index of a constraint: bounds first, then rows.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Constraint {
    Lower(usize),
    Upper(usize),
    Row(usize),
}

/// The workspace of the method, for up to [`MAX_VARIABLES`] variables.
#[derive(Clone)]
pub struct QuadraticProgram {
    n: usize,
    /// Columns of J = L^{-T} Q, one a row of the array.
    columns: [Plan; MAX_VARIABLES],
    /// R, upper triangular, stored by columns.
    triangle: [Plan; MAX_VARIABLES],
    active: [Constraint; MAX_VARIABLES],
    multipliers: Plan,
    count: usize,
}

impl QuadraticProgram {
    /// An empty workspace.
    pub const fn new() -> Self {
        Self {
            n: 0,
            columns: [[0.0; MAX_VARIABLES]; MAX_VARIABLES],
            triangle: [[0.0; MAX_VARIABLES]; MAX_VARIABLES],
            active: [Constraint::Lower(0); MAX_VARIABLES],
            multipliers: [0.0; MAX_VARIABLES],
            count: 0,
        }
    }

    /// Solves the program in the first `n` variables; the answer is written to `d`. `rho` caps the multipliers of
    /// the rows (cost per px); at most `limit` changes of the active set are made.
    #[allow(clippy::too_many_arguments)] // the program *is* these eight things
    pub fn solve(
        &mut self,
        n: usize,
        hessian: &[[f64; MAX_VARIABLES]; MAX_VARIABLES],
        gradient: &Plan,
        lower: &Plan,
        upper: &Plan,
        rows: &mut Rows,
        rho: f64,
        limit: u32,
        d: &mut Plan,
    ) -> QpReport {
        self.n = n.min(MAX_VARIABLES);
        self.count = 0;
        *d = [0.0; MAX_VARIABLES];
        rows.yielded
            .iter_mut()
            .take(rows.len)
            .for_each(|yielded| *yielded = false);
        let mut report = QpReport {
            status: QpStatus::Solved,
            iterations: 0,
            yielded: 0,
        };
        if !self.factorise(hessian) {
            report.status = QpStatus::NumericalFailure;
            return report;
        }
        self.unconstrained(gradient, d);

        'outer: while let Some((constraint, mut slack)) = self.most_violated(lower, upper, rows, d)
        {
            let normal = self.normal(constraint, rows);
            let cap = if matches!(constraint, Constraint::Row(_)) {
                rho
            } else {
                f64::INFINITY
            };
            let mut multiplier = 0.0;
            loop {
                if report.iterations >= limit {
                    report.status = QpStatus::IterationLimit;
                    break 'outer;
                }
                report.iterations += 1;
                let (direction, projection, exchange) = self.directions(&normal);
                let curvature: f64 = dot(&direction, &normal, self.n);
                let scale = dot(&projection, &projection, self.n);

                // The longest dual step: to the constraint itself, to its cap, or until an active multiplier
                // leaves [0, rho].
                let full = if curvature > 1e-12 * scale {
                    -slack / curvature
                } else {
                    f64::INFINITY
                };
                let mut step = full.min(cap - multiplier);
                let mut leaving = None;
                for k in 0..self.count {
                    let row = matches!(self.active[k], Constraint::Row(_));
                    let room = if exchange[k] > 1e-14 {
                        self.multipliers[k] / exchange[k]
                    } else if exchange[k] < -1e-14 && row {
                        (rho - self.multipliers[k]) / -exchange[k]
                    } else {
                        continue;
                    };
                    if room < step {
                        step = room.max(0.0);
                        leaving = Some((k, exchange[k] < 0.0));
                    }
                }
                if !step.is_finite() {
                    // The bounds contradict each other, or a number is not finite.
                    report.status = QpStatus::NumericalFailure;
                    break 'outer;
                }

                if curvature > 1e-12 * scale {
                    for i in 0..self.n {
                        d[i] += step * direction[i];
                    }
                    slack += step * curvature;
                }
                for k in 0..self.count {
                    self.multipliers[k] -= step * exchange[k];
                }
                multiplier += step;

                match leaving {
                    Some((k, yields)) => {
                        if yields && let Constraint::Row(i) = self.active[k] {
                            rows.yielded[i] = !rows.yielded[i];
                        }
                        self.remove(k);
                    }
                    None if step < full => {
                        // Its own cap: the constraint turns around without becoming active.
                        if let Constraint::Row(i) = constraint {
                            rows.yielded[i] = !rows.yielded[i];
                        }
                        continue 'outer;
                    }
                    None => {
                        if !self.add(constraint, &projection, multiplier) {
                            report.status = QpStatus::IterationLimit;
                            break 'outer;
                        }
                        continue 'outer;
                    }
                }
            }
        }

        for i in 0..self.n {
            if !d[i].is_finite() {
                *d = [0.0; MAX_VARIABLES];
                report.status = QpStatus::NumericalFailure;
                break;
            }
            d[i] = d[i].max(lower[i]).min(upper[i]);
        }
        report.yielded = rows
            .yielded
            .iter()
            .take(rows.len)
            .filter(|yielded| **yielded)
            .count() as u32;
        report
    }

    /// J = L^{-T} from the Cholesky factor of the Hessian; `false` where it is not positive definite.
    fn factorise(&mut self, hessian: &[[f64; MAX_VARIABLES]; MAX_VARIABLES]) -> bool {
        let n = self.n;
        let mut factor = [[0.0; MAX_VARIABLES]; MAX_VARIABLES];
        for i in 0..n {
            for j in 0..=i {
                let sum = hessian[i][j] - dot(&factor[i], &factor[j], j);
                if i == j {
                    if !(sum > 0.0 && sum.is_finite()) {
                        return false;
                    }
                    factor[i][i] = sqrt(sum);
                } else {
                    factor[i][j] = sum / factor[j][j];
                }
            }
        }
        // Column k of L^{-T} is row k of L^{-1}, transposed: solve L X = I row by row.
        for k in 0..n {
            self.columns[k] = [0.0; MAX_VARIABLES];
        }
        for c in 0..n {
            for i in c..n {
                let mut sum = if i == c { 1.0 } else { 0.0 };
                for k in c..i {
                    sum -= factor[i][k] * self.columns[k][c];
                }
                self.columns[i][c] = sum / factor[i][i];
            }
        }
        true
    }

    /// d = -H^{-1} g = -J J^T g.
    fn unconstrained(&self, gradient: &Plan, d: &mut Plan) {
        for column in self.columns.iter().take(self.n) {
            let share = dot(column, gradient, self.n);
            for i in 0..self.n {
                d[i] -= share * column[i];
            }
        }
    }

    fn normal(&self, constraint: Constraint, rows: &Rows) -> Plan {
        let mut normal = [0.0; MAX_VARIABLES];
        match constraint {
            Constraint::Lower(i) => normal[i] = 1.0,
            Constraint::Upper(i) => normal[i] = -1.0,
            Constraint::Row(i) if rows.yielded[i] => {
                rows.rows[i]
                    .gradient
                    .iter()
                    .zip(&mut normal)
                    .for_each(|(a, n)| *n = -a);
            }
            Constraint::Row(i) => normal = rows.rows[i].gradient,
        }
        normal
    }

    /// The constraint that is violated most, relative to the tolerance of its kind, with its slack.
    fn most_violated(
        &self,
        lower: &Plan,
        upper: &Plan,
        rows: &Rows,
        d: &Plan,
    ) -> Option<(Constraint, f64)> {
        // Bounds are in m/s and rad/s, rows in px.
        const BOUND: f64 = 1e-12;
        const ROW: f64 = 1e-7;
        let mut worst = None;
        let mut most = 1.0;
        let mut consider = |constraint: Constraint, slack: f64, tolerance: f64| {
            if -slack / tolerance > most && !self.active[..self.count].contains(&constraint) {
                most = -slack / tolerance;
                worst = Some((constraint, slack));
            }
        };
        for i in 0..self.n {
            consider(Constraint::Lower(i), d[i] - lower[i], BOUND);
            consider(Constraint::Upper(i), upper[i] - d[i], BOUND);
        }
        for (i, (row, yielded)) in rows.as_slice().iter().zip(&rows.yielded).enumerate() {
            let value = dot(&row.gradient, d, self.n) + row.clearance;
            consider(
                Constraint::Row(i),
                if *yielded { -value } else { value },
                ROW,
            );
        }
        worst
    }

    /// The primal direction z = J_2 J_2^T n, the projection J^T n, and the change of active multipliers R^{-1} J_1^T n.
    fn directions(&self, normal: &Plan) -> (Plan, Plan, Plan) {
        let n = self.n;
        let mut projection = [0.0; MAX_VARIABLES];
        let mut direction = [0.0; MAX_VARIABLES];
        for k in 0..n {
            projection[k] = dot(&self.columns[k], normal, n);
        }
        for k in self.count..n {
            for i in 0..n {
                direction[i] += projection[k] * self.columns[k][i];
            }
        }
        let mut exchange = [0.0; MAX_VARIABLES];
        for k in (0..self.count).rev() {
            let mut sum = projection[k];
            for l in k + 1..self.count {
                sum -= self.triangle[l][k] * exchange[l];
            }
            exchange[k] = sum / self.triangle[k][k];
        }
        (direction, projection, exchange)
    }

    /// Makes a constraint active; `false` where its normal depends on the active ones.
    fn add(&mut self, constraint: Constraint, projection: &Plan, multiplier: f64) -> bool {
        let (n, count) = (self.n, self.count);
        if count >= n {
            return false;
        }
        let mut d = *projection;
        for j in (count + 1..n).rev() {
            let (a, b) = (d[j - 1], d[j]);
            if b == 0.0 {
                continue;
            }
            let length = sqrt(a * a + b * b);
            let (c, s) = (a / length, b / length);
            d[j - 1] = length;
            d[j] = 0.0;
            self.rotate_columns(j - 1, j, c, s);
        }
        if d[count].abs() < 1e-14 {
            return false;
        }
        self.triangle[count] = [0.0; MAX_VARIABLES];
        self.triangle[count][..=count].copy_from_slice(&d[..=count]);
        self.active[count] = constraint;
        self.multipliers[count] = multiplier;
        self.count += 1;
        true
    }

    /// Drops the active constraint at position `k` and restores the triangle by Givens rotations.
    fn remove(&mut self, k: usize) {
        let last = self.count - 1;
        for l in k..last {
            self.triangle[l] = self.triangle[l + 1];
            self.active[l] = self.active[l + 1];
            self.multipliers[l] = self.multipliers[l + 1];
        }
        self.count = last;
        for j in k..last {
            let (a, b) = (self.triangle[j][j], self.triangle[j][j + 1]);
            if b == 0.0 {
                continue;
            }
            let length = sqrt(a * a + b * b);
            let (c, s) = (a / length, b / length);
            for l in j..last {
                let (x, y) = (self.triangle[l][j], self.triangle[l][j + 1]);
                self.triangle[l][j] = c * x + s * y;
                self.triangle[l][j + 1] = c * y - s * x;
            }
            self.rotate_columns(j, j + 1, c, s);
        }
    }

    fn rotate_columns(&mut self, i: usize, j: usize, c: f64, s: f64) {
        for k in 0..self.n {
            let (x, y) = (self.columns[i][k], self.columns[j][k]);
            self.columns[i][k] = c * x + s * y;
            self.columns[j][k] = c * y - s * x;
        }
    }
}

impl Default for QuadraticProgram {
    fn default() -> Self {
        Self::new()
    }
}

fn dot(a: &Plan, b: &Plan, n: usize) -> f64 {
    a.iter().zip(b).take(n).map(|(x, y)| x * y).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A small generator, so that the tests need no crate.
    struct Random(u64);

    impl Random {
        fn next(&mut self) -> f64 {
            self.0 = self
                .0
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            (self.0 >> 11) as f64 / (1u64 << 53) as f64 * 2.0 - 1.0
        }
    }

    struct Problem {
        hessian: [[f64; MAX_VARIABLES]; MAX_VARIABLES],
        gradient: Plan,
        rows: Box<Rows>,
        bound: f64,
        rho: f64,
    }

    impl Problem {
        fn random(random: &mut Random, n: usize, rows: usize) -> Self {
            let mut hessian = [[0.0; MAX_VARIABLES]; MAX_VARIABLES];
            let mut gradient = [0.0; MAX_VARIABLES];
            for _ in 0..2 * n {
                let a: Vec<f64> = (0..n).map(|_| random.next()).collect();
                for i in 0..n {
                    for j in 0..n {
                        hessian[i][j] += a[i] * a[j];
                    }
                }
            }
            gradient
                .iter_mut()
                .take(n)
                .for_each(|g| *g = 5.0 * random.next());
            let mut store = Box::new(Rows::new());
            for _ in 0..rows {
                let mut gradient = [0.0; MAX_VARIABLES];
                gradient.iter_mut().take(n).for_each(|g| *g = random.next());
                store.push(Row {
                    gradient,
                    clearance: random.next(),
                });
            }
            let rho = 4.0 * (1.0 + random.next());
            Self {
                hessian,
                gradient,
                rows: store,
                bound: 0.8,
                rho,
            }
        }

        fn solve(&mut self, n: usize) -> (Plan, QpReport) {
            let mut d = [0.0; MAX_VARIABLES];
            let (lower, upper) = ([-self.bound; MAX_VARIABLES], [self.bound; MAX_VARIABLES]);
            let mut program = Box::new(QuadraticProgram::new());
            let report = program.solve(
                n,
                &self.hessian,
                &self.gradient,
                &lower,
                &upper,
                &mut self.rows,
                self.rho,
                500,
                &mut d,
            );
            (d, report)
        }

        fn value(&self, n: usize, d: &Plan) -> f64 {
            let curve: f64 = (0..n)
                .map(|i| 0.5 * d[i] * dot(&self.hessian[i], d, n))
                .sum();
            let penalty: f64 = self
                .rows
                .as_slice()
                .iter()
                .map(|row| (-(dot(&row.gradient, d, n) + row.clearance)).max(0.0))
                .sum();
            curve + dot(&self.gradient, d, n) + self.rho * penalty
        }
    }

    #[test]
    fn no_direction_improves_the_answer_of_random_programs() {
        let mut random = Random(7);
        for trial in 0..400 {
            let n = [1, 3, 6, 12, 24][trial % 5];
            let mut problem = Problem::random(&mut random, n, [0, 4, 20, 60][trial % 4]);
            let (d, report) = problem.solve(n);
            assert_eq!(report.status, QpStatus::Solved, "trial {trial}");
            let best = problem.value(n, &d);
            for _ in 0..60 {
                let mut other = d;
                let length = 10f64.powf(-4.0 * random.next().abs());
                for x in other.iter_mut().take(n) {
                    *x = (*x + length * random.next()).clamp(-problem.bound, problem.bound);
                }
                let value = problem.value(n, &other);
                assert!(
                    value >= best - 1e-7 * (1.0 + best.abs()),
                    "trial {trial}: {value} < {best}"
                );
            }
        }
    }

    #[test]
    fn contradicting_rows_yield_and_the_answer_stays_in_the_bounds() {
        let mut problem = Problem::random(&mut Random(3), 6, 0);
        let (mut plus, mut minus) = ([0.0; MAX_VARIABLES], [0.0; MAX_VARIABLES]);
        plus[0] = 1.0;
        minus[0] = -1.0;
        problem.rows.push(Row {
            gradient: plus,
            clearance: -1.0,
        });
        problem.rows.push(Row {
            gradient: minus,
            clearance: -1.0,
        });
        let (d, report) = problem.solve(6);
        assert_eq!(report.status, QpStatus::Solved);
        assert!(report.yielded >= 1);
        assert!(d.iter().all(|x| x.abs() <= 0.8));
    }

    #[test]
    fn a_bad_hessian_is_a_numerical_failure() {
        let mut problem = Problem::random(&mut Random(5), 6, 4);
        problem.hessian[2][2] = f64::NAN;
        let (d, report) = problem.solve(6);
        assert_eq!(
            (report.status, d),
            (QpStatus::NumericalFailure, [0.0; MAX_VARIABLES])
        );
    }
}
