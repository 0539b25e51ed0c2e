//! The cost of a plan and its Gauss-Newton expansion.
//!
//! Source: paper, Eq. (cost): every previewed step weighs the image error by Q, every command but the last step's
//! by R.

use crate::features;
use crate::prediction::{Plan, Preview};
use crate::task::Task;
use crate::{DOF, MAX_VARIABLES, Points};

/// R has its full value at this mean distance from what is tracked, as a share of the image width, and decreases
/// with the square of the distance below it: then neither term takes over on the way to the target, and R vanishes
/// with the error as in the paper.
pub const FULL_R_DISTANCE: f64 = 0.25;

/// A quadratic expansion: cost, gradient and Gauss-Newton Hessian (upper left `n x n`).
#[derive(Clone, Debug)]
pub struct Expansion {
    /// Value of the cost.
    pub value: f64,
    /// Its gradient.
    pub gradient: Plan,
    /// Its Gauss-Newton Hessian, row by row; symmetric and positive definite.
    pub hessian: [[f64; MAX_VARIABLES]; MAX_VARIABLES],
}

impl Expansion {
    /// An empty expansion, to be filled by [`expand`].
    pub const fn empty() -> Self {
        Self {
            value: 0.0,
            gradient: [0.0; MAX_VARIABLES],
            hessian: [[0.0; MAX_VARIABLES]; MAX_VARIABLES],
        }
    }
}

/// The schedule of R: the share of R that applies at the root mean square distance between the features and what
/// they track, in (0, 1].
pub fn r_share(task: &Task, points: &[[f64; 2]], target: &[[f64; 2]]) -> f64 {
    let relative = features::rms_distance(points, target) / (FULL_R_DISTANCE * task.camera.width);
    (relative * relative).min(1.0)
}

/// The cost of a preview: sum over the steps of k_q |target - s_j|^2, and over all but the last of v_j^T R v_j.
pub fn value(task: &Task, preview: &Preview, plan: &Plan, target: &Points, r_share: f64) -> f64 {
    let error: f64 = (0..preview.np())
        .flat_map(|j| preview.step(j).iter().zip(target))
        .map(|(s, t)| (s[0] - t[0]) * (s[0] - t[0]) + (s[1] - t[1]) * (s[1] - t[1]))
        .sum();
    let effort: f64 = (0..preview.np() - 1)
        .map(|j| {
            let block = DOF * preview.block(j);
            task.cost
                .r
                .iter()
                .enumerate()
                .map(|(k, r)| r * plan[block + k] * plan[block + k])
                .sum::<f64>()
        })
        .sum();
    task.cost.k_q * error + r_share * effort
}

/// Fills the expansion of the cost about a previewed plan.
pub fn expand(
    task: &Task,
    preview: &Preview,
    plan: &Plan,
    target: &Points,
    r_share: f64,
    expansion: &mut Expansion,
) {
    let n = preview.variables();
    let two_q = 2.0 * task.cost.k_q;
    expansion.value = value(task, preview, plan, target, r_share);
    expansion.gradient = [0.0; MAX_VARIABLES];
    expansion
        .hessian
        .iter_mut()
        .take(n)
        .for_each(|row| *row = [0.0; MAX_VARIABLES]);

    for (i, (_, point)) in preview.previewed().enumerate() {
        let target = target[i % target.len()];
        for c in 0..2 {
            let slope = &point.gradient[c];
            let pull = two_q * (point.pixel[c] - target[c]);
            for a in 0..n {
                expansion.gradient[a] += pull * slope[a];
                let weighted = two_q * slope[a];
                for b in a..n {
                    expansion.hessian[a][b] += weighted * slope[b];
                }
            }
        }
    }
    for j in 0..preview.np() - 1 {
        let block = DOF * preview.block(j);
        for (k, r) in task.cost.r.iter().enumerate() {
            expansion.gradient[block + k] += 2.0 * r_share * r * plan[block + k];
            expansion.hessian[block + k][block + k] += 2.0 * r_share * r;
        }
    }
    // A floor far below every real curvature keeps the Hessian positive definite where R has vanished and a
    // direction moves no feature.
    let trace: f64 = (0..n).map(|a| expansion.hessian[a][a]).sum();
    for a in 0..n {
        expansion.hessian[a][a] += 1e-9 * trace / n as f64 + f64::MIN_POSITIVE;
        for b in 0..a {
            expansion.hessian[a][b] = expansion.hessian[b][a];
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::prediction::{Model, Origin};

    #[test]
    fn the_gradient_matches_finite_differences() {
        let task = Task::new(&scene::Scene::parse(scene::PAPER_SIM, "sim").unwrap()).unwrap();
        let pose = scene::Pose {
            translation: [0.1, -0.2, 0.9],
            rotation: [0.3, -0.2, 0.8],
        };
        let points = task.features_at(&pose).unwrap();
        let origin = Origin::new(&task, Model::Pose, &points);
        let mut preview = Box::new(Preview::new(7, 2));
        let mut plan = [0.0; MAX_VARIABLES];
        plan.iter_mut()
            .take(12)
            .enumerate()
            .for_each(|(k, x)| *x = 0.2 * libm::cos(k as f64));
        let mut at = |plan: &Plan| {
            assert!(preview.run(&task, &origin, plan));
            let mut expansion = Expansion::empty();
            expand(&task, &preview, plan, &task.goal, 0.7, &mut expansion);
            expansion
        };
        let exact = at(&plan);
        for k in 0..12 {
            let (mut plus, mut minus) = (plan, plan);
            plus[k] += 1e-6;
            minus[k] -= 1e-6;
            let numeric = (at(&plus).value - at(&minus).value) / 2e-6;
            assert!(
                (numeric - exact.gradient[k]).abs() < 1e-5 * (1.0 + numeric.abs()),
                "{k}"
            );
        }
    }

    #[test]
    fn r_vanishes_with_the_error_and_saturates_far_away() {
        let task = Task::new(&scene::Scene::parse(scene::PAPER_SIM, "sim").unwrap()).unwrap();
        assert_eq!(r_share(&task, &task.goal, &task.goal), 0.0);
        let far: Points = task.goal.iter().map(|p| [p[0] + 500.0, p[1]]).collect();
        assert_eq!(r_share(&task, &far, &task.goal), 1.0);
    }
}
