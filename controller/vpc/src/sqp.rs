//! The method: sequential quadratic programming in `N` variables, one solution at a time.

use crate::constraint::{self, Clearance};
use crate::cost::{self, Expansion};
use crate::field;
use crate::prediction::{Plan, Preview};
use crate::qp::{ActiveSet, MAX_ROWS, QpStatus, Quadratic, Rows};
use crate::solver::{Effort, Problem, Solution, Status, work};
use crate::task::Task;
use crate::{DOF, MAX_VARIABLES};

/// Halvings of a step before the line search gives up.
const MAX_HALVINGS: usize = 8;
/// Share of the predicted decrease that a step must achieve.
const SUFFICIENT_DECREASE: f64 = 1e-4;
/// Most times that one solution raises rho: one raise this large tells a weight that was too small from rows that
/// contradict each other.
const MAX_RAISES: u32 = 1;
/// What a raise multiplies rho by.
const RAISE: f64 = 1e3;
/// Most second-order corrections of a step that the curvature of the clearances spoils.
const MAX_CORRECTIONS: usize = 2;
/// Violations below this are not counted as such, px.
const FEASIBLE: f64 = 0.05;
/// Active-set changes allowed a quadratic program, per variable.
const QP_CHANGES_PER_VARIABLE: u32 = 6;

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

/// A point of a previewed step, and which of its clearances: sides 0 to 3 as in [`constraint::border`], then parts, then
/// areas.
#[derive(Clone, Copy, Debug)]
struct Source {
    step: u8,
    point: u8,
    side: u8,
}

impl Source {
    const NONE: Self = Self {
        step: 0,
        point: 0,
        side: 0,
    };
}

/// The method's workspace for `N = 6 nc` variables.
#[derive(Clone)]
pub(crate) struct Sqp<const N: usize> {
    preview: Preview<N>,
    rows: Rows<N>,
    /// What each row is the clearance of.
    sources: [Source; MAX_ROWS],
    program: ActiveSet<N>,
    effort: Effort,
    /// Most work of a solution from all starts, and that of the present start.
    budget: u32,
    work: u32,
}

impl<const N: usize> Sqp<N> {
    pub(crate) fn new(np: usize, effort: Effort) -> Self {
        Self {
            preview: Preview::new(np),
            rows: Rows::new(),
            sources: [Source::NONE; MAX_ROWS],
            program: ActiveSet::new(),
            effort,
            budget: u32::MAX,
            work: 0,
        }
    }

    pub(crate) fn limit_work(&mut self, budget: u32) {
        self.budget = budget;
    }

    /// Cost of a plan; `None` where the plan brings a point behind the camera.
    pub(crate) fn evaluate(&mut self, problem: &Problem<'_>, plan: &Plan) -> Option<f64> {
        let plan = head(plan);
        let (task, target) = (problem.task, problem.target);
        let possible = self.preview.look(task, problem.origin, &plan);
        possible.then(|| cost::value(task, &self.preview, &plan, target, problem.r_share))
    }

    /// The worst violation of the first step under a plan, px; infinite where the plan is impossible.
    pub(crate) fn next_violation(&mut self, problem: &Problem<'_>, plan: &Plan) -> f64 {
        let possible = self.preview.look(problem.task, problem.origin, &head(plan));
        if possible {
            problem.worst_violation(self.preview.step(0))
        } else {
            f64::INFINITY
        }
    }

    /// Solves the problem from the warm start `warm`, with some quarters of the budget of work.
    pub(crate) fn solve(&mut self, problem: &Problem<'_>, warm: &Plan, quarters: u32) -> Solution {
        self.work = 0;
        let budget = self.budget / 4 * quarters;
        let mut plan: [f64; N] = clamped(&head(warm), problem.task);
        let mut rho = penalty(problem, self.preview.np());
        let mut raises = 0;
        let mut solution = Solution::NONE;
        let mut outcome = self.outcome(problem, &plan);
        if outcome.is_none() {
            plan = [0.0; N];
            outcome = self.outcome(problem, &plan);
        }
        let Some(mut here) = outcome else {
            solution.work = self.work;
            return solution;
        };
        let mut status = Status::IterationLimit;

        while solution.iterations < self.effort.max_iterations && self.work < budget {
            solution.iterations += 1;
            self.work += work::expansion(self.preview.np());
            let Expansion {
                value,
                gradient,
                hessian,
            } = Expansion::about(
                problem.task,
                &self.preview,
                &plan,
                problem.target,
                problem.r_share,
            );
            let limits = &problem.task.limits;
            let quadratic = Quadratic {
                hessian,
                gradient,
                lower: core::array::from_fn(|k| -limits[k % DOF] - plan[k]),
                upper: core::array::from_fn(|k| limits[k % DOF] - plan[k]),
            };
            collect(
                problem,
                &self.preview,
                &quadratic,
                &mut self.rows,
                &mut self.sources,
            );
            let answer = loop {
                let limit = self.changes_left(budget);
                let answer = self.program.solve(&quadratic, &mut self.rows, rho, limit);
                solution.qp_iterations += answer.iterations;
                self.work += answer.iterations;
                // A row that yields says that rho is below its multiplier, or that the rows contradict each other.
                if answer.yielded == 0 || raises == MAX_RAISES {
                    break answer;
                }
                rho *= RAISE;
                raises += 1;
            };
            if answer.status == QpStatus::NumericalFailure {
                status = Status::NumericalFailure;
                break;
            }

            let step = answer.step;
            let merit = here.merit(rho);
            let predicted = value + quadratic.change(&step) + rho * self.rows.violation(&step);
            let decrease = merit - predicted;
            if decrease <= self.effort.tolerance * (1e-6 + merit.abs()) {
                status = Status::Converged;
                break;
            }
            let mut accepted = false;
            // A step along a curved border is spoilt by what its linear rows leave out: rows that pass through the
            // clearances found there mend it.
            let mut corrected = step;
            for correction in 0..=MAX_CORRECTIONS {
                let trial = core::array::from_fn(|k| plan[k] + corrected[k]);
                let Some(there) = self.outcome(problem, &trial) else {
                    break;
                };
                if there.merit(rho) <= merit - SUFFICIENT_DECREASE * decrease {
                    (plan, here, accepted) = (trial, there, true);
                    break;
                }
                if correction == MAX_CORRECTIONS || there.total <= here.total {
                    break;
                }
                self.correct(problem, &corrected);
                let limit = self.changes_left(budget);
                let answer = self.program.solve(&quadratic, &mut self.rows, rho, limit);
                solution.qp_iterations += answer.iterations;
                self.work += answer.iterations;
                if answer.status == QpStatus::NumericalFailure {
                    break;
                }
                corrected = answer.step;
            }
            if accepted {
                continue;
            }
            let mut share = 0.5;
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
        let plan = clamped(&plan, problem.task);
        solution.plan[..N].copy_from_slice(&plan);
        solution.status = status;
        solution.work = self.work;
        solution.cost = here.cost;
        solution.merit = here.merit(rho);
        solution.violation_px = here.worst;
        solution.next_violation_px = here.next;
        solution
    }

    /// Active-set changes that the next quadratic program may make: as many as a hard one takes, unless the budget
    /// comes first.
    fn changes_left(&self, budget: u32) -> u32 {
        (QP_CHANGES_PER_VARIABLE * N as u32).min(budget.saturating_sub(self.work))
    }

    /// Gives every row the clearance of the previewed plan, which is `step` away from where it was made.
    fn correct(&mut self, problem: &Problem<'_>, step: &[f64; N]) {
        let task = problem.task;
        for (i, source) in self.sources.iter().enumerate().take(self.rows.len()) {
            let pixel = self.preview.step(source.step.into())[usize::from(source.point)];
            let clearance = match usize::from(source.side) {
                side @ 0..4 => constraint::border(&task.camera, pixel)[side],
                side => match task.parts.get(side - 4) {
                    Some(part) => constraint::clearance(part, pixel),
                    None => field::clearance(&task.areas[side - 4 - task.parts.len()], pixel),
                },
            };
            self.rows
                .correct(i, clearance.distance - problem.margin, step);
        }
    }

    /// Previews `plan` and sums up cost and violations; `None` where it is impossible.
    fn outcome(&mut self, problem: &Problem<'_>, plan: &[f64; N]) -> Option<Outcome> {
        let task = problem.task;
        self.work += work::look(self.preview.np());
        if !self.preview.run(task, problem.origin, plan) {
            return None;
        }
        let (target, r_share) = (problem.target, problem.r_share);
        let mut outcome = Outcome {
            cost: cost::value(task, &self.preview, plan, target, r_share),
            total: 0.0,
            worst: 0.0,
            next: 0.0,
        };
        for j in 0..self.preview.np() {
            for &pixel in self.preview.step(j) {
                let violation = constraint::violation(task, pixel, problem.margin);
                outcome.total += violation;
                outcome.worst = outcome.worst.max(violation);
            }
            if j == 0 {
                outcome.next = outcome.worst;
            }
        }
        outcome.merit(1.0).is_finite().then_some(outcome)
    }
}

/// The entries of a plan that count.
fn head<const N: usize>(plan: &Plan) -> [f64; N] {
    const { assert!(N <= MAX_VARIABLES) };
    core::array::from_fn(|k| plan[k])
}

/// The plan inside the velocity box; entries that are not finite are zero.
fn clamped<const N: usize>(plan: &[f64; N], task: &Task) -> [f64; N] {
    core::array::from_fn(|k| {
        let limit = task.limits[k % DOF];
        if plan[k].is_finite() {
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

/// Collects the rows that a step inside its bounds can reach: no other linearised clearance can be used up. Rows past
/// the store's end belong to the last steps of the window, which the next cycles see again.
fn collect<const N: usize>(
    problem: &Problem<'_>,
    preview: &Preview<N>,
    bounds: &Quadratic<N>,
    rows: &mut Rows<N>,
    sources: &mut [Source; MAX_ROWS],
) {
    rows.clear();
    let (task, margin) = (problem.task, problem.margin);
    let numbered = preview.steps().enumerate();
    let numbered =
        numbered.flat_map(|(j, step)| step.enumerate().map(move |(i, point)| (j, i, point)));
    for (j, i, point) in numbered {
        // The box that the linearised point cannot leave.
        let (mut low, mut high) = (point.pixel, point.pixel);
        for c in 0..2 {
            for k in 0..N {
                let slope = point.gradient[c][k];
                let (a, b) = (slope * bounds.lower[k], slope * bounds.upper[k]);
                low[c] += a.min(b);
                high[c] += a.max(b);
            }
        }
        let mut add = |side: usize, clearance: Clearance| {
            if rows.len() < MAX_ROWS {
                sources[rows.len()] = Source {
                    step: j as u8,
                    point: i as u8,
                    side: side as u8,
                };
                let [a, b] = clearance.normal;
                let [u, v] = point.gradient;
                rows.push(
                    core::array::from_fn(|k| a * u[k] + b * v[k]),
                    clearance.distance - margin,
                );
            }
        };
        let [left, top, right, bottom] = constraint::border(&task.camera, point.pixel);
        let size = [task.camera.width, task.camera.height];
        for (c, near, far) in [(0, left, right), (1, top, bottom)] {
            if low[c] < margin {
                add(c, near);
            }
            if high[c] > size[c] - margin {
                add(c + 2, far);
            }
        }
        for (index, part) in task.parts.iter().enumerate() {
            let reached = (0..2).all(|c| {
                let half = part.half[c] + margin;
                high[c] > part.center[c] - half && low[c] < part.center[c] + half
            });
            if reached {
                add(4 + index, constraint::clearance(part, point.pixel));
            }
        }
        for (index, area) in task.areas.iter().enumerate() {
            let reached =
                (0..2).all(|c| high[c] > area.low[c] - margin && low[c] < area.high[c] + margin);
            if reached {
                let side = 4 + task.parts.len() + index;
                add(side, field::clearance(area, point.pixel));
            }
        }
    }
}
