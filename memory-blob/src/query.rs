//! Why a query was refused.

use core::fmt;

/// Why a query was refused.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum QueryError {
    /// The input has the wrong number of entries.
    InputLength {
        /// Entries found.
        found: usize,
        /// Entries of the memory's inputs.
        expected: usize,
    },
    /// The output or the scratch space has the wrong number of entries.
    OutputLength {
        /// Entries found.
        found: usize,
        /// Entries needed.
        expected: usize,
    },
    /// An entry of the input is NaN or infinite.
    NotFinite {
        /// Index of the entry.
        index: usize,
    },
    /// The number of neighbours is out of range.
    Neighbours {
        /// Neighbours asked for.
        found: usize,
        /// Most that are allowed: 64, and not more than there are samples.
        most: usize,
    },
    /// The file holds no factor for variances.
    NoVariance,
}

impl core::error::Error for QueryError {}

impl fmt::Display for QueryError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::InputLength { found, expected } => {
                write!(
                    f,
                    "query input: {found} entries; allowed: the memory's {expected}"
                )
            }
            Self::OutputLength { found, expected } => {
                write!(f, "query output: {found} entries; allowed: {expected}")
            }
            Self::NotFinite { index } => {
                write!(
                    f,
                    "query input: entry {index} is not finite; allowed: finite numbers"
                )
            }
            Self::Neighbours { found, most } => {
                write!(f, "neighbours: {found}; allowed: 1 to {most}")
            }
            Self::NoVariance => f.write_str(
                "variance: the memory holds no Cholesky factor with output scales; build or fit it with `--variance`",
            ),
        }
    }
}
