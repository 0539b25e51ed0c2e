//! One Gaussian in R^6, kept as a square root of its covariance and the inverse of that.

use nalgebra::{SMatrix, SVector, SymmetricEigen};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

use super::DIMENSION;

/// A point: translation (m), rotation vector (rad).
pub type Point = SVector<f64, DIMENSION>;

/// A covariance or a square root of one; the units are the products of those of [`Point`].
pub type Square = SMatrix<f64, DIMENSION, DIMENSION>;

/// Bound of the QR sweeps in one eigenvalue problem of size 6; about a dozen are needed.
const EIGEN_SWEEPS: usize = 1000;

/// A normal distribution with a covariance that is positive definite by construction.
#[derive(Clone, Debug)]
pub struct Gaussian {
    mean: Point,
    /// A with Sigma = A A^T.
    root: Square,
    /// The inverse of A.
    inverse_root: Square,
    /// ln det(2 pi Sigma).
    log_volume: f64,
}

impl Gaussian {
    /// The likeliest Gaussian with `mean` whose covariance is at least diag(`floor`^2), for points
    /// whose scatter about `mean`, divided by their weight, is `scatter`.
    ///
    /// In coordinates divided by the floor the constraint reads Sigma >= I. There the likelihood
    /// -(log det Sigma + tr Sigma^-1 S) / 2 is greatest for the eigenvectors of S with each
    /// eigenvalue raised to at least 1.
    pub fn above_floor(mean: Point, scatter: &Square, floor: &[f64; DIMENSION]) -> Self {
        let floor = Point::from(*floor);
        let scaled = Square::from_fn(|row, column| {
            0.5 * (scatter[(row, column)] + scatter[(column, row)]) / (floor[row] * floor[column])
        });
        // A finite symmetric matrix converges; should it not, independent axes are still a
        // Gaussian.
        let (axes, variances) = SymmetricEigen::try_new(scaled, f64::EPSILON, EIGEN_SWEEPS)
            .map_or((Square::identity(), scaled.diagonal()), |e| {
                (e.eigenvectors, e.eigenvalues)
            });
        let deviations = variances.map(|variance| variance.max(1.0).sqrt());
        let root =
            Square::from_fn(|row, column| floor[row] * axes[(row, column)] * deviations[column]);
        let inverse_root =
            Square::from_fn(|row, column| axes[(column, row)] / (deviations[row] * floor[column]));
        let log_volume = 2.0 * (deviations.map(f64::ln).sum() + floor.map(f64::ln).sum())
            + DIMENSION as f64 * std::f64::consts::TAU.ln();
        Self {
            mean,
            root,
            inverse_root,
            log_volume,
        }
    }

    /// The Gaussian of a few points: their mean, and their variance along each axis held above the
    /// floor.
    pub fn with_independent_axes(points: &[Point], floor: &[f64; DIMENSION]) -> Self {
        let count = points.len().max(1) as f64;
        let mean = points.iter().sum::<Point>() / count;
        let variances = points
            .iter()
            .map(|p| (p - mean).map(|d| d * d))
            .sum::<Point>()
            / count;
        Self::above_floor(mean, &Square::from_diagonal(&variances), floor)
    }

    /// Mean: m for the first three coordinates, rad for the last three.
    pub fn mean(&self) -> &Point {
        &self.mean
    }

    /// Covariance: symmetric, at least the floor.
    pub fn covariance(&self) -> Square {
        self.root * self.root.transpose()
    }

    /// Natural logarithm of the density at `point`.
    pub fn log_density(&self, point: &Point) -> f64 {
        -0.5 * ((self.inverse_root * (point - self.mean)).norm_squared() + self.log_volume)
    }

    /// Draws one point.
    pub fn sample(&self, rng: &mut ChaCha8Rng) -> [f64; DIMENSION] {
        let normal = Point::from_fn(|_, _| rng.sample(StandardNormal));
        (self.mean + self.root * normal).into()
    }
}
