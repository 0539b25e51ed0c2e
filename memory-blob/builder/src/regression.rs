//! Gaussian-process regression, the off-line half: hyper-parameters and weights from samples.
//!
//! One process for all outputs: they share the kernel and the Cholesky factor, so that p outputs
//! cost little more than one. The on-line half (a query) is in `memory-blob`.
//!
//! | Symbol | Here | Meaning |
//! |---|---|---|
//! | D, n, p | rows of `inputs`, their length, length of `outputs` | samples, inputs, outputs |
//! | X, Y | `inputs`, `outputs` | D x n (scaled by the caller), D x p |
//! | m | `mean` | constant mean of each output, (0, s*) in the paper |
//! | l_i | [`Kernel::length_scales`] | length scale of input i; Phi = diag(1 / l_i^2) |
//! | phi_o^2 | [`Kernel::signal_variance`] | variance of the function, in squared output scales |
//! | phi_s | [`Kernel::noise_variance`] | variance of the noise, in squared output scales |
//! | Lambda | [`Fit::lambda`] | (K + phi_s I)^-1 (Y - m), D x p, in units of the outputs |
//!
//! k(x, x') = phi_o^2 exp(-1/2 sum_i ((x_i - x'_i) / l_i)^2), and a query is y = m + k(x, X)
//! Lambda. Source: the paper, Sect. IV-C, where Lambda carries one factor K(x, X) too many.
//!
//! The hyper-parameters maximise the log marginal likelihood summed over the outputs
//! ([`likelihood`]), each output first divided by its scale so that px and m/s
//! weigh alike, on a seeded subset of the samples, from several seeded starts. An output that never
//! varies says nothing about the kernel and is left out of the likelihood; it still gets its column
//! of Lambda.
//!
//! All linear algebra runs sequentially inside one start, and the best start is chosen by value and
//! then by order, so the result does not depend on the number of threads. It may differ in the last
//! bits between processors with different vector units.

mod fit;
mod inputs;
mod kernel;
pub mod likelihood;
mod search;
mod settings;

pub use fit::{Fit, fit};
pub use kernel::Kernel;
pub use likelihood::NotPositiveDefinite;
pub use settings::{FitSettings, HyperBounds};

/// Mean and standard deviation.
fn moments(values: impl Iterator<Item = f64> + Clone) -> (f64, f64) {
    let count = values.clone().count() as f64;
    let mean = values.clone().sum::<f64>() / count;
    (
        mean,
        (values.map(|v| (v - mean).powi(2)).sum::<f64>() / count).sqrt(),
    )
}

#[cfg(test)]
mod tests;
