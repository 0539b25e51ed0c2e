//! The size of the target, which images alone do not tell: the arm's motion is its measure.

use nalgebra::{Matrix3x4, Matrix4, Vector3, Vector4};
use vision_calibration_core::{Iso3, Vec3};

/// Motions that translate or turn by less say nothing, m and rad.
const LEAST: [f64; 2] = [0.02, 0.1];

/// The target's size.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Scale {
    /// Of what was believed.
    pub size: f64,
    /// Standard deviation.
    pub sigma: f64,
}

/// Estimates it by linear least squares, and its deviation by leaving out each pose: `flanges` in
/// the base, `targets` in the camera, and the mounting, of which the rotation is used. `None` where
/// the motions do not tell.
pub fn estimate(flanges: &[Iso3], targets: &[Iso3], mount: &Iso3) -> Option<Scale> {
    let size = of(flanges, targets, mount, None)?;
    let count = flanges.len();
    let without: Option<Vec<f64>> = (0..count)
        .map(|pose| of(flanges, targets, mount, Some(pose)))
        .collect();
    let squares = without?
        .iter()
        .map(|other| (other - size).powi(2))
        .sum::<f64>();
    // The jackknife's variance.
    let sigma = (squares * (count as f64 - 1.0) / count as f64).sqrt();
    Some(Scale { size, sigma })
}

/// (R_A - I) t - s R_X t_B = -t_A for t, the place of the camera, and s.
fn of(flanges: &[Iso3], targets: &[Iso3], mount: &Iso3, without: Option<usize>) -> Option<f64> {
    let (mut normal, mut right) = (Matrix4::zeros(), Vector4::zeros());
    let used = || (0..flanges.len()).filter(|pose| Some(*pose) != without);
    for i in used() {
        for j in used().filter(|j| *j > i) {
            let robot = flanges[i].inverse() * flanges[j];
            let camera = targets[i] * targets[j].inverse();
            let is_little = robot.translation.vector.norm() < LEAST[0];
            if is_little && robot.rotation.angle() < LEAST[1] {
                continue;
            }
            let turned = |k: usize| robot.rotation * Vec3::ith(k, 1.0) - Vec3::ith(k, 1.0);
            let shift = -(mount.rotation * camera.translation.vector);
            let columns = [turned(0), turned(1), turned(2), shift];
            let rows = Matrix3x4::from_fn(|row, column| columns[column][row]);
            let b = robot.translation.vector;
            normal += rows.transpose() * rows;
            right -= rows.transpose() * Vector3::new(b.x, b.y, b.z);
        }
    }
    let solution = normal.cholesky()?.solve(&right);
    Some(solution[3]).filter(|size| size.is_finite() && *size > 0.0)
}
