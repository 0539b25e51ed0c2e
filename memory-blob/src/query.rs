//! Why a query was refused.

/// Why a query was refused.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[allow(missing_docs)] // the messages say it
pub enum QueryError {
    #[error("query input: {found} entries; allowed: the memory's {expected}")]
    InputLength { found: usize, expected: usize },
    /// The output or the scratch space has the wrong number of entries.
    #[error("query output: {found} entries; allowed: {expected}")]
    OutputLength { found: usize, expected: usize },
    #[error("query input: entry {index} is not finite; allowed: finite numbers")]
    NotFinite { index: usize },
    #[error("neighbours: {found}; allowed: 1 to {most}")]
    Neighbours { found: usize, most: usize },
    #[error("variance: the memory holds no Cholesky factor; build or fit it with `--variance`")]
    NoVariance,
}
