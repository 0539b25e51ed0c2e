//! The log marginal likelihood of all outputs under one kernel, and its gradient.
//!
//! With C = K + (phi_s + jitter) I, A = C^-1 Y and W = A A^T - p C^-1:
//!
//! L = -1/2 sum_o y_o^T C^-1 y_o - p/2 ln det C - p D/2 ln 2 pi, and dL/dt = 1/2 tr(W dC/dt).
//! Source: Rasmussen and Williams, Gaussian Processes for Machine Learning, Eqs. 5.8 and 5.9,
//! summed over outputs.

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::llt;
use faer::linalg::matmul::matmul;
use faer::linalg::triangular_solve::solve_lower_triangular_in_place;
use faer::linalg::triangular_solve::solve_upper_triangular_in_place;
use faer::{Accum, Mat, Par};

use super::Kernel;
pub use super::inputs::Inputs;

/// Jitters that are tried in turn, as shares of phi_o^2.
const JITTERS: [f64; 6] = [0.0, 1e-12, 1e-10, 1e-8, 1e-6, 1e-4];

/// The covariance has no Cholesky factor, even with the largest jitter.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error(
    "the covariance of {samples} samples is not positive definite, even with a jitter of {jitter:e}: \
     raise the lower bound of the noise variance"
)]
pub struct NotPositiveDefinite {
    samples: usize,
    /// In squared output scales.
    jitter: f64,
}

/// The Cholesky factor of a covariance with its noise.
#[derive(Clone, Debug)]
pub(super) struct Factor {
    /// The factor in the lower triangle; what stands above the diagonal has no meaning.
    pub(super) lower: Mat<f64>,
    /// What was added to the diagonal besides the noise, in squared output scales.
    pub(super) jitter: f64,
}

impl Factor {
    /// Factorises `covariance` (lower triangle) + noise, with the smallest jitter that works.
    pub(super) fn new(covariance: &Mat<f64>, kernel: &Kernel) -> Result<Self, NotPositiveDefinite> {
        let samples = covariance.nrows();
        let request =
            llt::factor::cholesky_in_place_scratch::<f64>(samples, Par::Seq, Default::default());
        let mut memory = MemBuffer::new(request);
        let mut jitter = 0.0;
        for share in JITTERS {
            jitter = share * kernel.signal_variance;
            let mut lower = covariance.clone();
            for i in 0..samples {
                lower[(i, i)] += kernel.noise_variance + jitter;
            }
            let result = llt::factor::cholesky_in_place(
                lower.as_mut(),
                llt::factor::LltRegularization::default(),
                Par::Seq,
                MemStack::new(&mut memory),
                Default::default(),
            );
            if result.is_ok() && (0..samples).all(|i| lower[(i, i)].is_finite()) {
                return Ok(Self { lower, jitter });
            }
        }
        Err(NotPositiveDefinite { samples, jitter })
    }

    /// Replaces `right` by C^-1 `right`.
    pub(super) fn solve_in_place(&self, right: &mut Mat<f64>) {
        solve_lower_triangular_in_place(self.lower.as_ref(), right.as_mut(), Par::Seq);
        solve_upper_triangular_in_place(self.lower.transpose(), right.as_mut(), Par::Seq);
    }

    /// ln det C.
    pub(super) fn log_determinant(&self) -> f64 {
        2.0 * (0..self.lower.nrows())
            .map(|i| self.lower[(i, i)].ln())
            .sum::<f64>()
    }

    /// C^-1 in the lower triangle.
    fn inverse(&self) -> Mat<f64> {
        let samples = self.lower.nrows();
        let request = llt::inverse::inverse_scratch::<f64>(samples, Par::Seq);
        let mut memory = MemBuffer::new(request);
        let mut inverse = Mat::zeros(samples, samples);
        let stack = MemStack::new(&mut memory);
        llt::inverse::inverse(inverse.as_mut(), self.lower.as_ref(), Par::Seq, stack);
        inverse
    }
}

/// Samples whose likelihood is asked for: inputs, and outputs that are already centred and divided
/// by their scales.
#[derive(Clone, Debug)]
pub struct Likelihood {
    inputs: Inputs,
    outputs: Mat<f64>,
}

impl Likelihood {
    /// Samples with as many inputs as rows of centred and scaled `outputs`.
    pub fn new(inputs: Inputs, outputs: Mat<f64>) -> Self {
        Self { inputs, outputs }
    }

    /// L (nats) at `kernel`, which has as many length scales as there are inputs.
    ///
    /// # Errors
    /// [`NotPositiveDefinite`].
    pub fn value(&self, kernel: &Kernel) -> Result<f64, NotPositiveDefinite> {
        let covariance = self
            .inputs
            .scaled(kernel)
            .covariance(kernel.signal_variance);
        let factor = Factor::new(&covariance, kernel)?;
        let mut weights = self.outputs.clone();
        factor.solve_in_place(&mut weights);
        Ok(self.value_from(&factor, &weights))
    }

    /// L (nats) and its derivatives with respect to ln l_1, ..., ln l_n, ln phi_o, ln phi_s. A
    /// jitter keeps its share of phi_o^2 in the derivative, so the gradient is exact wherever the
    /// jitter does not change.
    ///
    /// # Errors
    /// [`NotPositiveDefinite`].
    pub fn value_and_gradient(
        &self,
        kernel: &Kernel,
    ) -> Result<(f64, Vec<f64>), NotPositiveDefinite> {
        let scaled = self.inputs.scaled(kernel);
        let mut covariance = scaled.covariance(kernel.signal_variance);
        let factor = Factor::new(&covariance, kernel)?;
        let mut weights = self.outputs.clone();
        factor.solve_in_place(&mut weights);
        let value = self.value_from(&factor, &weights);

        // W = A A^T - p C^-1, lower triangle
        let mut w = factor.inverse();
        let (samples, outputs) = (self.outputs.nrows(), self.outputs.ncols() as f64);
        let mut products = Mat::<f64>::zeros(samples, samples);
        let (a, transposed) = (weights.as_ref(), weights.transpose());
        matmul(
            products.as_mut(),
            Accum::Replace,
            a,
            transposed,
            1.0,
            Par::Seq,
        );
        let mut trace = 0.0;
        let mut off_diagonal = 0.0;
        for column in 0..samples {
            trace += products[(column, column)] - outputs * w[(column, column)];
            for row in column + 1..samples {
                w[(row, column)] = products[(row, column)] - outputs * w[(row, column)];
                covariance[(row, column)] *= w[(row, column)];
                off_diagonal += covariance[(row, column)];
            }
        }
        // the covariance is now W .* K below the diagonal
        let mut gradient = scaled.weighted_squares(&covariance);
        gradient.push((kernel.signal_variance + factor.jitter) * trace + 2.0 * off_diagonal);
        gradient.push(0.5 * kernel.noise_variance * trace);
        Ok((value, gradient))
    }

    fn value_from(&self, factor: &Factor, weights: &Mat<f64>) -> f64 {
        let (samples, outputs) = (self.outputs.nrows() as f64, self.outputs.ncols() as f64);
        let columns = self.outputs.col_iter().zip(weights.col_iter());
        let fit: f64 = columns.map(|(y, a)| y.transpose() * a).sum();
        let volume = factor.log_determinant() + samples * std::f64::consts::TAU.ln();
        -0.5 * (fit + outputs * volume)
    }

    /// Number of samples, D.
    pub fn rows(&self) -> usize {
        self.inputs.rows()
    }

    /// Number of output values, D p.
    pub fn values(&self) -> usize {
        self.outputs.nrows() * self.outputs.ncols()
    }
}
