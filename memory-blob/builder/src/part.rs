//! Parts of a build: each is made by itself, by any process on any machine.

use std::fmt;
use std::ops::Range;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

/// Most parts of a build.
pub const MAX_PARTS: u32 = 100_000;

/// Part `index` of `count`, written `I/N` with I from 0 to N - 1: as Slurm's array tasks of
/// `--array=0-N-1` and the pods of an Indexed Job count.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Part {
    index: u32,
    count: u32,
}

/// The whole, which is part 0 of 1.
impl Default for Part {
    fn default() -> Self {
        Self { index: 0, count: 1 }
    }
}

impl Part {
    /// Number of this part, 0 to [`Part::count`] - 1.
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

    /// The stream of random numbers of one of this part's batches: of one seed, no two parts share
    /// a stream, and the whole has those of part 0.
    pub(crate) fn stream(&self, batch: u64) -> u64 {
        (u64::from(self.index) << 40) + batch + 1
    }
}

impl fmt::Display for Part {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.index, self.count)
    }
}

impl FromStr for Part {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let pair = text.split_once('/');
        let pair = pair.and_then(|(i, n)| Some((i.parse().ok()?, n.parse().ok()?)));
        match pair {
            Some((index, count)) if index < count && count <= MAX_PARTS => {
                Ok(Self { index, count })
            }
            _ => Err(format!(
                "`{text}`; allowed: I/N with I from 0 to N - 1, and N from 1 to {MAX_PARTS}"
            )),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn part(text: &str) -> Part {
        text.parse().unwrap()
    }

    #[test]
    fn parts_cover_everything_once_and_as_evenly_as_possible() {
        for (total, count) in [(900, 4), (10, 4), (7, 7), (5, 8), (1_000_000, 999)] {
            let parts: Vec<_> = (0..count)
                .map(|index| Part { index, count }.range(total))
                .collect();
            assert_eq!((parts[0].start, parts[parts.len() - 1].end), (0, total));
            assert!(parts.windows(2).all(|pair| pair[0].end == pair[1].start));
            let least = parts.iter().map(|range| range.len()).min().unwrap();
            assert!(parts.iter().all(|range| range.len() - least <= 1));
        }
    }

    #[test]
    fn a_part_reads_as_it_is_written_and_nothing_else_is_one() {
        assert_eq!(part("3/4").to_string(), "3/4");
        for text in ["4/4", "0/0", "1", "-1/4", "a/4", "0/100001", "1/2/3", ""] {
            let refused = text.parse::<Part>().unwrap_err();
            assert!(refused.contains("allowed: I/N"), "{refused}");
        }
    }

    #[test]
    fn no_two_batches_of_any_parts_share_random_numbers() {
        let mut streams: Vec<u64> = (0..100)
            .flat_map(|index| (0..100).map(move |batch| (index, batch)))
            .map(|(index, batch)| Part { index, count: 100 }.stream(batch))
            .collect();
        streams.sort_unstable();
        streams.dedup();
        assert_eq!(streams.len(), 100 * 100);
        // The streams of the last part end below those that a 64-bit number can hold.
        let last = Part {
            index: MAX_PARTS - 1,
            count: MAX_PARTS,
        };
        assert!(last.stream((1 << 40) - 2) > last.stream(0));
        assert_eq!(Part::default().stream(5), 6);
    }
}
