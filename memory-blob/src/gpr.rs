//! Gaussian-process regression, the on-line half: y = m + k(x, X) Lambda.
//!
//! Source: paper, Eq. (gpr); its Lambda carries one factor K(x, X) too many.

use crate::exp::{LANES, exp_nonpositive};
use crate::scaling::Scaling;
use crate::{MAX_INPUTS, QueryError};

/// Outputs summed together: rows of Lambda are padded to a multiple of this.
#[cfg(feature = "file")]
pub(crate) const OUTPUT_LANES: usize = 8;
/// Outputs after padding, at most.
const MAX_PADDED: usize = 24;

/// A borrowed view of the Gaussian process.
#[derive(Clone, Copy, Debug)]
pub struct Gpr<'a> {
    pub(crate) scaling: Scaling<'a>,
    pub(crate) count: usize,
    pub(crate) outputs: usize,
    pub(crate) signal_variance: f64,
    /// One for each input, in units of the scaled inputs.
    pub(crate) length_scale: &'a [f64],
    /// Scaled inputs over their length scales, [blocks, inputs, LANES].
    pub(crate) x: &'a [f64],
    /// Lambda, [blocks * LANES, padded outputs]; rows and columns past the counts are zero.
    pub(crate) lambda: &'a [f64],
    /// Constant mean of each output, padded.
    pub(crate) mean: &'a [f64],
    /// One for each output, in its units.
    pub(crate) output_scale: &'a [f64],
    /// Packed lower rows of the Cholesky factor of K + phi_s I; empty if the file has none.
    pub(crate) cholesky: &'a [f64],
}

impl<'a> Gpr<'a> {
    /// Number of samples that the process is conditioned on.
    pub fn len(&self) -> usize {
        self.count
    }

    /// Whether there is no sample.
    pub fn is_empty(&self) -> bool {
        self.count == 0
    }

    /// Entries of an output.
    pub fn outputs(&self) -> usize {
        self.outputs
    }

    /// Whether variances can be asked for.
    pub fn has_variance(&self) -> bool {
        !self.cholesky.is_empty()
    }

    /// Writes the mean at a raw input. Returns the greatest correlation of the input with a sample,
    /// 0 to 1: near 0 the process knows nothing there, and the mean is its constant one.
    ///
    /// # Errors
    /// [`QueryError`] if a length or an entry of the input is wrong.
    pub fn mean(&self, input: &[f64], output: &mut [f64]) -> Result<f64, QueryError> {
        if output.len() != self.outputs {
            return Err(QueryError::OutputLength {
                found: output.len(),
                expected: self.outputs,
            });
        }
        let query = self.query(input)?;
        let padded = self.mean.len();
        let mut sums = [0.0; MAX_PADDED];
        let correlation = match padded {
            8 => self.accumulate::<8>(&query, &mut sums),
            16 => self.accumulate::<16>(&query, &mut sums),
            _ => self.accumulate::<MAX_PADDED>(&query, &mut sums),
        };
        for (o, y) in output.iter_mut().enumerate() {
            *y = self.mean[o] + self.signal_variance * sums[o];
        }
        Ok(correlation)
    }

    /// Writes the latent predictive variance of each output at a raw input, in its squared units:
    /// the noise is not in it. One kernel serves all outputs, so they share k(x, x) - |L^{-1} k(X,
    /// x)|^2 and differ by their squared scales. `scratch` holds [`Gpr::len`] numbers.
    ///
    /// # Errors
    /// [`QueryError`] if a length or an entry is wrong, or the file holds no factor.
    pub fn variance(
        &self,
        input: &[f64],
        scratch: &mut [f64],
        output: &mut [f64],
    ) -> Result<(), QueryError> {
        if !self.has_variance() {
            return Err(QueryError::NoVariance);
        }
        for (found, expected) in [(scratch.len(), self.count), (output.len(), self.outputs)] {
            if found != expected {
                return Err(QueryError::OutputLength { found, expected });
            }
        }
        let query = self.query(input)?;
        for (block, kernel) in scratch.chunks_mut(LANES).enumerate() {
            let values = self.kernel(block, &query);
            kernel
                .iter_mut()
                .zip(values)
                .for_each(|(k, e)| *k = self.signal_variance * e);
        }
        let mut square = 0.0;
        let mut begin = 0;
        for i in 0..self.count {
            let row = &self.cholesky[begin..=begin + i];
            let sum: f64 = row[..i].iter().zip(&scratch[..i]).map(|(l, z)| l * z).sum();
            scratch[i] = (scratch[i] - sum) / row[i];
            square += scratch[i] * scratch[i];
            begin += i + 1;
        }
        let shared = (self.signal_variance - square).max(0.0);
        for (variance, scale) in output.iter_mut().zip(self.output_scale) {
            *variance = shared * scale * scale;
        }
        Ok(())
    }

    fn query(&self, input: &[f64]) -> Result<[f64; MAX_INPUTS], QueryError> {
        let mut query = self.scaling.apply(input)?;
        query
            .iter_mut()
            .zip(self.length_scale)
            .for_each(|(q, l)| *q /= l);
        Ok(query)
    }

    /// exp(-1/2 |x - x_i|^2) for the samples of a block.
    fn kernel(&self, block: usize, query: &[f64; MAX_INPUTS]) -> [f64; LANES] {
        let n = self.length_scale.len();
        let rows = &self.x[block * n * LANES..][..n * LANES];
        let mut squares = [0.0; LANES];
        for (row, q) in rows.chunks_exact(LANES).zip(query) {
            for (square, x) in squares.iter_mut().zip(row) {
                *square += (x - q) * (x - q);
            }
        }
        exp_nonpositive(&squares.map(|square| -0.5 * square))
    }

    /// Sums up Lambda, weighted by the correlations of the samples; returns the greatest of these.
    fn accumulate<const P: usize>(
        &self,
        query: &[f64; MAX_INPUTS],
        sums: &mut [f64; MAX_PADDED],
    ) -> f64 {
        let mut total = [0.0; P];
        let mut greatest = [0.0_f64; LANES];
        for (block, rows) in self.lambda.chunks_exact(LANES * P).enumerate() {
            let kernel = self.kernel(block, query);
            for (greatest, k) in greatest.iter_mut().zip(kernel) {
                *greatest = greatest.max(k);
            }
            for (row, k) in rows.chunks_exact(P).zip(kernel) {
                for (sum, lambda) in total.iter_mut().zip(row) {
                    *sum += k * lambda;
                }
            }
        }
        sums[..P].copy_from_slice(&total);
        greatest.into_iter().fold(0.0, f64::max)
    }
}
