//! The method: sequential quadratic programming with an exact penalty, in `N` variables.
//!
//! Each iteration expands the cost (Gauss-Newton) and the clearances about the present plan, solves
//! the elastic quadratic program of [`crate::qp`], and takes its step if the merit falls: as it is,
//! corrected to the second order, or shortened. Iterations, changes of active sets and trials are
//! bounded, and so is the work of a cycle.
//!
//! | Symbol | Here | Meaning |
//! |---|---|---|
//! | V | `plan` | the variables: Nc commands, m/s and rad/s |
//! | d | `step` | a change of V |
//! | l(V), c(V) | [`Outcome::cost`], [`Outcome::change`] | the cost; that of changing the command |
//! | c_i(V), margin | `Source` | clearance of a marker's edge from a border; its lower bound, px |
//! | m(V) = l(V) + c(V) + rho sum_i max(0, margin - c_i) | [`Outcome::merit`] | the merit |
//! | rho | [`Progress::rho`] | the penalty weight, 1/px |
//!
//! Source: J. Nocedal and S. Wright, "Numerical Optimization", Ch. 18 (S l1 QP).
#![expect(
    clippy::indexing_slicing,
    reason = "indices run over the N variables, the DOF components or the 2 coordinates of arrays of that length"
)]

use crate::clearance::Place;
use crate::constraint;
use crate::cost::{self, Expansion};
use crate::intersample::{Intersample, NEAR_PX};
use crate::prediction::{Plan, Preview};
use crate::problem::{Problem, Solution, SolverOptions, Status};
use crate::qp::{ActiveSet, Answer, QpStatus, Quadratic, Rows};
use crate::size::Size;
use crate::work::Prices;
use crate::workspace::Workspace;
use crate::{DOF, MAX_VARIABLES, Twist};

/// Halvings of a step before the line search gives up.
const MAX_HALVINGS: usize = 8;
/// Share of the predicted decrease that a step must achieve.
const SUFFICIENT_DECREASE: f64 = 1e-4;
/// Most times that one solution raises rho. One raise this large tells a weight that was too small
/// from rows that contradict each other.
const MAX_RAISES: u32 = 1;
/// What a raise multiplies rho by.
const RAISE: f64 = 1e3;
/// Most second-order corrections of a step that the curvature of the clearances spoils.
const MAX_CORRECTIONS: usize = 2;
/// Violations below this are not counted as such, px.
const FEASIBLE: f64 = 0.05;
/// Active-set changes allowed a quadratic program, per variable.
const QP_CHANGES_PER_VARIABLE: u32 = 6;

/// Without a warm start: most iterations without constraints, those of each search before the
/// better one goes on, and the share of rho with which these two begin.
const RELAXED: u32 = 4;
const HEAT: u32 = 2;
const SOFT: f64 = 0.1;
/// Iterations without constraints end where one leaves more than this share of the merit.
const LEVEL: f64 = 0.99;

/// The cost and the violations of a plan.
#[derive(Clone, Copy, Debug)]
struct Outcome {
    cost: f64,
    /// The weight on changes of the command.
    change: f64,
    /// Sum of all violations, px.
    total: f64,
    /// Greatest violation, px.
    worst: f64,
}

impl Outcome {
    fn merit(&self, rho: f64) -> f64 {
        self.cost + self.change + rho * self.total
    }
}

/// A plan and its outcome.
#[derive(Clone, Copy, Debug)]
struct Iterate<const N: usize> {
    plan: [f64; N],
    outcome: Outcome,
}

/// The clearance that a row linearises: of which point in which step, from which of the
/// [borders](constraint::border); or the linear bound on a free command.
#[derive(Clone, Copy, Debug)]
struct Source {
    /// 0 is the first; [`INSIDE`] the deepest place on the way of the first command; [`LINEAR`]
    /// none.
    step: usize,
    point: usize,
    border: usize,
}

impl Source {
    /// As it is kept in a workspace, which has numbers of this type alone.
    fn stored(self) -> [f64; 3] {
        [self.step, self.point, self.border].map(|x| x as f64)
    }

    fn read(stored: &[f64; 3]) -> Self {
        let [step, point, border] = stored.map(|x| x as usize);
        Self {
            step,
            point,
            border,
        }
    }
}

/// The "step" of a row for a place on the way of the first command.
const INSIDE: usize = 255;

/// The "step" of a linear bound on a command, which is exact.
const LINEAR: usize = 254;

/// How far the present solution has come.
#[derive(Clone, Copy, Debug, Default)]
struct Progress {
    iterations: u32,
    qp_iterations: u32,
    work: u32,
    /// Most work of this solution.
    budget: u32,
    rho: f64,
    /// How often rho was raised.
    raises: u32,
}

/// The method and its workspace for `N = 6 nc` variables.
pub(crate) struct Sqp<'w, const N: usize> {
    /// The preview of the plan that was evaluated last.
    preview: Preview<'w, N>,
    /// The way of the features in its first period.
    inside: Intersample<'w>,
    rows: Rows<'w, N>,
    /// Of each row.
    sources: &'w mut [[f64; 3]],
    program: ActiveSet<'w, N>,
    options: SolverOptions,
    prices: Prices,
    progress: Progress,
    /// Work of everything so far.
    done: u64,
}

impl<'w, const N: usize> Sqp<'w, N> {
    /// Numbers of workspace for problems of this size.
    pub(crate) const fn room(size: Size) -> usize {
        Preview::<N>::room(size.np, size.points)
            + Intersample::room(size.stretches, size.points)
            + Rows::<N>::room(size.rows)
            + 3 * size.rows
            + ActiveSet::<N>::ROOM
    }

    /// The method in a workspace of [`Sqp::room`] numbers; `None` if that is too short.
    pub(crate) fn new(
        size: Size,
        options: SolverOptions,
        workspace: &mut Workspace<'w>,
    ) -> Option<Self> {
        Some(Self {
            preview: Preview::cut(size.np, size.points, workspace)?,
            inside: Intersample::cut(size.stretches, size.points, workspace)?,
            rows: Rows::cut(size.rows, workspace)?,
            sources: workspace.arrays(size.rows)?,
            program: ActiveSet::cut(workspace)?,
            options,
            prices: Prices::of(size),
            progress: Progress::default(),
            done: 0,
        })
    }

    /// Cost of a plan; `None` if the plan brings a point behind the camera.
    pub(crate) fn evaluate(&mut self, problem: &Problem<'_>, plan: &Plan) -> Option<f64> {
        let plan = head(plan);
        self.count(self.prices.evaluation);
        let possible = (self.preview).evaluate(problem.task, problem.initial, &plan, problem.ts);
        possible.then(|| cost::value(problem, &self.preview, &plan))
    }

    /// Whether the first period of a plan brings no point deeper into an obstacle, or further out
    /// of the image, than it is already, or than `slack`, px; or else leads out of what is violated
    /// already: the sum of all violations falls, and none is above the greatest of now.
    pub(crate) fn is_clear(&mut self, problem: &Problem<'_>, plan: &Plan, slack: f64) -> bool {
        let (task, initial, plan) = (problem.task, problem.initial, head(plan));
        self.count(self.prices.evaluation);
        let is_possible = self.preview.evaluate(task, initial, &plan, problem.ts);
        if !is_possible || !self.trace(problem, &plan) {
            return false;
        }
        let depth = |at: Place| constraint::violation(task, at.pixel, problem.margin + at.radius);
        let (pixels, radii) = (initial.explained(task), initial.radii(task));
        let begins = pixels.into_iter().zip(radii);
        let begins = begins.map(|(pixel, radius)| Place { pixel, radius });
        if problem.is_worse_than_braking(&first_command(&plan), slack) {
            return false;
        }
        let (mut is_clear, mut sums, mut worst) = (true, [0.0; 2], [0.0_f64; 2]);
        for (i, (begin, end)) in begins.zip(self.preview.places(0)).enumerate() {
            let inside = self.inside.violation(task, i, problem.margin);
            let end = if task.brakes() { 0.0 } else { depth(end) };
            let (before, after) = (depth(begin), end.max(inside));
            is_clear &= after <= before.max(slack);
            sums = [sums[0] + before, sums[1] + after];
            worst = [worst[0].max(before), worst[1].max(after)];
        }
        is_clear || (sums[1] < sums[0] && worst[1] <= worst[0])
    }

    /// Follows the features along the first command of the plan that was previewed last.
    fn trace(&mut self, problem: &Problem<'_>, plan: &[f64; N]) -> bool {
        let (task, initial, twist) = (problem.task, problem.initial, first_command(plan));
        let is_dense = self.options.intersample;
        let seconds = problem.way(&twist).seconds;
        let (twist, inside) = ((&twist, seconds), &mut self.inside);
        if !task.brakes() {
            let ends = (self.preview.step(0), self.preview.radii(0));
            return inside.trace(task, initial, twist, ends, is_dense);
        }
        let Some((ends, radii)) = initial.ends(task, twist.0, seconds) else {
            return false;
        };
        inside.trace(task, initial, twist, (&ends, &radii), is_dense)
    }

    /// Solves the problem from the warm start `warm` with so much work at most.
    pub(crate) fn solve(&mut self, problem: &Problem<'_>, warm: &Plan, budget: u32) -> Solution {
        self.begin(problem, budget);
        match self.first(problem, warm) {
            Some(here) => self.finish(problem, here),
            None => self.failure(),
        }
    }

    /// Solves the problem without a warm start, with so much work at most: searches from
    /// `standing`, and from where the plan would lead if nothing were in the way, for a few
    /// iterations each; the better search goes on.
    pub(crate) fn solve_cold(
        &mut self,
        problem: &Problem<'_>,
        standing: &Plan,
        budget: u32,
    ) -> Solution {
        self.begin(problem, budget);
        let Some(standing) = self.first(problem, standing) else {
            return self.failure();
        };
        let free = self.relaxed(problem, standing);
        let mut best = free;
        if free.outcome.worst > FEASIBLE {
            let first_rho = self.progress.rho;
            let found = [free, standing].map(|start| {
                (self.progress.rho, self.progress.raises) = (SOFT * first_rho, 0);
                let limit = self.progress.iterations + HEAT;
                let start = self.outcome(problem, start.plan)?;
                let (found, _) = self.search(problem, start, limit)?;
                let Progress { rho, raises, .. } = self.progress;
                Some((found, rho.max(first_rho), raises))
            });
            let found = || found.iter().flatten();
            let rho = found().map(|(_, rho, _)| *rho).fold(first_rho, f64::max);
            let merit = |at: &Iterate<N>| at.outcome.merit(rho);
            let better = found().min_by(|a, b| merit(&a.0).total_cmp(&merit(&b.0)));
            let better = better.copied().unwrap_or((standing, first_rho, 0));
            (best, self.progress.rho, self.progress.raises) = better;
        }
        match self.outcome(problem, best.plan) {
            Some(here) => self.finish(problem, here),
            None => self.failure(),
        }
    }

    fn begin(&mut self, problem: &Problem<'_>, budget: u32) {
        self.progress = Progress {
            budget,
            rho: first_rho(problem, self.preview.np()),
            ..Progress::default()
        };
        self.count(self.prices.arm);
    }

    /// Searches from the plan that was evaluated last to the end.
    fn finish(&mut self, problem: &Problem<'_>, here: Iterate<N>) -> Solution {
        let most = self.options.max_iterations;
        let limit = self.progress.iterations.saturating_add(most);
        match self.search(problem, here, limit) {
            Some((here, status)) => self.solution(problem, &here, status),
            None => self.failure(),
        }
    }

    /// Iterates from the plan that was evaluated last until so many iterations are done; `None` on a
    /// numerical failure.
    fn search(
        &mut self,
        problem: &Problem<'_>,
        mut here: Iterate<N>,
        limit: u32,
    ) -> Option<(Iterate<N>, Status)> {
        while self.may_go_on(limit) {
            let (cost, quadratic) = self.expand(problem, &here.plan);
            self.collect_rows(problem, &here.plan, &quadratic);
            let Answer { step, status, .. } = self.solve_program_raising_rho(&quadratic);
            if status == QpStatus::NumericalFailure {
                return None;
            }
            let rho = self.progress.rho;
            let merit = here.outcome.merit(rho);
            self.count(self.rows.len() as u32 * self.prices.look);
            let predicted = cost + quadratic.change(&step) + rho * self.rows.violation(&step);
            let decrease = merit - predicted;
            if decrease <= self.options.tolerance * (1e-6 + merit.abs()) {
                // A program that was cut short says nothing of optimality.
                let status = match status {
                    QpStatus::Solved => Status::Converged,
                    _ => Status::IterationLimit,
                };
                return Some((here, status));
            }
            let next = self
                .full_step(problem, &here, &quadratic, step, decrease)
                .or_else(|| self.line_search(problem, &here, &step, decrease));
            match next {
                Some(next) => here = next,
                None if !self.may_go_on(limit) => break,
                None => return Some((here, Status::Stalled)),
            }
        }
        Some((here, Status::IterationLimit))
    }

    /// Where a few iterations lead that know of no constraint but the bounds.
    fn relaxed(&mut self, problem: &Problem<'_>, mut here: Iterate<N>) -> Iterate<N> {
        let limit = self.progress.iterations + RELAXED;
        while self.may_go_on(limit) {
            let (_, quadratic) = self.expand(problem, &here.plan);
            self.rows.clear();
            let step = self.solve_program(&quadratic).step;
            let before = here.outcome.merit(0.0);
            let there = [1.0, 0.5, 0.25].iter().find_map(|share| {
                let there = self.outcome(problem, moved(&here.plan, &step, *share))?;
                (there.outcome.merit(0.0) < before).then_some(there)
            });
            let Some(there) = there else { break };
            here = there;
            if here.outcome.merit(0.0) > LEVEL * before {
                break;
            }
        }
        here
    }

    /// The program that the first iteration from `plan` solves, and its rho.
    pub(crate) fn program_about(
        &mut self,
        problem: &Problem<'_>,
        plan: &Plan,
    ) -> Option<(Quadratic<N>, &Rows<'w, N>, f64)> {
        let here = self.first(problem, plan)?;
        let (_, quadratic) = self.expand(problem, &here.plan);
        self.collect_rows(problem, &here.plan, &quadratic);
        let rho = first_rho(problem, self.preview.np());
        Some((quadratic, &self.rows, rho))
    }

    /// The warm start inside its bounds; as near to standing still as these allow where that is
    /// impossible.
    fn first(&mut self, problem: &Problem<'_>, warm: &Plan) -> Option<Iterate<N>> {
        self.outcome(problem, clamped(&head(warm), problem))
            .or_else(|| self.outcome(problem, clamped(&[0.0; N], problem)))
    }

    /// Work of everything that this solver has done.
    pub(crate) fn done(&self) -> u64 {
        self.done
    }

    fn count(&mut self, work: u32) {
        self.progress.work = self.progress.work.saturating_add(work);
        self.done += u64::from(work);
    }

    fn may_go_on(&self, limit: u32) -> bool {
        self.progress.iterations < limit && self.progress.work < self.progress.budget
    }

    /// Begins an iteration: the cost, and its expansion about the plan that was evaluated last,
    /// with the bounds of a step.
    fn expand(&mut self, problem: &Problem<'_>, plan: &[f64; N]) -> (f64, Quadratic<N>) {
        self.progress.iterations += 1;
        self.count(self.prices.expansion);
        let expansion = Expansion::about(problem, &self.preview, plan);
        let bounds: [_; N] = core::array::from_fn(|k| problem.bounds(k));
        let quadratic = Quadratic {
            hessian: expansion.hessian,
            gradient: expansion.gradient,
            lower: core::array::from_fn(|k| bounds[k][0] - plan[k]),
            upper: core::array::from_fn(|k| bounds[k][1] - plan[k]),
        };
        (expansion.value, quadratic)
    }

    /// Collects the rows that a step inside its bounds can reach: no other linearised clearance can
    /// be used up. Linear ones and those on the way of the first command come first; rows past the
    /// store's end belong to the last steps of the window, which the next cycles see again.
    fn collect_rows(&mut self, problem: &Problem<'_>, plan: &[f64; N], bounds: &Quadratic<N>) {
        self.rows.clear();
        let (task, margin) = (problem.task, problem.margin);
        let Self {
            rows,
            sources,
            preview,
            inside,
            ..
        } = self;
        // Returns whether there is room for another one.
        let mut add = |step, point, border, distance: f64, gradient| {
            let source = Source {
                step,
                point,
                border,
            };
            if let Some(place) = sources.get_mut(rows.len()) {
                *place = source.stored();
            }
            rows.push(gradient, distance)
        };
        for (index, row) in problem.rows().enumerate() {
            let (commands, slope) = (plan.as_chunks::<DOF>().0, row.slope());
            for (command, twist) in commands.iter().enumerate() {
                let gradient: [f64; N] = core::array::from_fn(|k| match k / DOF == command {
                    true => slope[k % DOF],
                    false => 0.0,
                });
                let distance = row.clearance_px(twist);
                if distance < greatest(&gradient.map(|g| -g), bounds) {
                    add(LINEAR, command, index, distance, gradient);
                }
            }
        }
        let command = first_command(plan);
        let way = problem.way(&command);
        for i in inside.near() {
            for (index, border) in inside.borders(task, i, margin + NEAR_PX) {
                let Some((share, clearance)) = inside.deepest(i, border) else {
                    continue;
                };
                let (slope, growth) =
                    (problem.initial).passing_gradient(task, &command, (share, &way), i);
                let mut first = clearance.along(&slope);
                if task.has_markers() {
                    reduce(&mut first, &growth);
                }
                let gradient = core::array::from_fn(|k| first.get(k).copied().unwrap_or(0.0));
                add(INSIDE, i, index, clearance.distance - margin, gradient);
            }
        }
        'window: for (j, step) in preview.steps().enumerate().take(problem.watched) {
            for (i, point) in step.enumerate() {
                let place = point.place;
                let reach = reach(place.pixel, point.gradient, bounds);
                let mut most = margin + place.radius;
                if task.has_markers() {
                    most += greatest(point.growth, bounds);
                }
                for (index, border) in constraint::borders_near(task, reach, most) {
                    let clearance = border.clearance_of(place);
                    let mut gradient = clearance.along(point.gradient);
                    if task.has_markers() {
                        reduce(&mut gradient, point.growth);
                    }
                    if !add(j, i, index, clearance.distance - margin, gradient) {
                        break 'window;
                    }
                }
            }
        }
        self.count(self.rows.len() as u32 * self.prices.row);
    }

    /// Solves the quadratic program, and again with a larger rho if rows yield: rho was below their
    /// multipliers, or the rows contradict each other.
    fn solve_program_raising_rho(&mut self, quadratic: &Quadratic<N>) -> Answer<N> {
        loop {
            let answer = self.solve_program(quadratic);
            if answer.yielded == 0 || self.progress.raises == MAX_RAISES {
                return answer;
            }
            self.progress.rho *= RAISE;
            self.progress.raises += 1;
        }
    }

    /// Solves the quadratic program in as many changes as a hard one takes, unless the budget ends
    /// first.
    fn solve_program(&mut self, quadratic: &Quadratic<N>) -> Answer<N> {
        let Progress {
            budget, work, rho, ..
        } = self.progress;
        let left = budget.saturating_sub(work) / self.prices.change;
        let limit = left.min(QP_CHANGES_PER_VARIABLE * N as u32);
        let answer = self.program.solve(quadratic, &mut self.rows, rho, limit);
        self.progress.qp_iterations += answer.iterations;
        self.count(answer.iterations * self.prices.change + answer.looks * self.prices.look);
        answer
    }

    /// The full step, if the merit falls enough. A step along a curved border is spoilt by what its
    /// linear rows leave out; rows through the clearances at the trial point correct it.
    fn full_step(
        &mut self,
        problem: &Problem<'_>,
        here: &Iterate<N>,
        quadratic: &Quadratic<N>,
        mut step: [f64; N],
        decrease: f64,
    ) -> Option<Iterate<N>> {
        for correction in 0..=MAX_CORRECTIONS {
            let there = self.outcome(problem, moved(&here.plan, &step, 1.0))?;
            if self.is_descent(here, &there, decrease) {
                return Some(there);
            }
            if correction == MAX_CORRECTIONS || there.outcome.total <= here.outcome.total {
                break;
            }
            self.correct_rows(problem, &step);
            let answer = self.solve_program(quadratic);
            if answer.status == QpStatus::NumericalFailure {
                break;
            }
            step = answer.step;
        }
        None
    }

    /// The longest of some halvings of the step by which the merit falls enough. It may pass the
    /// budget by half.
    fn line_search(
        &mut self,
        problem: &Problem<'_>,
        here: &Iterate<N>,
        step: &[f64; N],
        decrease: f64,
    ) -> Option<Iterate<N>> {
        let mut share = 1.0;
        (0..MAX_HALVINGS).find_map(|_| {
            if self.progress.work >= (self.progress.budget / 2).saturating_mul(3) {
                return None;
            }
            share *= 0.5;
            let there = self.outcome(problem, moved(&here.plan, step, share))?;
            self.is_descent(here, &there, share * decrease)
                .then_some(there)
        })
    }

    fn is_descent(&self, here: &Iterate<N>, there: &Iterate<N>, decrease: f64) -> bool {
        let [here, there] = [here, there].map(|at| at.outcome.merit(self.progress.rho));
        there <= here - SUFFICIENT_DECREASE * decrease
    }

    /// Gives every row the clearance of the previewed plan, which is `step_taken` away from where
    /// the row was made.
    fn correct_rows(&mut self, problem: &Problem<'_>, step_taken: &[f64; N]) {
        let (task, margin) = (problem.task, problem.margin);
        self.count(self.rows.len() as u32 * (self.prices.row + self.prices.look));
        for (row, source) in self.sources.iter().enumerate().take(self.rows.len()) {
            let Source {
                step,
                point,
                border,
            } = Source::read(source);
            let Some(border) = constraint::border(task, border).filter(|_| step != LINEAR) else {
                continue;
            };
            let found = if step == INSIDE {
                let deepest = self.inside.deepest(point, border);
                deepest.map(|(_, clearance)| clearance)
            } else {
                let place = self.preview.places(step).nth(point);
                place.map(|place| border.clearance_of(place))
            };
            if let Some(found) = found {
                self.rows.correct(row, found.distance - margin, step_taken);
            }
        }
    }

    /// Previews a plan with its derivatives and sums up cost and violations; `None` if it is
    /// impossible.
    fn outcome(&mut self, problem: &Problem<'_>, plan: [f64; N]) -> Option<Iterate<N>> {
        self.count(self.prices.evaluation);
        let Problem { task, initial, .. } = *problem;
        if !self.preview.linearize(task, initial, &plan, problem.ts) {
            return None;
        }
        if !self.trace(problem, &plan) {
            return None;
        }
        self.count(self.prices.place * self.inside.count());
        let mut outcome = Outcome {
            cost: cost::value(problem, &self.preview, &plan),
            change: cost::change(problem, &plan),
            total: 0.0,
            worst: 0.0,
        };
        let margin = problem.margin;
        let mut count = |violation: f64| {
            outcome.total += violation;
            outcome.worst = outcome.worst.max(violation);
        };
        let inside = self.inside.near();
        inside.for_each(|i| count(self.inside.violation(task, i, margin)));
        for j in 0..self.preview.np().min(problem.watched) {
            for Place { pixel, radius } in self.preview.places(j) {
                count(constraint::violation(task, pixel, margin + radius));
            }
        }
        for command in plan.as_chunks::<DOF>().0 {
            problem.violations_px(command).for_each(&mut count);
        }
        let is_finite = outcome.merit(1.0).is_finite();
        is_finite.then_some(Iterate { plan, outcome })
    }

    /// No plan: the zero twist.
    fn failure(&self) -> Solution {
        Solution {
            iterations: self.progress.iterations,
            qp_iterations: self.progress.qp_iterations,
            work: self.progress.work,
            ..Solution::NONE
        }
    }

    fn solution(&self, problem: &Problem<'_>, at: &Iterate<N>, status: Status) -> Solution {
        let violates = at.outcome.worst > FEASIBLE;
        let clamped = clamped(&at.plan, problem);
        let mut plan = [0.0; MAX_VARIABLES];
        plan.iter_mut()
            .zip(clamped)
            .for_each(|(to, from)| *to = from);
        Solution {
            plan,
            status: if violates { Status::Infeasible } else { status },
            cost: at.outcome.cost,
            merit: at.outcome.merit(self.progress.rho),
            violation_px: at.outcome.worst,
            ..self.failure()
        }
    }
}

/// The entries of a plan that count.
fn head<const N: usize>(plan: &Plan) -> [f64; N] {
    const { assert!(N <= MAX_VARIABLES) };
    core::array::from_fn(|k| plan[k])
}

fn moved<const N: usize>(plan: &[f64; N], step: &[f64; N], share: f64) -> [f64; N] {
    core::array::from_fn(|k| plan[k] + share * step[k])
}

/// The plan inside its bounds; entries that are not finite are as near to zero as these allow.
fn clamped<const N: usize>(plan: &[f64; N], problem: &Problem<'_>) -> [f64; N] {
    core::array::from_fn(|k| {
        let [least, most] = problem.bounds(k);
        let x = if plan[k].is_finite() { plan[k] } else { 0.0 };
        x.max(least).min(most)
    })
}

/// The first command of a plan.
fn first_command<const N: usize>(plan: &[f64; N]) -> Twist {
    const { assert!(N >= DOF) };
    core::array::from_fn(|k| plan[k])
}

/// The box that a linearised point cannot leave by a step inside its bounds: least and greatest
/// (u, v), px.
fn reach<const N: usize>(
    pixel: [f64; 2],
    gradient: &[[f64; N]; 2],
    bounds: &Quadratic<N>,
) -> [[f64; 2]; 2] {
    let (mut low, mut high) = (pixel, pixel);
    for c in 0..2 {
        for k in 0..N {
            let slope = gradient[c][k];
            let (a, b) = (slope * bounds.lower[k], slope * bounds.upper[k]);
            low[c] += a.min(b);
            high[c] += a.max(b);
        }
    }
    [low, high]
}

/// The most that a linearised quantity grows by a step inside its bounds.
fn greatest<const N: usize>(gradient: &[f64; N], bounds: &Quadratic<N>) -> f64 {
    let most = |k: usize| (gradient[k] * bounds.lower[k]).max(gradient[k] * bounds.upper[k]);
    (0..N).map(most).sum()
}

/// Takes what a marker grows off the gradient of its point's clearance.
fn reduce<const N: usize>(gradient: &mut [f64; N], growth: &[f64; N]) {
    let pairs = gradient.iter_mut().zip(growth);
    pairs.for_each(|(gradient, growth)| *gradient -= growth);
}

/// Where rho starts. A multiplier balances the pull of the image errors on the features, so ten
/// times the sum of all pulls (each at least that of an error of 1 % of the image width) is above
/// it unless the geometry is extreme; then a row yields and rho is raised.
fn first_rho(problem: &Problem<'_>, np: usize) -> f64 {
    let task = problem.task;
    let floor = 0.01 * task.camera.width;
    let pairs = problem.initial.points.iter().zip(problem.target);
    let pulls =
        pairs.map(|(s, t)| 2.0 * task.cost.k_q * libm::hypot(s[0] - t[0], s[1] - t[1]).max(floor));
    10.0 * pulls.sum::<f64>() * np as f64
}
