//! The cost of a plan and its Gauss-Newton expansion.
//!
//! l(V) = k_Q sum_{j=1..Np} |s_d - s_j|^2 + r sum_{j=1..Np-1} (v_j - d)^T R (v_j - d)
//!
//! c(V) = q sum_{b=1..Nc} (v_b - v_{b-1})^T R (v_b - v_{b-1})
//!
//! | Symbol | Here | Meaning |
//! |---|---|---|
//! | s_d | `target` | what is tracked: goal or way point, less the mismatch, px |
//! | k_Q, R | `task.cost` | weight of the image error, 1/px^2, and of the velocity |
//! | r | [`r_share`] | share of R that applies |
//! | v_0 | `standing` | the command in force |
//! | d | `drift` | twist of the pattern itself, so that following it costs nothing |
//! | q | `change_share` | share of R that weighs changes of the command |
//!
//! Source: paper, Eq. (cost), for l(V). c(V) is not the paper's: r vanishes at the goal, and
//! without c(V) the commands follow the noise there.
#![expect(
    clippy::indexing_slicing,
    reason = "a dense kernel: indices run over the N variables, and an offset leaves DOF of them"
)]

use crate::prediction::Preview;
use crate::problem::{Problem, Weights};
use crate::task::Task;
use crate::{DOF, features};

/// Mean distance from the target at which R has its full value, as a share of the image width.
/// Below it R falls with the square of the distance, so that neither term of the cost dominates on
/// the way, and R vanishes with the error as in the paper.
pub const FULL_R_DISTANCE: f64 = 0.25;

/// A quadratic expansion: cost, gradient and Gauss-Newton Hessian in the `N` variables of the plan.
#[derive(Clone, Debug)]
pub struct Expansion<const N: usize> {
    /// Value of the cost.
    pub value: f64,
    /// Its gradient.
    pub gradient: [f64; N],
    /// Its Gauss-Newton Hessian, row by row; symmetric and positive definite.
    pub hessian: [[f64; N]; N],
}

/// The schedule of R: the share of R that applies at the root mean square distance between the
/// features and what they track, in (0, 1].
pub fn r_share(task: &Task, points: &[[f64; 2]], target: &[[f64; 2]]) -> f64 {
    let relative = features::rms_distance(points, target) / (FULL_R_DISTANCE * task.camera.width);
    (relative * relative).min(1.0)
}

/// l(V) of a previewed plan.
pub fn value<const N: usize>(
    problem: &Problem<'_>,
    preview: &Preview<'_, N>,
    plan: &[f64; N],
) -> f64 {
    let Problem { task, target, .. } = problem;
    let Weights {
        k_q,
        r_share,
        wanted,
        ..
    } = problem.weights();
    let error: f64 = (0..preview.np())
        .flat_map(|j| preview.step(j).iter().zip(*target))
        .map(|(s, t)| (s[0] - t[0]) * (s[0] - t[0]) + (s[1] - t[1]) * (s[1] - t[1]))
        .sum();
    let effort: f64 = (0..preview.np() - 1)
        .map(|j| {
            let command = &plan[preview.offset(j)..];
            let pairs = task.cost.r.iter().zip(command.iter().zip(wanted));
            let weighted = pairs.map(|(r, (v, d))| r * (v - d) * (v - d));
            weighted.sum::<f64>()
        })
        .sum();
    k_q * error + r_share * effort
}

/// c(V) of a plan.
pub fn change<const N: usize>(problem: &Problem<'_>, plan: &[f64; N]) -> f64 {
    let squares = (0..N).map(|k| {
        let step = plan[k] - before(problem, plan, k);
        problem.task.cost.r[k % DOF] * step * step
    });
    problem.weights().change_share * squares.sum::<f64>()
}

/// The variable from which the `k`-th is a change.
fn before<const N: usize>(problem: &Problem<'_>, plan: &[f64; N], k: usize) -> f64 {
    match k.checked_sub(DOF) {
        Some(before) => plan[before],
        None => problem.standing[k],
    }
}

impl<const N: usize> Expansion<N> {
    /// The expansion of l(V) + c(V) about a previewed plan.
    pub fn about(problem: &Problem<'_>, preview: &Preview<'_, N>, plan: &[f64; N]) -> Self {
        let Problem { task, target, .. } = *problem;
        let Weights {
            k_q,
            r_share,
            change_share,
            wanted,
        } = problem.weights();
        let two_q = 2.0 * k_q;
        let (mut gradient, mut hessian) = ([0.0; N], [[0.0; N]; N]);
        for step in preview.steps() {
            for (point, target) in step.zip(target) {
                for c in 0..2 {
                    let slope = &point.gradient[c];
                    let pull = two_q * (point.place.pixel[c] - target[c]);
                    for a in 0..N {
                        gradient[a] += pull * slope[a];
                        let weighted = two_q * slope[a];
                        for b in 0..=a {
                            hessian[a][b] += weighted * slope[b];
                        }
                    }
                }
            }
        }
        for j in 0..preview.np() - 1 {
            let offset = preview.offset(j);
            for (k, r) in task.cost.r.iter().enumerate() {
                let relative = plan[offset + k] - wanted[k];
                gradient[offset + k] += 2.0 * r_share * r * relative;
                hessian[offset + k][offset + k] += 2.0 * r_share * r;
            }
        }
        for k in 0..N {
            let weight = 2.0 * change_share * task.cost.r[k % DOF];
            let pull = weight * (plan[k] - before(problem, plan, k));
            gradient[k] += pull;
            hessian[k][k] += weight;
            if let Some(before) = k.checked_sub(DOF) {
                gradient[before] -= pull;
                hessian[before][before] += weight;
                hessian[k][before] -= weight;
            }
        }
        for a in 0..N {
            for b in 0..a {
                hessian[b][a] = hessian[a][b];
            }
        }
        // A floor far below every real curvature keeps the Hessian positive definite where R has
        // vanished and a direction moves no feature.
        let trace: f64 = (0..N).map(|a| hessian[a][a]).sum();
        for a in 0..N {
            hessian[a][a] += 1e-9 * trace / N as f64 + f64::MIN_POSITIVE;
        }
        Self {
            value: value(problem, preview, plan) + change(problem, plan),
            gradient,
            hessian,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Points;
    use crate::prediction::{InitialState, Model};

    #[test]
    fn the_gradient_matches_finite_differences() {
        let task = Task::new(&scene::Scene::parse(scene::PAPER_SIM, "sim").unwrap()).unwrap();
        let pose = scene::Pose {
            translation: [0.1, -0.2, 0.9],
            rotation: [0.3, -0.2, 0.8],
        };
        let points = task.features_at(&pose).unwrap();
        let initial = InitialState::new(&task, Model::Pose, &points);
        let mut workspace = vec![0.0; Preview::<12>::room(7, 4)];
        let mut preview = Preview::<12>::new(7, 4, &mut workspace).unwrap();
        let plan: [f64; 12] = core::array::from_fn(|k| 0.2 * libm::cos(k as f64));
        let problem = Problem {
            task: &task,
            initial: &initial,
            target: &task.goal,
            r_share: 0.7,
            change_share: 0.2,
            standing: [0.1, -0.2, 0.3, 0.1, 0.0, -0.4],
            interval: task.ts,
            ts: task.ts,
            margin: 0.0,
            dampers: None,
            view: None,
            wanted: None,
            watched: 7,
        };
        let mut at = |plan: &[f64; 12]| {
            assert!(preview.linearize(&task, &initial, plan, task.ts));
            Expansion::about(&problem, &preview, plan)
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
