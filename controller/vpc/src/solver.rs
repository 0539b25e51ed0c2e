//! The solver of the optimal-control problem: bounded work, a status with every answer.
//!
//! Source: paper, Eq. (vpc); the method is in `sqp`.

use crate::DOF;
use crate::prediction::Plan;
use crate::problem::{Problem, Solution, SolverOptions};
use crate::qp::{Quadratic, Rows};
pub use crate::size::Size;
use crate::sqp::Sqp;
use crate::workspace::Workspace;

impl Size {
    /// Numbers that the workspace of a solver for such problems has: some 2,000 for a window of 3
    /// steps, 56,000 at most.
    pub const fn workspace(self) -> usize {
        match self.nc {
            1 => Sqp::<DOF>::room(self),
            2 => Sqp::<{ 2 * DOF }>::room(self),
            3 => Sqp::<{ 3 * DOF }>::room(self),
            _ => Sqp::<{ 4 * DOF }>::room(self),
        }
    }
}

/// The solver, in a workspace that the caller lends. What it leaves there means nothing to the next
/// problem.
pub struct Solver<'w> {
    window: Window<'w>,
    /// Most work of a solution from all starts.
    budget: u32,
}

/// The method for each number of free commands.
enum Window<'w> {
    One(Sqp<'w, DOF>),
    Two(Sqp<'w, { 2 * DOF }>),
    Three(Sqp<'w, { 3 * DOF }>),
    Four(Sqp<'w, { 4 * DOF }>),
}

/// Calls a method of the window, whatever its number of variables.
macro_rules! window {
    ($window:expr, $method:ident($($argument:expr),*)) => {
        match $window {
            Window::One(sqp) => sqp.$method($($argument),*),
            Window::Two(sqp) => sqp.$method($($argument),*),
            Window::Three(sqp) => sqp.$method($($argument),*),
            Window::Four(sqp) => sqp.$method($($argument),*),
        }
    };
}

impl<'w> Solver<'w> {
    /// A solver for problems of this size, without a bound on its work. `None` if the workspace is
    /// shorter than [`Size::workspace`].
    pub fn new(size: Size, options: SolverOptions, workspace: &'w mut [f64]) -> Option<Self> {
        let mut workspace = Workspace(workspace);
        let window = match size.nc {
            1 => Window::One(Sqp::new(size, options, &mut workspace)?),
            2 => Window::Two(Sqp::new(size, options, &mut workspace)?),
            3 => Window::Three(Sqp::new(size, options, &mut workspace)?),
            _ => Window::Four(Sqp::new(size, options, &mut workspace)?),
        };
        let budget = u32::MAX;
        Some(Self { window, budget })
    }

    /// The same solver with a bound on the counted [work](crate::work) of each solution.
    #[must_use]
    pub fn with_budget(mut self, budget: u32) -> Self {
        self.budget = budget;
        self
    }

    /// Counted [work](crate::work) of everything that this solver has done.
    pub fn done(&self) -> u64 {
        window!(&self.window, done())
    }

    /// Cost of a plan; `None` if the plan brings a point behind the camera.
    pub fn evaluate(&mut self, problem: &Problem<'_>, plan: &Plan) -> Option<f64> {
        window!(&mut self.window, evaluate(problem, plan))
    }

    /// Whether the first period of a plan brings no point deeper into an obstacle, or further out
    /// of the image, than it is already, or than `slack`, px; or else leads out of what is violated
    /// already: the sum of all violations falls, and none is above the greatest of now.
    pub fn is_clear(&mut self, problem: &Problem<'_>, plan: &Plan, slack: f64) -> bool {
        window!(&mut self.window, is_clear(problem, plan, slack))
    }

    /// The quadratic program of an iteration about a plan, and rho. `None` with several free
    /// commands, and where a plan brings a point behind the camera.
    #[doc(hidden)] // for vpc-bench
    pub fn program_about(
        &mut self,
        problem: &Problem<'_>,
        plan: &Plan,
    ) -> Option<(Quadratic<DOF>, &Rows<'w, DOF>, f64)> {
        match &mut self.window {
            Window::One(sqp) => sqp.program_about(problem, plan),
            _ => None,
        }
    }

    /// Solves the problem from the warm start `warm`.
    pub fn solve(&mut self, problem: &Problem<'_>, warm: &Plan) -> Solution {
        window!(&mut self.window, solve(problem, warm, self.budget))
    }

    /// Solves the problem without a warm start. `standing` stands still, or does so as soon as
    /// limits of acceleration allow. A cycle of the law always has a warm start.
    pub fn solve_cold(&mut self, problem: &Problem<'_>, standing: &Plan) -> Solution {
        window!(&mut self.window, solve_cold(problem, standing, self.budget))
    }

    /// Solves the problem from the warm start, and from `standing` where that solution violates
    /// something; the one that violates less. Both share one budget of work: the first leaves at
    /// least a quarter.
    pub fn solve_from(&mut self, problem: &Problem<'_>, warm: &Plan, standing: &Plan) -> Solution {
        let most = self.budget / 4 * 3;
        let first = window!(&mut self.window, solve(problem, warm, most));
        if first.status.is_feasible() {
            return first;
        }
        let left = self.budget.saturating_sub(first.work);
        let second = window!(&mut self.window, solve(problem, standing, left));
        let best = match second.violation_px < first.violation_px {
            true => second,
            false => first,
        };
        Solution {
            iterations: first.iterations + second.iterations,
            qp_iterations: first.qp_iterations + second.qp_iterations,
            work: first.work + second.work,
            ..best
        }
    }
}
