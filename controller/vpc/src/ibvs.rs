//! Classic image-based visual servoing, for comparison: v = -lambda L^+ (s - s*).
//!
//! Source: paper, Sect. I; F. Chaumette and S. Hutchinson, "Visual servo control, part I", Eq. (5),
//! with the current interaction matrix and the depths of the chosen model.

use nalgebra::{SMatrix, SVector};

use crate::prediction::InitialState;
use crate::task::Task;
use crate::{Twist, camera, interaction};

/// Least pivot of L^T L with columns of length one below which L counts as singular: what is left
/// of a column that the others do not explain. It is some 5e-5 for a square of 100 px in an image
/// of 1024, 9e-7 for one of 10 px, and below 4e-7 for a pattern seen as a strip 5 px high, where
/// noise would decide the twist.
const LEAST_PIVOT: f64 = 5e-7;

/// The unlimited camera twist of the classic law towards `goal`, px, with the gain `lambda` (1/s),
/// or `None` if the interaction matrix is singular, or nearly so.
#[expect(
    clippy::indexing_slicing,
    reason = "from_fn gives indices inside the matrix"
)]
pub fn twist(task: &Task, initial: &InitialState, goal: &[[f64; 2]], lambda: f64) -> Option<Twist> {
    let mut normal = SMatrix::<f64, 6, 6>::zeros();
    let mut right = SVector::<f64, 6>::zeros();
    for ((&point, &goal), z) in initial.points.iter().zip(goal).zip(initial.depths()) {
        let here = camera::normalise(&task.camera, point);
        let there = camera::normalise(&task.camera, goal);
        for (row, (p, q)) in interaction::of_point(here, z)
            .into_iter()
            .zip(here.into_iter().zip(there))
        {
            let row = SVector::<f64, 6>::from(row);
            normal += row * row.transpose();
            right += row * (p - q);
        }
    }
    // L has full column rank away from singular configurations, where L^+ e = (L^T L)^{-1} L^T e.
    let scale = normal.diagonal().map(|x| 1.0 / libm::sqrt(x));
    let scaled = SMatrix::<f64, 6, 6>::from_fn(|i, j| normal[(i, j)] * scale[i] * scale[j]);
    let factor = scaled.cholesky()?;
    let least = factor.l_dirty().diagonal().min();
    if least.is_nan() || least * least < LEAST_PIVOT {
        return None;
    }
    let v = factor
        .solve(&right.component_mul(&scale))
        .component_mul(&scale)
        * -lambda;
    v.iter().all(|x| x.is_finite()).then(|| v.into())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::prediction::Model;

    #[test]
    fn the_first_twist_is_that_of_visp() {
        // Four points at +-0.06 m, goal 0.36 m in front; the expected values were computed with
        // ViSP.
        let text = scene::PAPER_SIM
            .replace("0.15", "0.06")
            .replace("[0.0, 0.0, 0.6]", "[0.0, 0.0, 0.36]");
        let (head, _) = text.split_once("[[occlusion]]").unwrap();
        let task = Task::new(&scene::Scene::parse(head, "visp").unwrap()).unwrap();
        let rotation = [10f64, -10.0, 50.0].map(f64::to_radians);
        let pose = scene::Pose {
            translation: [0.15, -0.1, 0.6],
            rotation,
        };
        let points = task.features_at(&pose).unwrap();
        let initial = InitialState::new(&task, Model::Pose, &points);
        let expected = [
            0.01711230355,
            -0.09658559499,
            0.03068585903,
            0.08916172435,
            -0.00330862137,
            0.6429081433,
        ];
        for (found, expected) in twist(&task, &initial, &task.goal, 0.5)
            .unwrap()
            .iter()
            .zip(expected)
        {
            assert!((found - expected).abs() < 1e-6, "{found} {expected}");
        }
    }

    #[test]
    fn a_pattern_seen_as_a_line_has_no_twist() {
        let task = Task::new(&scene::Scene::parse(scene::PAPER_SIM, "sim").unwrap()).unwrap();
        let seen = |model, height: f64| {
            let [low, high] = [512.0 - 0.5 * height, 512.0 + 0.5 * height];
            let points = [[400.0, low], [600.0, low], [600.0, high], [400.0, high]];
            let initial = InitialState::new(&task, model, &points.into());
            twist(&task, &initial, &task.goal, 0.5)
        };
        for model in [Model::TargetDepth, Model::AreaDepth, Model::Pose] {
            assert!(seen(model, 200.0).is_some() && seen(model, 20.0).is_some());
            assert_eq!(seen(model, 2.0), None);
            assert_eq!(seen(model, 0.0), None);
        }
    }
}
