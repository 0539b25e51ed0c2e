//! The command of one period, and what it costs: of a cycle and of a simulated period alike.

use crate::cost;
use crate::limit;
use crate::prediction::{InitialState, Plan};
use crate::problem::{Problem, Solution};
use crate::settings::Settings;
use crate::solver::Solver;
use crate::task::Task;
use crate::{DOF, MAX_VARIABLES, Points, Twist};

/// Predictive control towards a given target.
#[derive(Clone, Copy)]
pub(crate) struct Law<'a> {
    pub task: &'a Task,
    pub settings: &'a Settings,
}

impl Law<'_> {
    /// Solves the optimal-control problem from a warm start, and limits its first command. `aim` is
    /// the goal or a way point; `target` the same, corrected by the mismatch. Where the warm start
    /// leads into a violation, it begins again from `recalled`, and then from standing still: that
    /// is feasible unless a constraint is already violated.
    pub fn command(
        &self,
        solver: &mut Solver,
        initial: &InitialState,
        aim: &Points,
        target: &Points,
        warm: &Plan,
        recalled: Option<&Twist>,
    ) -> (Twist, Solution) {
        let problem = Problem {
            task: self.task,
            initial,
            target,
            r_share: cost::r_share(self.task, &initial.points, aim),
            margin: self.settings.margin_px,
        };
        let solution = match recalled {
            Some(twist) => {
                solver.solve_from(&problem, &[*warm, repeated(twist), [0.0; MAX_VARIABLES]])
            }
            None => solver.solve_from(&problem, &[*warm, [0.0; MAX_VARIABLES]]),
        };
        (limit::command(solver, &problem, &solution), solution)
    }

    /// l(v) of a command, held over the window, always against the goal with the fixed schedule of
    /// R.
    pub fn running_cost(&self, solver: &mut Solver, initial: &InitialState, twist: &Twist) -> f64 {
        let goal = &self.task.goal;
        let problem = Problem {
            task: self.task,
            initial,
            target: goal,
            r_share: cost::r_share(self.task, &initial.points, goal),
            margin: 0.0,
        };
        solver.evaluate(&problem, &repeated(twist)).unwrap_or(0.0)
    }
}

/// The plan that repeats one twist.
///
/// Source: paper, Eq. (warm_start).
pub(crate) fn repeated(twist: &Twist) -> Plan {
    let mut plan = [0.0; MAX_VARIABLES];
    plan.chunks_exact_mut(DOF)
        .for_each(|command| command.copy_from_slice(twist));
    plan
}
