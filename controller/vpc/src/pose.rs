//! Pose of a known planar pattern from its image: homography, then Gauss-Newton on the reprojection
//! error.
#![expect(
    clippy::indexing_slicing,
    reason = "constant indices of vectors whose length is in the type, and k below 3"
)]

use heapless::Vec;
use libm::sqrt;
use nalgebra::{Matrix3, SMatrix, SVector, Vector3};

use crate::MAX_POINTS;
use crate::motion::rotation;

/// Most Gauss-Newton steps after the homography; it converges quadratically for small residuals.
const REFINEMENTS: usize = 4;
/// A step shorter than this (m and rad together) ends the refinement: far below a pixel's effect.
const REFINED: f64 = 1e-10;

/// The pose of the pattern in the camera frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Estimate {
    /// Rotation from the object frame to the camera frame.
    pub rotation: Matrix3<f64>,
    /// Origin of the object in the camera frame, m.
    pub translation: Vector3<f64>,
    /// Root mean square reprojection error in normalised image coordinates.
    pub residual: f64,
}

impl Estimate {
    /// A point of the object frame in the camera frame, m.
    pub fn apply(&self, point: &[f64; 3]) -> Vector3<f64> {
        self.rotation * Vector3::from(*point) + self.translation
    }
}

/// Estimates the pose from normalised image points (x, y) of the `pattern` (planar, z = 0, m).
/// `None` if the points do not fix a pose in front of the camera.
pub fn estimate(pattern: &[[f64; 3]], image: &[[f64; 2]]) -> Option<Estimate> {
    let mut pose = from_homography(pattern, image)?;
    for _ in 0..REFINEMENTS {
        let (refined, step) = refine(pattern, image, &pose)?;
        pose = refined;
        if step < REFINED {
            break;
        }
    }
    let in_front = pattern.iter().all(|p| pose.apply(p).z > 1e-6);
    (in_front && pose.residual.is_finite()).then_some(pose)
}

/// The homography of a plane, solved for its eight free entries about the pattern's centroid, whose
/// depth is positive whenever the whole pattern is visible; split into a rotation and a
/// translation.
fn from_homography(pattern: &[[f64; 3]], image: &[[f64; 2]]) -> Option<Estimate> {
    let count = pattern.len() as f64;
    let mean = |k: usize| pattern.iter().map(|p| p[k]).sum::<f64>() / count;
    let centre = [mean(0), mean(1)];
    let size = pattern
        .iter()
        .map(|p| (p[0] - centre[0]).abs() + (p[1] - centre[1]).abs())
        .fold(1e-12, f64::max);

    let mut normal = SMatrix::<f64, 8, 8>::zeros();
    let mut right = SVector::<f64, 8>::zeros();
    for (p, &[u, v]) in pattern.iter().zip(image) {
        let (x, y) = ((p[0] - centre[0]) / size, (p[1] - centre[1]) / size);
        let first = SVector::from([x, y, 1.0, 0.0, 0.0, 0.0, -u * x, -u * y]);
        let second = SVector::from([0.0, 0.0, 0.0, x, y, 1.0, -v * x, -v * y]);
        normal += first * first.transpose() + second * second.transpose();
        right += first * u + second * v;
    }
    let h = normal.cholesky()?.solve(&right);

    let first = Vector3::new(h[0], h[3], h[6]) / size;
    let second = Vector3::new(h[1], h[4], h[7]) / size;
    let origin = Vector3::new(h[2], h[5], 1.0);
    let scale = sqrt(first.norm() * second.norm());
    if !(scale.is_finite() && scale > 0.0) {
        return None;
    }
    let x = first.try_normalize(1e-12)?;
    let z = x.cross(&second).try_normalize(1e-12)?;
    let rotation = Matrix3::from_columns(&[x, z.cross(&x), z]);
    let translation = origin / scale - rotation * Vector3::new(centre[0], centre[1], 0.0);
    Some(Estimate {
        rotation,
        translation,
        residual: f64::INFINITY,
    })
}

/// One Gauss-Newton step on the reprojection error, perturbing the pose on its left; and its
/// length.
fn refine(pattern: &[[f64; 3]], image: &[[f64; 2]], pose: &Estimate) -> Option<(Estimate, f64)> {
    let mut normal = SMatrix::<f64, 6, 6>::zeros();
    let mut right = SVector::<f64, 6>::zeros();
    let mut squares = 0.0;
    for (p, seen) in pattern.iter().zip(image) {
        let x = pose.apply(p);
        if x.z <= 1e-9 {
            return None;
        }
        let (a, b) = (x.x / x.z, x.y / x.z);
        let error = [seen[0] - a, seen[1] - b];
        let iz = 1.0 / x.z;
        let first = SVector::from([iz, 0.0, -a * iz, -a * b, 1.0 + a * a, -b]);
        let second = SVector::from([0.0, iz, -b * iz, -(1.0 + b * b), a * b, a]);
        normal += first * first.transpose() + second * second.transpose();
        right += first * error[0] + second * error[1];
        squares += error[0] * error[0] + error[1] * error[1];
    }
    let step = normal.cholesky()?.solve(&right);
    let turn = rotation([step[3], step[4], step[5]]);
    let refined = Estimate {
        rotation: turn * pose.rotation,
        translation: turn * pose.translation + Vector3::new(step[0], step[1], step[2]),
        residual: sqrt(squares / pattern.len() as f64),
    };
    Some((refined, step.norm()))
}

/// The points of the pattern in the camera frame, m, at an estimated pose.
pub fn points(estimate: &Estimate, pattern: &[[f64; 3]]) -> Vec<Vector3<f64>, MAX_POINTS> {
    pattern
        .iter()
        .take(MAX_POINTS)
        .map(|p| estimate.apply(p))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_projected_pattern_gives_back_its_pose() {
        let pattern = [
            [-0.15, -0.15, 0.0],
            [0.15, -0.15, 0.0],
            [0.15, 0.15, 0.0],
            [-0.15, 0.15, 0.0],
        ];
        for (t, r) in [
            ([0.1, -0.2, 0.9], [0.3, -0.4, 1.2]),
            ([0.0, 0.0, 0.5], [0.0, 0.0, 0.0]),
            ([-0.3, 0.3, 1.2], [-0.5, 0.5, -2.9]),
        ] {
            let truth = Estimate {
                rotation: rotation(r),
                translation: Vector3::from(t),
                residual: 0.0,
            };
            let image: std::vec::Vec<[f64; 2]> = pattern
                .iter()
                .map(|p| {
                    let x = truth.apply(p);
                    [x.x / x.z, x.y / x.z]
                })
                .collect();
            let found = estimate(&pattern, &image).unwrap();
            assert!((found.rotation - truth.rotation).norm() < 1e-9);
            assert!((found.translation - truth.translation).norm() < 1e-9);
            assert!(found.residual < 1e-9);
        }
    }

    #[test]
    fn points_on_a_line_give_no_pose() {
        let pattern = [
            [-0.1, -0.1, 0.0],
            [0.1, -0.1, 0.0],
            [0.1, 0.1, 0.0],
            [-0.1, 0.1, 0.0],
        ];
        assert!(estimate(&pattern, &[[0.0, 0.0], [0.1, 0.0], [0.2, 0.0], [0.3, 0.0]]).is_none());
    }
}
