//! Shares of a job, such as the trajectories of a memory or the runs from many starts: each is made
//! by itself, by any process on any machine.

use std::fmt;
use std::ops::Range;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

/// Most parts of a job.
const MAX_SHARES: u32 = 100_000;

/// Share `index` of `count`, written `I/N` with I from 0 to N - 1: as Slurm's array tasks of
/// `--array=0-N-1` and the pods of an Indexed Job count.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Share {
    index: u32,
    count: u32,
}

/// The whole, which is part 0 of 1.
impl Default for Share {
    fn default() -> Self {
        Self { index: 0, count: 1 }
    }
}

impl Share {
    /// Number of this part, 0 to [`Share::count`] - 1.
    pub fn index(&self) -> u32 {
        self.index
    }

    /// Number of parts.
    pub fn count(&self) -> u32 {
        self.count
    }

    /// What this part has of `total` things in a row. The parts cover them in order, and their
    /// lengths differ by 1 at most.
    pub fn range(&self, total: usize) -> Range<usize> {
        let bound =
            |index: u32| (total as u128 * u128::from(index) / u128::from(self.count)) as usize;
        bound(self.index)..bound(self.index + 1)
    }
}

impl fmt::Display for Share {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.index, self.count)
    }
}

impl FromStr for Share {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let pair = text.split_once('/');
        let pair = pair.and_then(|(i, n)| Some((i.parse().ok()?, n.parse().ok()?)));
        match pair {
            Some((index, count)) if index < count && count <= MAX_SHARES => {
                Ok(Self { index, count })
            }
            _ => Err(format!(
                "`{text}`; allowed: I/N with I from 0 to N - 1, and N from 1 to {MAX_SHARES}"
            )),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn share(text: &str) -> Share {
        text.parse().unwrap()
    }

    #[test]
    fn parts_cover_everything_once_and_as_evenly_as_possible() {
        for (total, count) in [(900, 4), (10, 4), (7, 7), (5, 8), (1_000_000, 999)] {
            let parts: Vec<_> = (0..count)
                .map(|index| Share { index, count }.range(total))
                .collect();
            assert_eq!((parts[0].start, parts[parts.len() - 1].end), (0, total));
            assert!(parts.windows(2).all(|pair| pair[0].end == pair[1].start));
            let least = parts.iter().map(|range| range.len()).min().unwrap();
            assert!(parts.iter().all(|range| range.len() - least <= 1));
        }
    }

    #[test]
    fn a_part_reads_as_it_is_written_and_nothing_else_is_one() {
        assert_eq!(share("3/4").to_string(), "3/4");
        for text in ["4/4", "0/0", "1", "-1/4", "a/4", "0/100001", "1/2/3", ""] {
            let refused = text.parse::<Share>().unwrap_err();
            assert!(refused.contains("allowed: I/N"), "{refused}");
        }
    }
}
