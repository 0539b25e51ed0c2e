//! The paper's optimal-control problem and its solution, in a few microseconds.
//!
//! Each iteration of sequential quadratic programming expands the cost (Gauss-Newton) and the clearances about the
//! present plan, solves the elastic quadratic program of [`crate::qp`], and searches along its step for a sufficient
//! decrease of the exact-penalty merit *cost + rho x violation*. Iterations, active-set changes and line-search trials
//! are all bounded, so the work of a cycle is.
//!
//! Source: paper, Eq. (vpc); J. Nocedal and S. Wright, "Numerical Optimization", Ch. 18 (S l1 QP).

use crate::prediction::{Origin, Plan};
use crate::sqp::Sqp;
use crate::task::Task;
use crate::{DOF, MAX_VARIABLES, Points, constraint};

/// How far to look for a solution.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Effort {
    /// Most iterations of sequential quadratic programming.
    pub max_iterations: u32,
    /// Optimality precision: stop when the predicted decrease of the merit is below this share of the merit.
    pub tolerance: f64,
}

/// Counted work: one for a change of the active set of a quadratic program, and for what takes about as long.
///
/// The unit is some 0.1 us on a present-day processor.
pub mod work {
    /// Previewing a window of `np` steps and summing up its cost and violations.
    pub const fn look(np: usize) -> u32 {
        2 * np as u32
    }

    /// Expanding cost and clearances about a plan, and factorising the quadratic program.
    pub const fn expansion(np: usize) -> u32 {
        4 * np as u32 + 8
    }

    /// Most work of a solution in at most `iterations`, from all starts together; a line search that is under way may go
    /// beyond it.
    ///
    /// Hard problems stay within three times their median by it, with windows of 3, 10 and 30 steps
    /// (`tests/tests/promises/bounded.rs`), and it hardly ever ends a search that would have led somewhere: of the 100
    /// fixed starts `gpr`, with a memory that was built without this bound, reaches 100, 100 and 98 with these windows,
    /// `previous` 90, 86 and 83; 1.4 times as much work at Np = 30 brings `previous` one start, the others none.
    pub const fn budget(np: usize, iterations: u32) -> u32 {
        iterations.saturating_mul(39 + 3 * np as u32)
    }
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

impl Problem<'_> {
    /// The worst violation among some points, px: that of standing still, for the measured ones.
    pub fn worst_violation(&self, points: &[[f64; 2]]) -> f64 {
        let violation = |&pixel: &[f64; 2]| constraint::violation(self.task, pixel, self.margin);
        points.iter().map(violation).fold(0.0, f64::max)
    }
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
    /// Counted [`work`].
    pub work: u32,
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
    pub(crate) const NONE: Self = Self {
        plan: [0.0; MAX_VARIABLES],
        status: Status::NumericalFailure,
        iterations: 0,
        qp_iterations: 0,
        work: 0,
        cost: f64::INFINITY,
        merit: f64::INFINITY,
        violation_px: f64::INFINITY,
        next_violation_px: f64::INFINITY,
    };
}

/// A share of the budget of work, in quarters: all of it, and what the first of two starts may use up.
const ALL: u32 = 4;
const FIRST: u32 = 3;

/// The solver with its workspace; up to half a megabyte, made once.
#[derive(Clone)]
pub struct Solver(Window);

/// The workspace for each number of free commands.
#[derive(Clone)]
#[allow(clippy::large_enum_variant)] // made once; without a heap there is nowhere else to put it
enum Window {
    One(Sqp<DOF>),
    Two(Sqp<{ 2 * DOF }>),
    Three(Sqp<{ 3 * DOF }>),
    Four(Sqp<{ 4 * DOF }>),
}

/// Calls a method of the workspace, whatever its number of variables.
macro_rules! window {
    ($solver:expr, $method:ident($($argument:expr),*)) => {
        match &mut $solver.0 {
            Window::One(sqp) => sqp.$method($($argument),*),
            Window::Two(sqp) => sqp.$method($($argument),*),
            Window::Three(sqp) => sqp.$method($($argument),*),
            Window::Four(sqp) => sqp.$method($($argument),*),
        }
    };
}

impl Solver {
    /// A solver for a window of `np` steps (1 to [`crate::MAX_NP`]) and `nc` free commands (1 to [`crate::MAX_NC`]).
    pub fn new(np: usize, nc: usize, effort: Effort) -> Self {
        Self(match nc {
            0 | 1 => Window::One(Sqp::new(np, effort)),
            2 => Window::Two(Sqp::new(np, effort)),
            3 => Window::Three(Sqp::new(np, effort)),
            _ => Window::Four(Sqp::new(np, effort)),
        })
    }

    /// Cost of a plan; `None` where the plan brings a point behind the camera.
    pub fn evaluate(&mut self, problem: &Problem<'_>, plan: &Plan) -> Option<f64> {
        window!(self, evaluate(problem, plan))
    }

    /// The worst violation of the first step under a plan, px; infinite where the plan is impossible.
    pub fn next_violation(&mut self, problem: &Problem<'_>, plan: &Plan) -> f64 {
        window!(self, next_violation(problem, plan))
    }

    /// The solver with a bound on its counted [`work`], which has none of its own: the controller's has, the solver of
    /// off-line work need not.
    #[must_use]
    pub fn with_budget(mut self, budget: u32) -> Self {
        window!(self, limit_work(budget));
        self
    }

    /// Solves the problem from the warm start `warm`.
    pub fn solve(&mut self, problem: &Problem<'_>, warm: &Plan) -> Solution {
        window!(self, solve(problem, warm, ALL))
    }

    /// Solves the problem from each start in turn until one solution violates nothing; otherwise returns the one
    /// that violates least. Counts the work of all, which share one budget: a start may use up so much of it that a
    /// quarter is left for the next.
    pub fn solve_from(&mut self, problem: &Problem<'_>, starts: &[Plan]) -> Solution {
        let mut best: Option<Solution> = None;
        let (mut iterations, mut qp_iterations, mut work) = (0, 0, 0);
        for start in starts {
            let share = if work == 0 { FIRST } else { ALL - FIRST };
            let found = window!(self, solve(problem, start, share));
            iterations += found.iterations;
            qp_iterations += found.qp_iterations;
            work += found.work;
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
            work,
            ..best.unwrap_or(Solution::NONE)
        }
    }
}
