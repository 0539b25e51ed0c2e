//! Strategies: their words, and what each asks of the memory.

#[cfg(feature = "file")]
use alloc::{
    string::{String, ToString},
    vec::Vec,
};
use core::fmt;
use core::str::FromStr;

pub use memory_blob::MAX_NEIGHBOURS;
use memory_blob::Memory;
use serde::{Deserialize, Serialize};

/// Displays the words of every strategy, for messages.
#[derive(Clone, Copy, Debug)]
pub struct Allowed;

impl fmt::Display for Allowed {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (index, strategy) in Strategy::ALL.into_iter().enumerate() {
            f.write_str(if index == 0 { "" } else { ", " })?;
            f.write_str(strategy.word())?;
            if let Strategy::Knn { .. } = strategy {
                write!(f, ", knn2 to knn{MAX_NEIGHBOURS}")?;
            }
        }
        Ok(())
    }
}

/// Every word that is a strategy.
#[cfg(feature = "file")]
pub(crate) fn words() -> Vec<String> {
    let averaged = (2..=MAX_NEIGHBOURS).map(|k| Strategy::Knn { k });
    let strategies = Strategy::ALL.into_iter().chain(averaged);
    strategies.map(|strategy| strategy.to_string()).collect()
}

/// A strategy as its word, in a configuration file.
#[cfg(feature = "file")]
pub(crate) mod word {
    use alloc::string::String;

    use serde::Deserialize;

    use crate::strategy::Strategy;

    pub fn serialize<S: serde::Serializer>(strategy: &Strategy, to: S) -> Result<S::Ok, S::Error> {
        to.collect_str(strategy)
    }

    pub fn deserialize<'d, D: serde::Deserializer<'d>>(from: D) -> Result<Strategy, D::Error> {
        let word = String::deserialize(from)?;
        word.parse().map_err(serde::de::Error::custom)
    }
}

/// Where warm start and target come from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Strategy {
    /// Warm start from the previous cycle's solution, target is the goal (the paper's "prev.-it.").
    Previous,
    /// Near a constraint, warm start and way point from the mean of the `k` nearest samples of the
    /// memory.
    Knn {
        /// Neighbours averaged, 1 to [`MAX_NEIGHBOURS`].
        k: usize,
    },
    /// Near a constraint, warm start and way point from Gaussian-process regression.
    Gpr,
    /// Classic image-based visual servoing; no prediction, no constraints but the velocity limits.
    Ibvs,
    /// Whole futures are simulated, and the best one is followed.
    Foresight,
    /// The nearest allowed twist to the one that another program wants.
    Follow,
}

/// Below this correlation with every sample the Gaussian process knows nothing: the variance that
/// is left is 99 % of what it was before any sample.
const LEAST_CORRELATION: f64 = 0.1;

impl Strategy {
    /// Every strategy, k-NN with one neighbour.
    pub const ALL: [Self; 6] = [
        Self::Previous,
        Self::Knn { k: 1 },
        Self::Gpr,
        Self::Ibvs,
        Self::Foresight,
        Self::Follow,
    ];

    /// Its word, without a number of neighbours.
    pub fn word(self) -> &'static str {
        match self {
            Self::Previous => "previous",
            Self::Knn { .. } => "knn",
            Self::Gpr => "gpr",
            Self::Ibvs => "ibvs",
            Self::Foresight => "foresight",
            Self::Follow => "follow",
        }
    }

    /// Neighbours averaged by k-NN; 0 for other strategies.
    pub fn neighbours(self) -> usize {
        match self {
            Self::Knn { k } => k,
            Self::Previous | Self::Gpr | Self::Ibvs | Self::Foresight | Self::Follow => 0,
        }
    }

    /// The same with `neighbours`, which must be 0 where the strategy is not k-NN.
    pub fn averaging(self, neighbours: usize) -> Option<Self> {
        match (self, neighbours) {
            (Self::Knn { .. }, 1..=MAX_NEIGHBOURS) => Some(Self::Knn { k: neighbours }),
            (Self::Knn { .. }, _) => None,
            (_, 0) => Some(self),
            _ => None,
        }
    }

    /// Whether the strategy cannot do without a memory.
    pub fn needs_memory(self) -> bool {
        matches!(self, Self::Knn { .. } | Self::Gpr)
    }

    /// Whether the strategy asks a memory where there is one.
    pub fn uses_memory(self) -> bool {
        self.needs_memory() || self == Self::Foresight
    }

    /// Asks a memory: writes y = (v, way point) for x = (s, area, angle); `false` where it has no
    /// answer, or knows nothing.
    pub(crate) fn infer(self, memory: &Memory<'_>, input: &[f64], output: &mut [f64]) -> bool {
        match self {
            Self::Knn { k } => memory.samples().nearest(input, k, output).is_ok(),
            Self::Gpr => {
                let correlation = memory.gpr().map(|gpr| gpr.mean(input, output));
                matches!(correlation, Some(Ok(correlation)) if correlation >= LEAST_CORRELATION)
            }
            Self::Previous | Self::Ibvs | Self::Foresight | Self::Follow => false,
        }
    }
}

impl fmt::Display for Strategy {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.word())?;
        match self.neighbours() {
            0 | 1 => Ok(()),
            k => write!(f, "{k}"),
        }
    }
}

/// The name of no strategy.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("allowed: {Allowed}")]
pub struct UnknownStrategy;

impl FromStr for Strategy {
    type Err = UnknownStrategy;

    fn from_str(text: &str) -> Result<Self, UnknownStrategy> {
        let named = |word: &str| {
            Self::ALL
                .into_iter()
                .find(|strategy| strategy.word() == word)
        };
        let word = text.trim_end_matches(|c: char| c.is_ascii_digit());
        let strategy = match text.strip_prefix(word) {
            None | Some("") => named(text),
            Some(digits) => named(word)
                .zip(digits.parse().ok())
                .and_then(|(strategy, k)| strategy.averaging(k).filter(|_| k > 0)),
        };
        strategy.ok_or(UnknownStrategy)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_go_both_ways() {
        for name in ["previous", "knn", "knn5", "knn64", "gpr", "ibvs"] {
            assert_eq!(name.parse::<Strategy>().unwrap().to_string(), name);
        }
        for name in ["", "5", "knn0", "knn65", "knnx", "gpr0", "gpr5", "GPR"] {
            assert!(name.parse::<Strategy>().is_err(), "{name}");
        }
        assert_eq!(
            Allowed.to_string(),
            "previous, knn, knn2 to knn64, gpr, ibvs, foresight, follow"
        );
    }
}
