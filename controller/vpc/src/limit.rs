//! The last check of a command: finite, inside the velocity limits, and not worse than standing
//! still.

use crate::prediction::Plan;
use crate::problem::{Problem, Solution};
use crate::solver::Solver;
use crate::{DOF, Twist};

/// Halvings towards standing still before the command is zero.
const HALVINGS: usize = 6;
/// A first period may bring a point this deep, px: below the accuracy of the model.
pub const SLACK: f64 = 0.25;

/// The first command of a solution, slowed down until its period is clear ([`Solver::is_clear`]),
/// and clamped to the limits; zero if no halving achieves this.
pub fn command(solver: &mut Solver, problem: &Problem<'_>, solution: &Solution) -> Twist {
    let mut plan = solution.plan;
    let mut is_clear = solution.violation_px <= SLACK;
    for _ in 0..HALVINGS {
        if is_clear || solver.is_clear(problem, &plan, SLACK) {
            return twist(&plan, &problem.task.limits);
        }
        plan = plan.map(|x| 0.5 * x);
        is_clear = false;
    }
    [0.0; DOF]
}

/// The first command of a plan, clamped; zero if a component is not finite.
pub fn twist(plan: &Plan, limits: &Twist) -> Twist {
    clamp(plan.first_chunk().unwrap_or(&[0.0; DOF]), limits)
}

/// A twist inside the limits, component by component; zero if a component is not finite.
pub fn clamp(twist: &Twist, limits: &Twist) -> Twist {
    if !twist.iter().all(|x| x.is_finite()) {
        return [0.0; DOF];
    }
    let mut clamped = *twist;
    for (x, limit) in clamped.iter_mut().zip(limits) {
        *x = x.clamp(-limit, *limit);
    }
    clamped
}

/// A twist scaled down as a whole until it is inside the limits, so that its direction is kept.
pub fn scale(twist: &Twist, limits: &Twist) -> Twist {
    let excess = twist.iter().zip(limits).map(|(v, limit)| v.abs() / limit);
    let excess = excess.fold(1.0, f64::max);
    clamp(&twist.map(|v| v / excess), limits)
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIMITS: Twist = [0.5, 0.5, 0.5, 1.0, 1.0, 1.0];

    #[test]
    fn a_command_never_leaves_the_box() {
        assert_eq!(
            clamp(&[9.0, -9.0, 0.1, 2.0, -2.0, 0.0], &LIMITS),
            [0.5, -0.5, 0.1, 1.0, -1.0, 0.0]
        );
        assert_eq!(
            clamp(&[f64::NAN, 0.1, 0.1, 0.1, 0.1, 0.1], &LIMITS),
            [0.0; 6]
        );
        assert_eq!(
            scale(&[1.0, 0.5, 0.0, 0.0, 0.0, 0.0], &LIMITS),
            [0.5, 0.25, 0.0, 0.0, 0.0, 0.0]
        );
    }
}
