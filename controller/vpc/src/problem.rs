//! The optimal-control problem of one cycle, and its solution.
//!
//! Source: paper, Eq. (vpc).

use ::arm::Dampers;

use crate::prediction::{InitialState, Plan, repeated};
use crate::row::{Row, beyond_px};
use crate::span::Span;
use crate::task::Task;
use crate::view::View;
use crate::{DOF, MAX_VARIABLES, Points, Twist, arm};

/// When the solver stops.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SolverOptions {
    /// Most iterations of sequential quadratic programming.
    pub max_iterations: u32,
    /// Optimality: stop when the predicted decrease of the merit is below this share of the merit.
    pub tolerance: f64,
    /// Whether constraints also hold between the sampling instants of the first period.
    pub intersample: bool,
}

/// The problem of one cycle.
#[derive(Clone, Copy, Debug)]
pub struct Problem<'a> {
    /// Camera, pattern, weights, limits, occlusions.
    pub task: &'a Task,
    /// Where the preview starts.
    pub initial: &'a InitialState,
    /// The target of the features: goal or way point, less the mismatch, px.
    pub target: &'a Points,
    /// Share of R that applies, 0 to 1.
    pub r_share: f64,
    /// Share of R that weighs the change of the command.
    pub change_share: f64,
    /// The command in force, which the first command of the plan changes.
    pub standing: Twist,
    /// Time from one command to the next, s.
    pub interval: f64,
    /// Ts: length of a step of the window, s.
    pub ts: f64,
    /// Extra clearance kept from every border by each point with its marker, px.
    pub margin: f64,
    /// What the arm allows, where it is known, and what a posture that it goes to wants.
    pub dampers: Option<&'a Dampers>,
    /// What keeps the camera in front of the pattern, where that is asked for.
    pub view: Option<View>,
    /// A wanted twist: the plan goes as near to it as it may, and not to the target.
    pub wanted: Option<Twist>,
    /// Steps of the window in which clearances count.
    pub watched: usize,
}

/// What a plan costs.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Weights<'a> {
    /// k_Q.
    pub k_q: f64,
    /// r.
    pub r_share: f64,
    /// q.
    pub change_share: f64,
    /// d.
    pub wanted: &'a Twist,
}

impl Problem<'_> {
    /// The weights of the cost: towards a posture the nearest twist to the wanted one counts, and
    /// no image.
    pub(crate) fn weights(&self) -> Weights<'_> {
        let of_posture = || self.dampers.and_then(|dampers| dampers.wanted.as_ref());
        match self.wanted.as_ref().or_else(of_posture) {
            Some(wanted) => Weights {
                k_q: 0.0,
                r_share: 1.0,
                change_share: 0.0,
                wanted,
            },
            None => Weights {
                k_q: self.task.cost.k_q,
                r_share: self.r_share,
                change_share: self.change_share,
                wanted: &self.initial.drift.twist,
            },
        }
    }

    /// The linear bounds on each command.
    pub(crate) fn rows(&self) -> impl Iterator<Item = Row> {
        let of_arm = self.dampers.into_iter().flat_map(arm::rows);
        of_arm.chain(self.view.iter().flat_map(View::rows))
    }

    /// By how much a command is beyond them, px: each.
    pub(crate) fn violations_px(&self, twist: &Twist) -> impl Iterator<Item = f64> {
        self.rows().map(|row| row.violation_px(twist))
    }

    /// Whether a command is beyond the arm's rows by more than `slack`, px, or leads to the pattern's
    /// side; and further than braking, which is always possible.
    pub(crate) fn is_worse_than_braking(&self, command: &Twist, slack: f64) -> bool {
        if self.dampers.is_none() && self.view.is_none() {
            return false;
        }
        let braking = self.braking();
        let of_arm = || self.dampers.into_iter().flat_map(arm::rows);
        let [beyond, anyway] = [command, &braking].map(|twist| beyond_px(of_arm(), twist));
        let is_left = |view: &View| view.is_left_by(command, &braking, slack);
        beyond > anyway.max(slack) || self.view.as_ref().is_some_and(is_left)
    }

    /// Least and greatest value of the k-th variable of a plan: inside the velocity limits, and no
    /// further from the command in force than the acceleration limits allow until then. Where the
    /// arm has room for a share of the accelerations only, the velocities take the same share, so
    /// that it stops in no more time.
    pub fn bounds(&self, k: usize) -> [f64; 2] {
        let task = self.task;
        let [limit, most, standing] = [&task.limits, &task.acceleration, &self.standing]
            .map(|each| each.get(k % DOF).copied().unwrap_or(0.0));
        let standing = standing.clamp(-limit, limit);
        let seconds = self.interval + (k / DOF) as f64 * self.ts;
        let change = self.ramps() * most * seconds;
        let limit = limit.min((self.ramps() * limit).max(standing.abs() - change));
        [
            (standing - change).max(-limit),
            (standing + change).min(limit),
        ]
    }

    /// Time in which a command brakes, after which the camera rests against the pattern.
    fn braked(&self, twist: &Twist) -> Span {
        let with = arm::within(self.dampers, &self.initial.drift.twist);
        let mut relative = *twist;
        let pairs = relative.iter_mut().zip(with);
        pairs.for_each(|(v, with)| *v -= with);
        let stop = self.task.stop(&relative);
        let seconds = stop.seconds / self.ramps();
        let longest_s = self.task.stop_s(&self.task.limits);
        match seconds < longest_s {
            true => Span {
                seconds,
                slope: stop.slope.map(|slope| slope / self.ramps()),
            },
            false => Span::fixed(longest_s),
        }
    }

    /// The time for which the path of a command is checked: a step, or T + t_v / 2, in which the
    /// camera would go as far, were the command held, as it does in a period and while it brakes
    /// then; for it slows down evenly, and keeps to its path.
    pub(crate) fn way(&self, twist: &Twist) -> Span {
        let fixed = Span::fixed(self.task.ts);
        if !self.task.brakes() {
            return fixed;
        }
        let Span { seconds, slope } = self.braked(twist);
        fixed.max(Span {
            seconds: self.interval + 0.5 * seconds,
            slope: slope.map(|slope| 0.5 * slope),
        })
    }

    /// Share of the limits of acceleration that the arm has room for.
    fn ramps(&self) -> f64 {
        self.dampers.map_or(1.0, |dampers| dampers.ramps)
    }

    /// The command that brakes: the one in force, slowed down as a whole against the pattern, so
    /// that the camera stays on its path. It follows a pattern as far as the arm goes.
    pub fn braking(&self) -> Twist {
        let with = arm::within(self.dampers, &self.initial.drift.twist);
        let mut relative = self.standing;
        let pairs = relative.iter_mut().zip(with);
        pairs.for_each(|(v, with)| *v -= with);
        let stop_s = self.task.stop_s(&relative);
        let left = (1.0 - self.interval / stop_s).max(0.0);
        let mut braking = with;
        if stop_s > self.interval {
            let pairs = braking.iter_mut().zip(relative);
            pairs.for_each(|(v, relative)| *v += left * relative);
        }
        // A pattern may be believed to be faster.
        let pairs = braking.iter_mut().zip(&self.task.limits);
        pairs.for_each(|(v, limit)| *v = v.max(-limit).min(*limit));
        braking
    }
}

/// How a solution ended.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Status {
    /// Optimal to the tolerance, and no constraint violated.
    #[default]
    Converged,
    /// Feasible and finite, but the iterations or the work ran out.
    IterationLimit,
    /// The line search found no decrease: the plan is optimal to what the model's accuracy allows.
    Stalled,
    /// The best plan found violates a constraint somewhere in the window.
    Infeasible,
    /// No plan could be computed; the solution is the zero twist.
    NumericalFailure,
}

impl Status {
    /// Whether the solver ended by itself, with a feasible plan.
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
    /// Iterations of sequential quadratic programming.
    pub iterations: u32,
    /// Active-set changes in all quadratic programs.
    pub qp_iterations: u32,
    /// Counted [work](crate::work).
    pub work: u32,
    /// l(V) of the plan, without the weight on changes.
    pub cost: f64,
    /// All costs plus weighted violation.
    pub merit: f64,
    /// Greatest predicted violation over the window, px.
    pub violation_px: f64,
}

impl Solution {
    /// Whether this is the first command of the plan.
    pub(crate) fn sends(&self, twist: &Twist) -> bool {
        self.plan.first_chunk() == Some(twist)
    }

    /// The plan that the next cycle's solver starts from, where `twist` is sent: this one, unless
    /// the last check replaced its first command. A refused plan would only be refused again.
    pub(crate) fn warm(&self, twist: &Twist) -> Plan {
        if self.sends(twist) {
            self.plan
        } else {
            repeated(twist)
        }
    }

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
    };
}
