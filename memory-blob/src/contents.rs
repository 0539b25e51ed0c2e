//! What a writer fills in.

use serde_json::{Map, Value};

mod check;

/// A memory as its maker knows it: rows in their own order, raw units.
#[derive(Clone, Debug, PartialEq)]
pub struct Contents {
    /// Fingerprint of the task that the memory was built for.
    pub task: [u8; 32],
    /// Per input: what is subtracted before scaling.
    pub offset: Vec<f64>,
    /// Per input: what it is divided by, above zero.
    pub scale: Vec<f64>,
    /// Inputs x = (s, area, angle), one row a sample.
    pub x: Vec<Vec<f64>>,
    /// Outputs y = (v, way point), one row a sample.
    pub y: Vec<Vec<f64>>,
    /// Index of the trajectory of each sample.
    pub trajectory: Vec<u32>,
    /// Control period of each sample in its trajectory.
    pub step: Vec<u32>,
    /// Cost of the rest of its trajectory from each sample on, at least zero.
    pub cost_to_go: Vec<f64>,
    /// The Gaussian process.
    pub regression: Option<Regression>,
    /// Where the memory comes from: seed, counts, settings, date, tool.
    pub provenance: Map<String, Value>,
}

/// A fitted Gaussian process, y = m + k(x, X) Lambda, with k(x, x') = signal_variance exp(-1/2 sum
/// ((x-x')/l)^2) on scaled inputs.
#[derive(Clone, Debug, PartialEq)]
pub struct Regression {
    /// Raw inputs that the process is conditioned on, one row each.
    pub x: Vec<Vec<f64>>,
    /// One length scale an input, in scaled units, above zero.
    pub length_scale: Vec<f64>,
    /// phi_o^2, in squared output scales.
    pub signal_variance: f64,
    /// phi_s, in squared output scales.
    pub noise_variance: f64,
    /// m, one value an output, in its units.
    pub mean: Vec<f64>,
    /// (K + phi_s I)^{-1} (Y - m), one row for each row of `x`.
    pub lambda: Vec<Vec<f64>>,
    /// What each output less its mean was divided by where the kernel's variances were chosen, in
    /// its units, above zero: the scales of variances.
    pub output_scale: Vec<f64>,
    /// Packed lower rows of the Cholesky factor of K + phi_s I, for variances.
    pub cholesky: Option<Vec<f64>>,
}

/// Why a memory was not written.
#[derive(Debug, thiserror::Error)]
pub enum WriteError {
    /// The contents contradict themselves.
    #[error("memory: {what} is {found}; allowed: {allowed}")]
    Contents {
        /// Which part.
        what: &'static str,
        /// What was found.
        found: String,
        /// What is allowed.
        allowed: String,
    },
    /// The file could not be written.
    #[error("{path}: cannot write the memory: {source}")]
    Write {
        /// Path of the file, as given.
        path: String,
        /// The operating system's reason.
        r#source: std::io::Error,
    },
}
