//! Pose of a known planar pattern from its image: homography, then Gauss-Newton on the reprojection
//! error.
//!
//! A plane that is small in the image has two poses that explain it almost alike: the second is the
//! first one mirrored in depth about its centre. Both are refined. In one image the wrong one often
//! has the smaller error by chance, since four points leave it two degrees of freedom. So the
//! estimate keeps the pose of the image before until the errors of the other one are smaller on
//! average ([`Tilt`]).
//!
//! Source of the two minima: Schweighofer and Pinz, "Robust pose estimation from a planar target",
//! IEEE PAMI 28(12), 2006.
#![expect(
    clippy::indexing_slicing,
    reason = "constant indices of vectors whose length is in the type, and k below 3"
)]

use heapless::Vec;
use libm::sqrt;
use nalgebra::{Matrix3, SMatrix, SVector, Vector3};
use serde::{Deserialize, Serialize};

use crate::MAX_POINTS;
use crate::motion::rotation;

/// Most Gauss-Newton steps from a first guess; they converge quadratically for small residuals.
const REFINEMENTS: usize = 12;
/// Where the first guess of the second pose has a greater residual than this (in normalised image
/// coordinates: 3 px at a focal length of 600), the image leaves no doubt.
const CLEAR: f64 = 0.005;
/// Share of an image in the average of the evidence.
const SHARE: f64 = 0.05;
/// Shares of a step that are tried.
const HALVINGS: [f64; 3] = [1.0, 0.5, 0.25];
/// A step shorter than this is taken as it is: its effect on the error is lost in rounding.
const SHORT: f64 = 1e-6;
/// Least depth of a point, m.
const NEAREST: f64 = 1e-6;
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
    /// The pattern's normal in the camera frame, of length 1.
    pub fn normal(&self) -> Vector3<f64> {
        self.rotation.column(2).into()
    }

    /// The pose after a small motion of the camera frame.
    fn turned(&self, step: &SVector<f64, 6>) -> Self {
        let turn = rotation([step[3], step[4], step[5]]);
        Self {
            rotation: turn * self.rotation,
            translation: turn * self.translation + Vector3::new(step[0], step[1], step[2]),
            ..*self
        }
    }

    /// The same pose with its reprojection error; `None` if a point is not in front of the camera.
    fn judged(mut self, pattern: &[[f64; 3]], image: &[[f64; 2]]) -> Option<Self> {
        let mut squares = 0.0;
        for (p, seen) in pattern.iter().zip(image) {
            let x = self.apply(p);
            if x.z <= NEAREST {
                return None;
            }
            let (u, v) = (seen[0] - x.x / x.z, seen[1] - x.y / x.z);
            squares += u * u + v * v;
        }
        self.residual = sqrt(squares / pattern.len() as f64);
        self.residual.is_finite().then_some(self)
    }

    /// A point of the object frame in the camera frame, m.
    pub fn apply(&self, point: &[f64; 3]) -> Vector3<f64> {
        self.rotation * Vector3::from(*point) + self.translation
    }
}

/// Which of the two poses is believed, from image to image.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Tilt {
    /// The pattern's normal in the camera frame, of length 1.
    pub normal: [f64; 3],
    /// By how much the squared residual of the other pose was larger, averaged over some images.
    pub evidence: f64,
}

/// Estimates the pose from normalised image points (x, y) of the `pattern` (planar, z = 0, m).
/// `before` is that of the image before. `None` if the points do not fix a pose in front of the
/// camera.
pub fn estimate(
    pattern: &[[f64; 3]],
    image: &[[f64; 2]],
    before: Option<&Tilt>,
) -> Option<(Estimate, Tilt)> {
    let guess = from_homography(pattern, image)?;
    let first = refined(pattern, image, guess);
    let mirrored = mirrored(pattern, &first.unwrap_or(guess)).judged(pattern, image);
    let is_clear = mirrored.is_none_or(|mirrored| mirrored.residual > CLEAR);
    let second = match (first, mirrored) {
        (Some(_), _) if is_clear => None,
        (_, mirrored) => mirrored.and_then(|mirrored| refined(pattern, image, mirrored)),
    };
    let (Some(mut kept), Some(mut other)) = (first, second) else {
        let only = first.or(second)?;
        let normal = only.normal().into();
        let evidence = if is_clear { CLEAR * CLEAR } else { 0.0 };
        return Some((only, Tilt { normal, evidence }));
    };
    let is_other_nearer = before.map_or(other.residual < kept.residual, |tilt| {
        let normal = Vector3::from(tilt.normal);
        normal.dot(&other.normal()) > normal.dot(&kept.normal())
    });
    if is_other_nearer {
        (kept, other) = (other, kept);
    }
    let now = other.residual * other.residual - kept.residual * kept.residual;
    let mut evidence = before.map_or(now, |tilt| tilt.evidence + SHARE * (now - tilt.evidence));
    if evidence < 0.0 {
        (kept, evidence) = (other, -evidence);
    }
    let normal = kept.normal().into();
    Some((kept, Tilt { normal, evidence }))
}

/// Gauss-Newton from a guess; a step that does not make the error smaller is halved. `None` if the
/// pattern is not in front of the camera.
fn refined(pattern: &[[f64; 3]], image: &[[f64; 2]], guess: Estimate) -> Option<Estimate> {
    let mut pose = guess.judged(pattern, image)?;
    for _ in 0..REFINEMENTS {
        let Some(step) = step(pattern, image, &pose) else {
            break;
        };
        let shorter = HALVINGS.iter().map(|share| pose.turned(&(step * *share)));
        let mut better = shorter.filter_map(|next| next.judged(pattern, image));
        let is_short = step.norm() < SHORT;
        match better.find(|next| is_short || next.residual < pose.residual) {
            Some(next) => pose = next,
            None => break,
        }
        if step.norm() < REFINED {
            break;
        }
    }
    Some(pose)
}

/// The pose mirrored along the line of sight to the pattern's centre: seen from far away it gives
/// the same image. Turning the normal over as well keeps it a rotation; the pattern has no depth.
fn mirrored(pattern: &[[f64; 3]], pose: &Estimate) -> Estimate {
    let sum: Vector3<f64> = pattern.iter().map(|p| Vector3::from(*p)).sum();
    let centre = sum / pattern.len() as f64;
    let seen = pose.rotation * centre + pose.translation;
    let sight = seen.normalize();
    let mirror = Matrix3::identity() - sight * sight.transpose() * 2.0;
    let over = Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, -1.0));
    let rotation = mirror * pose.rotation * over;
    Estimate {
        rotation,
        translation: seen - rotation * centre,
        residual: f64::INFINITY,
    }
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

/// The Gauss-Newton step on the reprojection error, which moves the pose on its left; `None` if the
/// points do not fix one.
fn step(pattern: &[[f64; 3]], image: &[[f64; 2]], pose: &Estimate) -> Option<SVector<f64, 6>> {
    let mut normal = SMatrix::<f64, 6, 6>::zeros();
    let mut right = SVector::<f64, 6>::zeros();
    for (p, seen) in pattern.iter().zip(image) {
        let x = pose.apply(p);
        let (a, b) = (x.x / x.z, x.y / x.z);
        let error = [seen[0] - a, seen[1] - b];
        let iz = 1.0 / x.z;
        let first = SVector::from([iz, 0.0, -a * iz, -a * b, 1.0 + a * a, -b]);
        let second = SVector::from([0.0, iz, -b * iz, -(1.0 + b * b), a * b, a]);
        normal += first * first.transpose() + second * second.transpose();
        right += first * error[0] + second * error[1];
    }
    Some(normal.cholesky()?.solve(&right))
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
            let (found, _) = estimate(&pattern, &image, None).unwrap();
            assert!((found.rotation - truth.rotation).norm() < 1e-9);
            assert!((found.translation - truth.translation).norm() < 1e-9);
            assert!(found.residual < 1e-9);
        }
    }

    /// The image of a pattern, with noise of up to `noise` on each coordinate.
    fn image_of(
        pattern: &[[f64; 3]],
        pose: &Estimate,
        mut noise: impl FnMut() -> f64,
    ) -> [[f64; 2]; 4] {
        core::array::from_fn(|i| {
            let x = pose.apply(&pattern[i]);
            [x.x / x.z + noise(), x.y / x.z + noise()]
        })
    }

    /// Corners of a tag of 3 cm.
    const TAG: [[f64; 3]; 4] = [
        [-0.015, -0.015, 0.0],
        [0.015, -0.015, 0.0],
        [0.015, 0.015, 0.0],
        [-0.015, 0.015, 0.0],
    ];

    #[test]
    fn a_small_pattern_does_not_flip() {
        // Seen from 0.5 m at a focal length of 600 px with noise of 0.3 px, from its
        // left and slowly from above.
        let mut seed = 1_u64;
        let mut noise = || {
            seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            ((seed >> 40) as f64 / (1 << 24) as f64 - 0.5) * 12_f64.sqrt() * 0.3 / 600.0
        };
        let (mut before, mut flips, mut last) = (None, [0, 0], [0, 0]);
        for k in 0..600 {
            let truth = Estimate {
                rotation: rotation([0.001 * f64::from(k), 0.4, 0.1]),
                translation: Vector3::new(0.05, -0.03, 0.5),
                residual: 0.0,
            };
            let image = image_of(&TAG, &truth, &mut noise);
            let other = mirrored(&TAG, &truth).normal();
            let is_flipped = |normal: [f64; 3]| {
                let normal = Vector3::from(normal);
                u32::from(normal.dot(&other) > normal.dot(&truth.normal()))
            };
            let (_, alone) = estimate(&TAG, &image, None).unwrap();
            let (_, kept) = estimate(&TAG, &image, before.as_ref()).unwrap();
            let sides = [is_flipped(alone.normal), is_flipped(kept.normal)];
            for i in 0..2 {
                flips[i] += u32::from(sides[i] != last[i]);
            }
            last = sides;
            before = Some(kept);
        }
        assert!(flips[0] > 60 && flips[1] < flips[0] / 6, "{flips:?}");
    }

    #[test]
    fn both_poses_of_a_small_pattern_are_found() {
        // Begun from the wrong one, without noise, the right one counts.
        let truth = Estimate {
            rotation: rotation([0.3, 0.4, 0.1]),
            translation: Vector3::new(0.05, -0.03, 0.5),
            residual: 0.0,
        };
        let image = image_of(&TAG, &truth, || 0.0);
        let wrong = refined(&TAG, &image, mirrored(&TAG, &truth)).unwrap();
        assert!(wrong.residual > 1e-4, "{}", wrong.residual);
        let mut tilt = Tilt {
            normal: wrong.normal().into(),
            evidence: 1e-6,
        };
        let mut find = || {
            let (found, next) = estimate(&TAG, &image, Some(&tilt)).unwrap();
            tilt = next;
            found
        };
        assert!(find().normal().dot(&wrong.normal()) > 1.0 - 1e-9);
        let found = (0..200).map(|_| find()).last().unwrap();
        assert!((found.rotation - truth.rotation).norm() < 1e-9);
    }

    #[test]
    fn points_on_a_line_give_no_pose() {
        let pattern = [
            [-0.1, -0.1, 0.0],
            [0.1, -0.1, 0.0],
            [0.1, 0.1, 0.0],
            [-0.1, 0.1, 0.0],
        ];
        let line = [[0.0, 0.0], [0.1, 0.0], [0.2, 0.0], [0.3, 0.0]];
        assert!(estimate(&pattern, &line, None).is_none());
    }
}
