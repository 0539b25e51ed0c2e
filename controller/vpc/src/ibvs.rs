//! Classic image-based visual servoing, for comparison: v = -lambda L^+ (s - s*).
//!
//! Source: paper, Sect. I; F. Chaumette and S. Hutchinson, "Visual servo control, part I", Eq. (5), with the current
//! interaction matrix and the depths of the chosen model.

use nalgebra::{SMatrix, SVector};

use crate::prediction::Origin;
use crate::task::Task;
use crate::{Twist, camera, interaction};

/// The unlimited camera twist of the classic law with the gain `lambda` (1/s), or `None` where the interaction
/// matrix is singular.
pub fn twist(task: &Task, origin: &Origin, lambda: f64) -> Option<Twist> {
    let mut normal = SMatrix::<f64, 6, 6>::zeros();
    let mut right = SVector::<f64, 6>::zeros();
    for ((&point, &goal), z) in origin.points.iter().zip(&task.goal).zip(origin.depths()) {
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
    let v = normal.cholesky()?.solve(&right) * -lambda;
    v.iter().all(|x| x.is_finite()).then(|| v.into())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::prediction::Model;

    #[test]
    fn the_first_twist_is_that_of_visp() {
        // Four points at +-0.06 m, goal 0.36 m in front; the expected values were computed with ViSP.
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
        let origin = Origin::new(&task, Model::Pose, &points);
        let expected = [
            0.01711230355,
            -0.09658559499,
            0.03068585903,
            0.08916172435,
            -0.00330862137,
            0.6429081433,
        ];
        for (found, expected) in twist(&task, &origin, 0.5).unwrap().iter().zip(expected) {
            assert!((found - expected).abs() < 1e-6, "{found} {expected}");
        }
    }
}
