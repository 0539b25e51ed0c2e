//! Queries, written for clearness: the reference that the fast query of `memory-blob` is compared
//! with.

use super::{Fit, Kernel, Matrix, RegressionError};

/// What the process says about one query.
#[derive(Clone, Debug, PartialEq)]
pub struct Prediction {
    /// Mean of each output, in its own units.
    pub mean: Vec<f64>,
    /// Variance of the function without noise, in squared output scales: times the square of
    /// [`Fit::output_scales`] it is the variance of that output. Add [`Fit::noise_variance`] for
    /// the variance of a new sample.
    pub variance: f64,
}

impl Fit {
    /// The kernel with the fitted hyper-parameters.
    pub fn kernel(&self) -> Kernel {
        Kernel {
            length_scales: self.length_scales.clone(),
            signal_variance: self.signal_variance,
            noise_variance: self.noise_variance,
        }
    }

    /// Evaluates the process that was fitted to `inputs` at `query` (n values, scaled as the inputs
    /// are).
    ///
    /// # Errors
    /// When `inputs` are not as many as were fitted, or `query` has the wrong length or a value
    /// that is not finite.
    pub fn predict(&self, inputs: &Matrix, query: &[f64]) -> Result<Prediction, RegressionError> {
        let samples = self.lambda.rows();
        if inputs.rows() != samples {
            let expected = format!("the {samples} that were fitted are needed");
            let found = inputs.rows();
            return Err(RegressionError::Size {
                name: "inputs",
                what: "rows",
                found,
                expected,
            });
        }
        let query = Matrix::new("query", self.length_scales.len(), query.to_vec())?;
        let kernel = self.kernel();
        let k: Vec<f64> = (0..samples)
            .map(|row| kernel.value(query.row(0), inputs.row(row)))
            .collect();
        let mut mean = self.mean.clone();
        for (row, k) in k.iter().enumerate() {
            for (mean, weight) in mean.iter_mut().zip(self.lambda.row(row)) {
                *mean += k * weight;
            }
        }
        // forward substitution: v = L^-1 k, and the variance is phi_o^2 - v^T v
        let mut v: Vec<f64> = Vec::with_capacity(samples);
        let mut start = 0;
        for (row, k) in k.iter().enumerate() {
            let line = &self.cholesky[start..=start + row];
            let known: f64 = line.iter().zip(&v).map(|(l, v)| l * v).sum();
            v.push((k - known) / line[row]);
            start += row + 1;
        }
        let explained: f64 = v.iter().map(|v| v * v).sum();
        Ok(Prediction {
            mean,
            variance: (self.signal_variance - explained).max(0.0),
        })
    }
}
