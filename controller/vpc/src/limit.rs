//! The last check of a command: finite, inside the limits of velocity and acceleration, and not
//! worse than braking.

use crate::prediction::Plan;
use crate::problem::{Problem, Solution};
use crate::solver::Solver;
use crate::task::Task;
use crate::{DOF, Twist};

/// Most halvings towards braking; after them the command is to brake.
const HALVINGS: usize = 6;
/// Allowed depth of a point after the first period, px: below the accuracy of the model.
pub const SLACK: f64 = 0.25;

/// The first command of a solution, brought nearer to the braking one until its step is clear
/// ([`Solver::is_clear`]), inside its bounds; the braking one if no halving achieves this. Without
/// limits of acceleration that is zero.
pub fn command(solver: &mut Solver<'_>, problem: &Problem<'_>, solution: &Solution) -> Twist {
    let braking = problem.braking();
    let mut plan = solution.plan;
    // The solution is within the bounds of a view, which are linear: the check is not.
    let mut is_clear = solution.violation_px <= SLACK && problem.view.is_none();
    for _ in 0..HALVINGS {
        if is_clear || solver.is_clear(problem, &plan, SLACK) {
            return first(&plan, problem);
        }
        let pairs = plan.iter_mut().zip(braking.iter().cycle());
        pairs.for_each(|(x, b)| *x = 0.5 * (*x + b));
        is_clear = false;
    }
    match solver.is_clear(problem, &plan, SLACK) {
        true => first(&plan, problem),
        false => braking,
    }
}

/// The first command of a plan inside its bounds; the braking one if a component is not finite.
fn first(plan: &Plan, problem: &Problem<'_>) -> Twist {
    let mut twist = *plan.first_chunk().unwrap_or(&[f64::NAN; DOF]);
    if !twist.iter().all(|x| x.is_finite()) {
        return problem.braking();
    }
    for (k, x) in twist.iter_mut().enumerate() {
        let [least, most] = problem.bounds(k);
        *x = x.max(least).min(most);
    }
    twist
}

/// A twist nearer to the command in force, as a whole, until the acceleration limits allow the
/// change in `seconds`.
pub fn approach(twist: &Twist, standing: &Twist, task: &Task, seconds: f64) -> Twist {
    let mut change = *twist;
    change
        .iter_mut()
        .zip(standing)
        .for_each(|(x, before)| *x -= before);
    let share = seconds / task.stop_s(&change);
    if share >= 1.0 {
        return *twist;
    }
    let mut next = *standing;
    next.iter_mut()
        .zip(change)
        .for_each(|(x, change)| *x += share * change);
    next
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
