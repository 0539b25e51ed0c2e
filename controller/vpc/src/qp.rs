//! A dense quadratic program with hard bounds and elastic rows, by a dual active-set method.
//!
//! minimise 1/2 d^T H d + g^T d + rho sum_i max(0, -(a_i^T d + c_i))  subject to  lower <= d <=
//! upper
//!
//! The exact (L1) penalty caps the multiplier of a row at rho. The dual method starts at the
//! unconstrained minimum and adds violated constraints one by one; when a row's multiplier reaches
//! its cap the row *yields*: it stays violated, its gradient rho a_i joins the linear term, and
//! from then on it counts as violated when it is satisfied. Bounds never yield, so the answer is
//! always inside them, and the program always has a solution.
//!
//! The number of variables is part of the type: every inner loop has a fixed length.
//!
//! | Symbol | Here | Meaning |
//! |---|---|---|
//! | d | `step` | the variables |
//! | H, g | [`Quadratic`] | Hessian and gradient of the cost at d = 0 |
//! | a_i, c_i | [`Rows`] | gradient and value of a clearance at d = 0, px |
//! | rho | `rho` | penalty weight, the cap of the multipliers of rows |
//! | J, R | `columns`, `triangle` | H = L L^T, active normals A: L^{-1} A = Q R, J = L^{-T} Q |
//!
//! Source: D. Goldfarb and A. Idnani, "A numerically stable dual method for solving strictly convex
//! quadratic programs", Math. Programming 27 (1983); the cap on multipliers is ours.
#![expect(
    clippy::indexing_slicing,
    reason = "a dense kernel: indices run over 0..N of arrays of N, or below the counts kept beside them"
)]

use libm::sqrt;

use crate::workspace::Workspace;

/// Most elastic rows.
pub const MAX_ROWS: usize = 1024;
/// Most violated rows that are watched between two scans of all rows: with a long window there are
/// hundreds, and only a few decide.
const MAX_SUSPECTS: usize = 24;
/// A bound is violated beyond this, m/s or rad/s.
const BOUND_TOLERANCE: f64 = 1e-12;
/// A row is violated beyond this, px.
const ROW_TOLERANCE: f64 = 1e-7;

/// A quadratic function of `N` variables, and their bounds.
#[derive(Clone, Debug)]
pub struct Quadratic<const N: usize> {
    /// H, symmetric and positive definite, row by row.
    pub hessian: [[f64; N]; N],
    /// g.
    pub gradient: [f64; N],
    /// Lower bounds of d.
    pub lower: [f64; N],
    /// Upper bounds of d.
    pub upper: [f64; N],
}

impl<const N: usize> Quadratic<N> {
    /// 1/2 d^T H d + g^T d.
    pub fn change(&self, d: &[f64; N]) -> f64 {
        let curve: f64 = (0..N).map(|i| d[i] * dot(&self.hessian[i], d)).sum();
        0.5 * curve + dot(&self.gradient, d)
    }
}

/// The elastic rows a^T d + c >= 0 of a program, in a workspace that the caller lends: the
/// linearised clearances (px) of previewed points.
#[derive(Debug)]
pub struct Rows<'w, const N: usize> {
    gradients: &'w mut [[f64; N]],
    clearances: &'w mut [f64],
    /// -1 for a row that has yielded: it is violated when it is satisfied. Else 1.
    signs: &'w mut [f64],
    len: usize,
}

impl<'w, const N: usize> Rows<'w, N> {
    /// Numbers of workspace for `most` rows.
    pub const fn room(most: usize) -> usize {
        most * (N + 2)
    }

    /// An empty store for `most` rows, in a workspace of [`Rows::room`] numbers; `None` if that is
    /// too short.
    pub fn new(most: usize, workspace: &'w mut [f64]) -> Option<Self> {
        Self::cut(most, &mut Workspace(workspace))
    }

    pub(crate) fn cut(most: usize, workspace: &mut Workspace<'w>) -> Option<Self> {
        Some(Self {
            gradients: workspace.arrays(most)?,
            clearances: workspace.numbers(most)?,
            signs: workspace.numbers(most)?,
            len: 0,
        })
    }

    /// How many rows there are.
    pub fn len(&self) -> usize {
        self.len
    }

    /// The gradient and the clearance at d = 0 (px) of every row.
    pub fn iter(&self) -> impl Iterator<Item = (&[f64; N], f64)> {
        let clearances = self.clearances.iter().copied();
        self.gradients.iter().zip(clearances).take(self.len)
    }

    /// Forgets all rows.
    pub fn clear(&mut self) {
        self.len = 0;
    }

    /// Adds the row of a gradient and the clearance at d = 0 (px); `false` if the store is full.
    pub fn push(&mut self, gradient: [f64; N], clearance: f64) -> bool {
        if self.len == self.signs.len() {
            return false;
        }
        self.gradients[self.len] = gradient;
        self.clearances[self.len] = clearance;
        self.signs[self.len] = 1.0;
        self.len += 1;
        true
    }

    /// Gives row `i` this clearance (px) at `d`, which includes the curvature; its gradient stays.
    pub fn correct(&mut self, i: usize, clearance: f64, d: &[f64; N]) {
        self.clearances[i] = clearance - dot(&self.gradients[i], d);
    }

    /// A row yields, or stops yielding; a bound never does.
    fn turn(&mut self, constraint: Constraint) {
        if let Constraint::Row(i) = constraint {
            self.signs[i] = -self.signs[i];
        }
    }

    /// What row `i` leaves free at `d`, px; negative where it is violated, or satisfied although it
    /// has yielded.
    fn slack(&self, i: usize, d: &[f64; N]) -> f64 {
        self.signs[i] * (dot(&self.gradients[i], d) + self.clearances[i])
    }

    /// The sum of all violations that the rows predict for `d`, px.
    pub fn violation(&self, d: &[f64; N]) -> f64 {
        self.iter().map(|(a, c)| (-(dot(a, d) + c)).max(0.0)).sum()
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

/// The answer to a program.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Answer<const N: usize> {
    /// d.
    pub step: [f64; N],
    /// How it ended.
    pub status: QpStatus,
    /// Changes of the active set.
    pub iterations: u32,
    /// Looks at a row for a violation.
    pub looks: u32,
    /// Rows that yielded: violated at the answer although rho pulls at them.
    pub yielded: u32,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Constraint {
    Lower(usize),
    Upper(usize),
    Row(usize),
}

/// A violated constraint on its way into the active set.
struct Entering<const N: usize> {
    constraint: Constraint,
    /// Its inward normal; that of a row that has yielded points outward.
    normal: [f64; N],
    slack: f64,
    multiplier: f64,
    cap: f64,
}

impl<const N: usize> Entering<N> {
    fn new(constraint: Constraint, slack: f64, rows: &Rows<'_, N>, rho: f64) -> Self {
        let mut normal = [0.0; N];
        match constraint {
            Constraint::Lower(i) => normal[i] = 1.0,
            Constraint::Upper(i) => normal[i] = -1.0,
            Constraint::Row(i) => normal = rows.gradients[i].map(|a| rows.signs[i] * a),
        }
        let is_row = matches!(constraint, Constraint::Row(_));
        let cap = if is_row { rho } else { f64::INFINITY };
        Self {
            constraint,
            normal,
            slack,
            multiplier: 0.0,
            cap,
        }
    }
}

/// How d and the multipliers change per unit of the entering multiplier, whose constraint has the
/// normal n.
struct Directions<const N: usize> {
    /// z = J_2 J_2^T n, the change of d.
    primal: [f64; N],
    /// J^T n.
    projection: [f64; N],
    /// R^{-1} J_1^T n, the decrease of the active multipliers.
    exchange: [f64; N],
    /// z^T n.
    curvature: f64,
    /// Whether n is linearly independent of the active normals.
    independent: bool,
}

/// What ends a step of the entering multiplier.
enum StepEnd {
    /// The constraint is satisfied, and becomes active.
    Active,
    /// Its multiplier is at its cap: it turns around without becoming active.
    Yields,
    /// The active constraint at this position leaves, because its multiplier is zero or at its cap.
    Leaves { position: usize, yields: bool },
}

/// The method, in a workspace that the caller lends.
pub struct ActiveSet<'w, const N: usize> {
    /// Columns of J = L^{-T} Q, one a row of the array.
    columns: &'w mut [[f64; N]; N],
    /// R, upper triangular, stored by columns.
    triangle: &'w mut [[f64; N]; N],
    active: [Constraint; N],
    multipliers: [f64; N],
    count: usize,
    /// Rows that were violated most when all were last looked at, the worst first.
    suspects: [(usize, f64); MAX_SUSPECTS],
    suspected: usize,
    looks: usize,
}

impl<'w, const N: usize> ActiveSet<'w, N> {
    /// Numbers of workspace.
    pub const ROOM: usize = 2 * N * N;

    /// The method in a workspace of [`ActiveSet::ROOM`] numbers; `None` if that is too short.
    pub fn new(workspace: &'w mut [f64]) -> Option<Self> {
        Self::cut(&mut Workspace(workspace))
    }

    pub(crate) fn cut(workspace: &mut Workspace<'w>) -> Option<Self> {
        Some(Self {
            columns: workspace.arrays(N)?.first_chunk_mut()?,
            triangle: workspace.arrays(N)?.first_chunk_mut()?,
            active: [Constraint::Lower(0); N],
            multipliers: [0.0; N],
            count: 0,
            suspects: [(0, 0.0); MAX_SUSPECTS],
            suspected: 0,
            looks: 0,
        })
    }

    /// Solves a program. `rho` caps the multipliers of the rows (cost per px); at most `limit`
    /// changes of the active set are made.
    pub fn solve(
        &mut self,
        quadratic: &Quadratic<N>,
        rows: &mut Rows<'_, N>,
        rho: f64,
        limit: u32,
    ) -> Answer<N> {
        (self.count, self.suspected, self.looks) = (0, 0, 0);
        rows.signs[..rows.len].fill(1.0);
        let mut answer = Answer {
            step: [0.0; N],
            status: QpStatus::NumericalFailure,
            iterations: 0,
            looks: 0,
            yielded: 0,
        };
        if !self.factorise(&quadratic.hessian) {
            return answer;
        }
        let mut d = self.unconstrained(&quadratic.gradient);
        answer.status = loop {
            let Some((constraint, slack)) = self.violated(quadratic, rows, &d) else {
                break QpStatus::Solved;
            };
            let entering = Entering::new(constraint, slack, rows, rho);
            if let Err(status) =
                self.enforce(entering, &mut d, rows, rho, limit, &mut answer.iterations)
            {
                break status;
            }
        };
        if d.iter().all(|x| x.is_finite()) {
            answer.step =
                core::array::from_fn(|i| d[i].max(quadratic.lower[i]).min(quadratic.upper[i]));
        } else {
            answer.status = QpStatus::NumericalFailure;
        }
        let has_yielded = |&i: &usize| rows.signs[i] < 0.0 && !self.is_active(Constraint::Row(i));
        answer.yielded = (0..rows.len).filter(has_yielded).count() as u32;
        answer.looks = self.looks as u32;
        answer
    }

    /// Raises the multiplier of a violated constraint until it is active or yields. Active
    /// constraints whose multipliers come to an end on the way leave.
    fn enforce(
        &mut self,
        mut entering: Entering<N>,
        d: &mut [f64; N],
        rows: &mut Rows<'_, N>,
        rho: f64,
        limit: u32,
        iterations: &mut u32,
    ) -> Result<(), QpStatus> {
        loop {
            if *iterations >= limit {
                return Err(QpStatus::IterationLimit);
            }
            *iterations += 1;
            let directions = self.directions(&entering.normal);
            let (step, end) = self.longest_step(&entering, &directions, rho);
            if !step.is_finite() {
                // The bounds contradict each other, or a number is not finite.
                return Err(QpStatus::NumericalFailure);
            }
            self.take(step, &directions, &mut entering, d);
            match end {
                StepEnd::Leaves { position, yields } => {
                    if yields {
                        rows.turn(self.active[position]);
                    }
                    self.remove(position);
                }
                StepEnd::Yields => {
                    rows.turn(entering.constraint);
                    return Ok(());
                }
                StepEnd::Active => {
                    let added = self.add(&entering, &directions.projection);
                    return added.then_some(()).ok_or(QpStatus::IterationLimit);
                }
            }
        }
    }

    /// The longest step of the entering multiplier, and what ends it: the constraint is satisfied,
    /// its multiplier reaches its cap, or an active multiplier leaves [0, rho].
    fn longest_step(
        &self,
        entering: &Entering<N>,
        directions: &Directions<N>,
        rho: f64,
    ) -> (f64, StepEnd) {
        let full = if directions.independent {
            -entering.slack / directions.curvature
        } else {
            f64::INFINITY
        };
        let mut step = full.min(entering.cap - entering.multiplier);
        let mut end = if step < full {
            StepEnd::Yields
        } else {
            StepEnd::Active
        };
        for k in 0..self.count {
            let change = directions.exchange[k];
            let is_row = matches!(self.active[k], Constraint::Row(_));
            let room = if change > 1e-14 {
                self.multipliers[k] / change
            } else if change < -1e-14 && is_row {
                (rho - self.multipliers[k]) / -change
            } else {
                continue;
            };
            if room < step {
                step = room.max(0.0);
                end = StepEnd::Leaves {
                    position: k,
                    yields: change < 0.0,
                };
            }
        }
        (step, end)
    }

    /// Moves d and all multipliers.
    fn take(
        &mut self,
        step: f64,
        directions: &Directions<N>,
        entering: &mut Entering<N>,
        d: &mut [f64; N],
    ) {
        if directions.independent {
            for i in 0..N {
                d[i] += step * directions.primal[i];
            }
            entering.slack += step * directions.curvature;
        }
        for k in 0..self.count {
            self.multipliers[k] -= step * directions.exchange[k];
        }
        entering.multiplier += step;
    }

    /// J = L^{-T} from the Cholesky factor of the Hessian; `false` if it is not positive
    /// definite.
    fn factorise(&mut self, hessian: &[[f64; N]; N]) -> bool {
        let mut factor = [[0.0; N]; N];
        let mut inverse = [0.0; N];
        for i in 0..N {
            for j in 0..=i {
                let mut sum = hessian[i][j];
                for k in 0..j {
                    sum -= factor[i][k] * factor[j][k];
                }
                if i == j {
                    if !(sum > 0.0 && sum.is_finite()) {
                        return false;
                    }
                    factor[i][i] = sqrt(sum);
                    inverse[i] = 1.0 / factor[i][i];
                } else {
                    factor[i][j] = sum * inverse[j];
                }
            }
        }
        // Column k of L^{-T} is row k of L^{-1}: solve L X = I, row by row.
        *self.columns = [[0.0; N]; N];
        for i in 0..N {
            let mut row = [0.0; N];
            row[i] = 1.0;
            for k in 0..i {
                for c in 0..=k {
                    row[c] -= factor[i][k] * self.columns[k][c];
                }
            }
            self.columns[i] = row.map(|x| x * inverse[i]);
        }
        true
    }

    /// d = -H^{-1} g = -J J^T g.
    fn unconstrained(&self, gradient: &[f64; N]) -> [f64; N] {
        let mut d = [0.0; N];
        for column in self.columns.iter() {
            let share = dot(column, gradient);
            for i in 0..N {
                d[i] -= share * column[i];
            }
        }
        d
    }

    /// A constraint that is violated by much, with its slack: the worst bound, else the worst
    /// suspect, else, where no suspect is violated any more, the worst of all rows.
    fn violated(
        &mut self,
        quadratic: &Quadratic<N>,
        rows: &Rows<'_, N>,
        d: &[f64; N],
    ) -> Option<(Constraint, f64)> {
        let mut worst = None;
        let mut least = -BOUND_TOLERANCE;
        for i in 0..N {
            for (constraint, slack) in [
                (Constraint::Lower(i), d[i] - quadratic.lower[i]),
                (Constraint::Upper(i), quadratic.upper[i] - d[i]),
            ] {
                if slack < least && !self.is_active(constraint) {
                    least = slack;
                    worst = Some((constraint, slack));
                }
            }
        }
        if worst.is_some() {
            return worst;
        }
        self.suspect(rows, d).or_else(|| {
            self.look_at_all(rows, d);
            self.suspect(rows, d)
        })
    }

    /// The suspect that is violated most.
    fn suspect(&self, rows: &Rows<'_, N>, d: &[f64; N]) -> Option<(Constraint, f64)> {
        let mut worst = None;
        let mut least = -ROW_TOLERANCE;
        for &(i, _) in self.suspects.iter().take(self.suspected) {
            let slack = rows.slack(i, d);
            if slack < least && !self.is_active(Constraint::Row(i)) {
                least = slack;
                worst = Some((Constraint::Row(i), slack));
            }
        }
        worst
    }

    /// Makes suspects of the rows that are violated most.
    fn look_at_all(&mut self, rows: &Rows<'_, N>, d: &[f64; N]) {
        self.suspected = 0;
        self.looks += rows.len;
        let mut least = -ROW_TOLERANCE;
        for i in 0..rows.len {
            let slack = rows.slack(i, d);
            if slack < least && !self.is_active(Constraint::Row(i)) {
                let mut place = self.suspected.min(MAX_SUSPECTS - 1);
                while place > 0 && self.suspects[place - 1].1 > slack {
                    self.suspects[place] = self.suspects[place - 1];
                    place -= 1;
                }
                self.suspects[place] = (i, slack);
                self.suspected = (self.suspected + 1).min(MAX_SUSPECTS);
                if self.suspected == MAX_SUSPECTS {
                    least = self.suspects[MAX_SUSPECTS - 1].1;
                }
            }
        }
    }

    fn is_active(&self, constraint: Constraint) -> bool {
        self.active[..self.count].contains(&constraint)
    }

    fn directions(&self, normal: &[f64; N]) -> Directions<N> {
        let projection: [f64; N] = core::array::from_fn(|k| dot(&self.columns[k], normal));
        let mut primal = [0.0; N];
        for k in self.count..N {
            for i in 0..N {
                primal[i] += projection[k] * self.columns[k][i];
            }
        }
        let mut exchange = [0.0; N];
        for k in (0..self.count).rev() {
            let mut sum = projection[k];
            for l in k + 1..self.count {
                sum -= self.triangle[l][k] * exchange[l];
            }
            exchange[k] = sum / self.triangle[k][k];
        }
        let curvature = dot(&primal, normal);
        Directions {
            independent: curvature > 1e-12 * dot(&projection, &projection),
            primal,
            projection,
            exchange,
            curvature,
        }
    }

    /// Makes a constraint active; `false` if its normal depends on the active ones.
    fn add(&mut self, entering: &Entering<N>, projection: &[f64; N]) -> bool {
        let count = self.count;
        if count >= N {
            return false;
        }
        let mut d = *projection;
        for j in (count + 1..N).rev() {
            let (a, b) = (d[j - 1], d[j]);
            if b == 0.0 {
                continue;
            }
            let length = sqrt(a * a + b * b);
            (d[j - 1], d[j]) = (length, 0.0);
            self.rotate_columns(j - 1, j, a / length, b / length);
        }
        if d[count].abs() < 1e-14 {
            return false;
        }
        self.triangle[count] = [0.0; N];
        self.triangle[count][..=count].copy_from_slice(&d[..=count]);
        self.active[count] = entering.constraint;
        self.multipliers[count] = entering.multiplier;
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
        for k in 0..N {
            let (x, y) = (self.columns[i][k], self.columns[j][k]);
            self.columns[i][k] = c * x + s * y;
            self.columns[j][k] = c * y - s * x;
        }
    }
}

fn dot<const N: usize>(a: &[f64; N], b: &[f64; N]) -> f64 {
    let mut sum = 0.0;
    for k in 0..N {
        sum += a[k] * b[k];
    }
    sum
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

    struct Problem<const N: usize> {
        quadratic: Quadratic<N>,
        rows: Rows<'static, N>,
        rho: f64,
    }

    impl<const N: usize> Problem<N> {
        fn random(random: &mut Random, rows: usize) -> Self {
            let mut hessian = [[0.0; N]; N];
            for _ in 0..2 * N {
                let a: [f64; N] = core::array::from_fn(|_| random.next());
                for i in 0..N {
                    for j in 0..N {
                        hessian[i][j] += a[i] * a[j];
                    }
                }
            }
            let gradient = core::array::from_fn(|_| 5.0 * random.next());
            // A few KB that are never given back.
            let workspace = vec![0.0; Rows::<N>::room(rows + 2)].leak();
            let mut store = Rows::new(rows + 2, workspace).unwrap();
            for _ in 0..rows {
                store.push(core::array::from_fn(|_| random.next()), random.next());
            }
            Self {
                quadratic: Quadratic {
                    hessian,
                    gradient,
                    lower: [-0.8; N],
                    upper: [0.8; N],
                },
                rows: store,
                rho: 4.0 * (1.0 + random.next()),
            }
        }

        fn solve(&mut self) -> Answer<N> {
            let mut workspace = vec![0.0; ActiveSet::<N>::ROOM];
            let mut method = ActiveSet::new(&mut workspace).unwrap();
            method.solve(&self.quadratic, &mut self.rows, self.rho, 500)
        }

        fn value(&self, d: &[f64; N]) -> f64 {
            self.quadratic.change(d) + self.rho * self.rows.violation(d)
        }
    }

    fn no_direction_improves<const N: usize>(random: &mut Random, rows: usize) {
        let mut problem = Problem::<N>::random(random, rows);
        let answer = problem.solve();
        assert_eq!(
            answer.status,
            QpStatus::Solved,
            "{N} variables, {rows} rows"
        );
        let best = problem.value(&answer.step);
        for _ in 0..60 {
            let length = 10f64.powf(-4.0 * random.next().abs());
            let other = answer
                .step
                .map(|x| (x + length * random.next()).clamp(-0.8, 0.8));
            let value = problem.value(&other);
            assert!(
                value >= best - 1e-7 * (1.0 + best.abs()),
                "{N} variables, {rows} rows: {value} < {best}"
            );
        }
    }

    #[test]
    fn no_direction_improves_the_answer_of_random_programs() {
        let mut random = Random(7);
        for _ in 0..20 {
            for rows in [0, 4, 20, 60] {
                no_direction_improves::<1>(&mut random, rows);
                no_direction_improves::<3>(&mut random, rows);
                no_direction_improves::<6>(&mut random, rows);
                no_direction_improves::<12>(&mut random, rows);
                no_direction_improves::<24>(&mut random, rows);
            }
        }
    }

    #[test]
    fn contradicting_rows_yield_and_the_answer_stays_in_the_bounds() {
        let mut problem = Problem::<6>::random(&mut Random(3), 0);
        problem.rows.push([1.0, 0.0, 0.0, 0.0, 0.0, 0.0], -1.0);
        problem.rows.push([-1.0, 0.0, 0.0, 0.0, 0.0, 0.0], -1.0);
        let answer = problem.solve();
        assert_eq!(answer.status, QpStatus::Solved);
        assert!(answer.yielded >= 1);
        assert!(answer.step.iter().all(|x| x.abs() <= 0.8));
    }

    #[test]
    fn a_bad_hessian_is_a_numerical_failure() {
        let mut problem = Problem::<6>::random(&mut Random(5), 4);
        problem.quadratic.hessian[2][2] = f64::NAN;
        let answer = problem.solve();
        assert_eq!(
            (answer.status, answer.step),
            (QpStatus::NumericalFailure, [0.0; 6])
        );
    }
}
