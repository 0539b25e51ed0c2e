//! Bounded sequential quadratic programming: the paper's optimal-control problem in a few microseconds.
//!
//! Each iteration expands the cost (Gauss-Newton) and the clearances about the present plan, solves the elastic
//! quadratic program of [`crate::qp`], and searches along its step for a sufficient decrease of the exact-penalty
//! merit *cost + rho x violation*. Iterations, active-set changes and line-search trials are all bounded, so the work
//! of a cycle is.
//!
//! Source: paper, Eq. (vpc); J. Nocedal and S. Wright, "Numerical Optimization", Ch. 18 (S l1 QP).

use crate::constraint::{self, Clearance};
use crate::cost::{self, Expansion};
use crate::prediction::{Origin, Plan, Preview, Previewed};
use crate::qp::{MAX_ROWS, QpStatus, QuadraticProgram, Row, Rows};
use crate::task::Task;
use crate::{DOF, MAX_VARIABLES, Points};

/// Halvings of a step before the line search gives up.
const MAX_HALVINGS: usize = 8;
/// Share of the predicted decrease that a step must achieve.
const SUFFICIENT_DECREASE: f64 = 1e-4;
/// Most times that one solution raises rho tenfold.
const MAX_RAISES: u32 = 4;
/// Violations below this are not counted as such, px.
const FEASIBLE: f64 = 0.05;
/// Active-set changes allowed a quadratic program, per variable.
const QP_CHANGES_PER_VARIABLE: u32 = 12;

/// How far to look for a solution.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Effort {
    /// Most iterations of sequential quadratic programming.
    pub max_iterations: u32,
    /// Optimality precision: stop when the predicted decrease of the merit is below this share of the merit.
    pub tolerance: f64,
}

/// The problem of one cycle.
#[derive(Clone, Copy, Debug)]
pub struct Problem<'a> {
    /// The task.
    pub task: &'a Task,
    /// Measured features and depths.
    pub origin: &'a Origin,
    /// What the features track: goal or way point, less the mismatch, px.
    pub target: &'a Points,
    /// Share of R that applies, 0 to 1.
    pub r_share: f64,
    /// Extra clearance kept from every border, px.
    pub margin: f64,
}

/// How a solution ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Status {
    /// Optimal to the tolerance, and no constraint violated.
    Converged,
    /// Feasible and finite, but the iterations ran out.
    IterationLimit,
    /// The line search found no decrease: the plan is optimal to what the model's accuracy allows.
    Stalled,
    /// The best plan found violates a constraint somewhere in the window.
    Infeasible,
    /// No plan could be computed; the solution is the zero twist.
    NumericalFailure,
}

impl Status {
    /// Whether the plan is an acceptable solution of the problem.
    pub fn is_success(self) -> bool {
        matches!(self, Self::Converged | Self::Stalled)
    }

    /// Whether the plan violates no constraint.
    pub fn is_feasible(self) -> bool {
        self.is_success() || self == Self::IterationLimit
    }
}

/// The solution of one cycle's problem.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Solution {
    /// The commands; the first one is sent.
    pub plan: Plan,
    /// How it ended.
    pub status: Status,
    /// Iterations made.
    pub iterations: u32,
    /// Active-set changes made in all quadratic programs.
    pub qp_iterations: u32,
    /// Value of the cost.
    pub cost: f64,
    /// Cost plus weighted violation.
    pub merit: f64,
    /// Worst predicted violation over the window, px.
    pub violation_px: f64,
    /// Worst predicted violation at the first step, px.
    pub next_violation_px: f64,
}

impl Solution {
    /// The solution of a problem that has none: the zero twist.
    const NONE: Self = Self {
        plan: [0.0; MAX_VARIABLES],
        status: Status::NumericalFailure,
        iterations: 0,
        qp_iterations: 0,
        cost: f64::INFINITY,
        merit: f64::INFINITY,
        violation_px: f64::INFINITY,
        next_violation_px: f64::INFINITY,
    };
}

/// What a plan leads to.
#[derive(Clone, Copy, Debug)]
struct Outcome {
    cost: f64,
    /// Sum of all violations, px.
    total: f64,
    /// Greatest violation, px.
    worst: f64,
    /// Greatest violation at the first step, px.
    next: f64,
}

impl Outcome {
    fn merit(&self, rho: f64) -> f64 {
        self.cost + rho * self.total
    }
}

/// The solver with its workspace; about half a megabyte, made once.
#[derive(Clone)]
pub struct Solver {
    preview: Preview,
    expansion: Expansion,
    rows: Rows,
    program: QuadraticProgram,
    effort: Effort,
}

impl Solver {
    /// A solver for a window of `np` steps and `nc` free commands.
    pub fn new(np: usize, nc: usize, effort: Effort) -> Self {
        Self {
            preview: Preview::new(np, nc),
            expansion: Expansion::empty(),
            rows: Rows::new(),
            program: QuadraticProgram::new(),
            effort,
        }
    }

    /// The preview of the plan that was looked at last.
    pub fn preview(&self) -> &Preview {
        &self.preview
    }

    /// Cost of a plan; `None` where the plan brings a point behind the camera.
    pub fn evaluate(&mut self, problem: &Problem<'_>, plan: &Plan) -> Option<f64> {
        self.preview
            .look(problem.task, problem.origin, plan)
            .then(|| {
                cost::value(
                    problem.task,
                    &self.preview,
                    plan,
                    problem.target,
                    problem.r_share,
                )
            })
    }

    /// Solves the problem from each start in turn until one solution violates nothing; otherwise returns the one
    /// that violates least. Counts the work of all.
    pub fn solve_from(&mut self, problem: &Problem<'_>, starts: &[Plan]) -> Solution {
        let mut best: Option<Solution> = None;
        let (mut iterations, mut qp_iterations) = (0, 0);
        for start in starts {
            let found = self.solve(problem, start);
            iterations += found.iterations;
            qp_iterations += found.qp_iterations;
            if best.is_none_or(|best| found.violation_px < best.violation_px) {
                best = Some(found);
            }
            if found.status.is_feasible() {
                break;
            }
        }
        Solution {
            iterations,
            qp_iterations,
            ..best.unwrap_or(Solution::NONE)
        }
    }

    /// Solves the problem from the warm start `warm`.
    pub fn solve(&mut self, problem: &Problem<'_>, warm: &Plan) -> Solution {
        let n = self.preview.variables();
        let limits = &problem.task.limits;
        let mut plan = clamped(warm, n, problem.task);
        let mut rho = penalty(problem, self.preview.np());
        let mut raises = 0;
        let mut solution = Solution::NONE;
        let start = match self.outcome(problem, &plan) {
            Some(start) => Some(start),
            None => {
                plan = [0.0; MAX_VARIABLES];
                self.outcome(problem, &plan)
            }
        };
        let Some(mut here) = start else {
            return solution;
        };
        let mut status = Status::IterationLimit;

        while solution.iterations < self.effort.max_iterations {
            solution.iterations += 1;
            let Self {
                preview,
                expansion,
                rows,
                program,
                ..
            } = self;
            cost::expand(
                problem.task,
                preview,
                &plan,
                problem.target,
                problem.r_share,
                expansion,
            );
            collect_rows(problem, preview, &plan, rows);
            let (mut lower, mut upper) = ([0.0; MAX_VARIABLES], [0.0; MAX_VARIABLES]);
            for k in 0..n {
                lower[k] = -limits[k % DOF] - plan[k];
                upper[k] = limits[k % DOF] - plan[k];
            }
            let mut step = [0.0; MAX_VARIABLES];
            let report = loop {
                let limit = QP_CHANGES_PER_VARIABLE * n as u32;
                let report = program.solve(
                    n,
                    &expansion.hessian,
                    &expansion.gradient,
                    &lower,
                    &upper,
                    rows,
                    rho,
                    limit,
                    &mut step,
                );
                solution.qp_iterations += report.iterations;
                // A row that yields says that rho is below its multiplier, or that the rows contradict each other.
                if report.yielded == 0 || raises == MAX_RAISES {
                    break report;
                }
                rho *= 10.0;
                raises += 1;
            };
            if report.status == QpStatus::NumericalFailure {
                status = Status::NumericalFailure;
                break;
            }

            let merit = here.merit(rho);
            let decrease = merit - model_merit(expansion, rows, &step, n, rho);
            if decrease <= self.effort.tolerance * (1e-6 + merit.abs()) {
                status = Status::Converged;
                break;
            }
            let mut share = 1.0;
            let mut accepted = false;
            for _ in 0..MAX_HALVINGS {
                let trial = core::array::from_fn(|k| plan[k] + share * step[k]);
                if let Some(there) = self.outcome(problem, &trial)
                    && there.merit(rho) <= merit - SUFFICIENT_DECREASE * share * decrease
                {
                    (plan, here, accepted) = (trial, there, true);
                    break;
                }
                share *= 0.5;
            }
            if !accepted {
                status = Status::Stalled;
                break;
            }
        }

        if status != Status::NumericalFailure && here.worst > problem.margin.max(0.0) + FEASIBLE {
            status = Status::Infeasible;
        }
        solution.plan = clamped(&plan, n, problem.task);
        solution.status = status;
        solution.cost = here.cost;
        solution.merit = here.merit(rho);
        solution.violation_px = here.worst;
        solution.next_violation_px = here.next;
        solution
    }

    /// Previews `plan` and sums up cost and violations.
    fn outcome(&mut self, problem: &Problem<'_>, plan: &Plan) -> Option<Outcome> {
        let task = problem.task;
        if !self.preview.run(task, problem.origin, plan) {
            return None;
        }
        self.sum_up(problem, plan)
    }

    /// Cost and violations of the previewed plan.
    fn sum_up(&self, problem: &Problem<'_>, plan: &Plan) -> Option<Outcome> {
        let task = problem.task;
        let cost = cost::value(task, &self.preview, plan, problem.target, problem.r_share);
        let mut outcome = Outcome {
            cost,
            total: 0.0,
            worst: 0.0,
            next: 0.0,
        };
        for j in 0..self.preview.np() {
            for &pixel in self.preview.step(j) {
                let violation = constraint::violation(task, pixel, problem.margin);
                outcome.total += violation;
                outcome.worst = outcome.worst.max(violation);
                if j == 0 {
                    outcome.next = outcome.next.max(violation);
                }
            }
        }
        outcome.merit(1.0).is_finite().then_some(outcome)
    }

    /// The worst violation of the first step under a plan, px; infinite where the plan is impossible.
    pub fn next_violation(&mut self, problem: &Problem<'_>, plan: &Plan) -> f64 {
        let possible = self.preview.look(problem.task, problem.origin, plan);
        if possible {
            worst_violation(problem, self.preview.step(0))
        } else {
            f64::INFINITY
        }
    }
}

/// The worst violation among some points, px: that of standing still, for the measured ones.
pub fn worst_violation(problem: &Problem<'_>, points: &[[f64; 2]]) -> f64 {
    let violation = |&pixel: &[f64; 2]| constraint::violation(problem.task, pixel, problem.margin);
    points.iter().map(violation).fold(0.0, f64::max)
}

/// The plan inside the velocity box; entries past `n` and non-finite ones are zero.
fn clamped(plan: &Plan, n: usize, task: &Task) -> Plan {
    core::array::from_fn(|k| {
        let limit = task.limits[k % DOF];
        if k < n && plan[k].is_finite() {
            plan[k].clamp(-limit, limit)
        } else {
            0.0
        }
    })
}

/// Where the penalty weight starts: a multiplier balances the pull of the image errors on the features, so ten times
/// the sum of all pulls (at least as if each error were 1 % of the image width) is above it unless the geometry is
/// extreme; then a row yields and rho is raised.
fn penalty(problem: &Problem<'_>, np: usize) -> f64 {
    let task = problem.task;
    let floor = 0.01 * task.camera.width;
    let pull: f64 = problem
        .origin
        .points
        .iter()
        .zip(problem.target)
        .map(|(s, t)| 2.0 * task.cost.k_q * libm::hypot(s[0] - t[0], s[1] - t[1]).max(floor))
        .sum();
    10.0 * pull * np as f64
}

/// The rows that the step may reach: a point's linearised clearance cannot be used up inside the velocity box
/// otherwise. Rows past the store's end belong to the last steps of the window, which the next cycles see again.
fn collect_rows(problem: &Problem<'_>, preview: &Preview, plan: &Plan, rows: &mut Rows) {
    rows.clear();
    let task = problem.task;
    let n = preview.variables();
    let mut range = [0.0; MAX_VARIABLES];
    for k in 0..n {
        range[k] = task.limits[k % DOF] + plan[k].abs();
    }
    for (_, point) in preview.previewed() {
        let reach: [f64; 2] = core::array::from_fn(|c| {
            point.gradient[c]
                .iter()
                .zip(&range)
                .take(n)
                .map(|(g, r)| g.abs() * r)
                .sum()
        });
        let mut add = |clearance: Clearance| {
            let clear = clearance.distance - problem.margin;
            let [a, b] = clearance.normal;
            if clear < a.abs() * reach[0] + b.abs() * reach[1] && rows.as_slice().len() < MAX_ROWS {
                rows.push(row(&point, clearance.normal, clear, n));
            }
        };
        constraint::border(&task.camera, point.pixel)
            .into_iter()
            .for_each(&mut add);
        for part in &task.parts {
            let gap = [
                (point.pixel[0] - part.center[0]).abs() - part.half[0] - problem.margin,
                (point.pixel[1] - part.center[1]).abs() - part.half[1] - problem.margin,
            ];
            if gap[0] < reach[0] && gap[1] < reach[1] {
                add(constraint::clearance(part, point.pixel));
            }
        }
    }
}

fn row(point: &Previewed<'_>, normal: [f64; 2], clearance: f64, n: usize) -> Row {
    let mut gradient = [0.0; MAX_VARIABLES];
    for k in 0..n {
        gradient[k] = normal[0] * point.gradient[0][k] + normal[1] * point.gradient[1][k];
    }
    Row {
        gradient,
        clearance,
    }
}

/// The merit that the quadratic model and the linearised rows predict for a step.
fn model_merit(expansion: &Expansion, rows: &Rows, step: &Plan, n: usize, rho: f64) -> f64 {
    let dot = |a: &Plan| -> f64 { a.iter().zip(step).take(n).map(|(a, s)| a * s).sum() };
    let curve: f64 = step
        .iter()
        .zip(&expansion.hessian)
        .take(n)
        .map(|(s, row)| 0.5 * s * dot(row))
        .sum();
    let violation: f64 = rows
        .as_slice()
        .iter()
        .map(|row| (-(dot(&row.gradient) + row.clearance)).max(0.0))
        .sum();
    expansion.value + dot(&expansion.gradient) + curve + rho * violation
}
