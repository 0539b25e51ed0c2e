//! The command of one period, and what it costs: of a cycle and of a simulated step alike.

use ::arm::Dampers;

use crate::cost;
use crate::limit;
use crate::prediction::{InitialState, Plan, repeated};
use crate::problem::{Problem, Solution};
use crate::settings::Settings;
use crate::solver::Solver;
use crate::task::Task;
use crate::view::View;
use crate::{DOF, MAX_NP, Points, Twist, ibvs};

/// Least window where the camera takes time to brake, s, unless a stop from the limits is shorter.
/// One of 0.1 s follows noise, wrong gains and frozen images at the goal.
const REGULATING_S: f64 = 0.3;

/// The inputs of a command.
#[derive(Clone, Copy)]
pub(crate) struct Present<'a> {
    /// The features, and what the model knows of their depth.
    pub initial: &'a InitialState,
    /// The command in force.
    pub standing: &'a Twist,
    /// Time from one command to the next, s.
    pub interval: f64,
    /// The plan that the solver starts from.
    pub warm: &'a Plan,
    /// Clearance kept from every border beside the settings', px.
    pub extra_px: f64,
    /// What the arm allows of a command that is in force for `interval`, where it is known.
    pub dampers: Option<&'a Dampers>,
    /// What keeps the camera in front of the pattern.
    pub view: Option<View>,
    /// A wanted twist: the command is as near to it as it may be, and does not aim at the target.
    pub wanted: Option<Twist>,
}

/// The policy: predictive control towards a given target, one command at a time.
#[derive(Clone, Copy)]
pub(crate) struct Policy<'a> {
    pub task: &'a Task,
    pub settings: &'a Settings,
}

impl Policy<'_> {
    /// Solves the optimal-control problem, and limits its first command. `aim` is the goal or a way
    /// point; `target` the same, corrected by the mismatch. Where the warm start leads into a
    /// violation, the solver starts again from braking, which is feasible unless a constraint is
    /// already violated.
    pub fn command(
        &self,
        solver: &mut Solver<'_>,
        present: &Present<'_>,
        aim: &Points,
        target: &Points,
    ) -> (Twist, Solution) {
        let problem = self.problem(present, aim, target);
        let braking = repeated(&problem.braking());
        let solution = solver.solve_from(&problem, present.warm, &braking);
        (limit::command(solver, &problem, &solution), solution)
    }

    /// The same towards a wanted twist; each component counts up to its limit. Where nothing speaks
    /// against that, it is sent to the last bit, and nothing is solved.
    pub fn nearest(
        &self,
        solver: &mut Solver<'_>,
        present: &Present<'_>,
        wanted: &Twist,
    ) -> (Twist, Option<Solution>) {
        let goal = &self.task.goal;
        let wanted = limit::clamp(wanted, &self.task.limits);
        let present = Present {
            wanted: Some(wanted),
            warm: &repeated(&wanted),
            ..*present
        };
        let problem = self.problem(&present, goal, goal);
        let is_inside = wanted.iter().enumerate().all(|(k, v)| {
            let [least, most] = problem.bounds(k);
            (least..=most).contains(v)
        });
        if is_inside && solver.is_clear(&problem, &repeated(&wanted), 0.0) {
            return (wanted, None);
        }
        let (twist, solution) = self.command(solver, &present, goal, goal);
        (twist, Some(solution))
    }

    /// The optimal-control problem.
    fn problem<'p>(
        &'p self,
        present: &Present<'p>,
        aim: &Points,
        target: &'p Points,
    ) -> Problem<'p> {
        let Present {
            initial,
            standing,
            interval,
            extra_px,
            dampers,
            view,
            wanted,
            ..
        } = *present;
        Problem {
            task: self.task,
            initial,
            target,
            r_share: cost::r_share(self.task, &initial.points, aim),
            change_share: self.settings.change_share * self.task.ts / interval,
            standing: *standing,
            interval,
            ts: self.step_s(initial, target, interval),
            margin: self.settings.margin_px + extra_px,
            dampers,
            view,
            wanted,
            // What comes after the next step of a refined way is checked by its future; after that
            // of another program's twist, by the next cycle.
            watched: wanted.map_or(MAX_NP, |_| 1),
        }
    }

    /// Length of a step of the window, s. Where the camera takes time to brake, it is longer far
    /// from the target: with a window of W the held command that is nearest to a target at a
    /// distance D is g D / W, g = 3 Np / (2 Np + 1), and W = g / 2 sqrt(2 D / a) makes that
    /// sqrt(2 a D), from which a stop ends there. No window is longer than a period and a stop from
    /// the limits.
    fn step_s(&self, initial: &InitialState, target: &Points, interval: f64) -> f64 {
        let Self { task, settings } = self;
        if !task.brakes() {
            return task.ts;
        }
        let np = settings.np as f64;
        let away = ibvs::twist(task, initial, target, 1.0);
        let stop_s = away.map_or(f64::INFINITY, |away| {
            1.5 * np / (2.0 * np + 1.0) * libm::sqrt(2.0 * task.stop_s(&away))
        });
        let longest_s = interval + task.stop_s(&task.limits);
        let window_s = (interval + stop_s).max(REGULATING_S).min(longest_s);
        task.ts.max(window_s / np)
    }

    /// l(v) of a command, held over the window, always against the goal with the fixed schedule of
    /// R.
    pub fn running_cost(
        &self,
        solver: &mut Solver<'_>,
        initial: &InitialState,
        twist: &Twist,
    ) -> f64 {
        let goal = &self.task.goal;
        let problem = Problem {
            task: self.task,
            initial,
            target: goal,
            r_share: cost::r_share(self.task, &initial.points, goal),
            change_share: 0.0,
            standing: [0.0; DOF],
            interval: self.task.ts,
            ts: self.task.ts,
            margin: 0.0,
            dampers: None,
            view: None,
            wanted: None,
            watched: 0,
        };
        solver.evaluate(&problem, &repeated(twist)).unwrap_or(0.0)
    }
}
