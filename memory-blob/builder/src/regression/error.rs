//! What can be wrong with a regression.

/// Why a regression could not be fitted or evaluated.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum RegressionError {
    /// A matrix or a list has the wrong size.
    #[error("{name} has {found} {what}: {expected}")]
    Size {
        /// The matrix or list.
        name: &'static str,
        /// What was counted.
        what: &'static str,
        /// How many were found.
        found: usize,
        /// How many are needed.
        expected: String,
    },
    /// A value is not a number or infinite.
    #[error("{name} holds {value} at row {row}, column {column}: every value must be finite")]
    NotFinite {
        /// The matrix.
        name: &'static str,
        /// Row, from 0.
        row: usize,
        /// Column, from 0.
        column: usize,
        /// What was found.
        value: f64,
    },
    /// A setting is out of its range.
    #[error("regression setting {name} is {value}: it must be {allowed}")]
    Setting {
        /// Name of the field.
        name: &'static str,
        /// What was found.
        value: f64,
        /// What is allowed.
        allowed: &'static str,
    },
    /// The covariance has no Cholesky factor, even with the largest jitter.
    #[error(
        "the covariance of {samples} samples is not positive definite, even with a jitter of {jitter:e}: \
         raise the lower bound of the noise variance"
    )]
    NotPositiveDefinite {
        /// Number of samples.
        samples: usize,
        /// The largest jitter that was tried, in squared output scales.
        jitter: f64,
    },
}
