//! Parts of a job, such as the trajectories of a memory or the runs from many starts: each is made
//! by itself, by any process on any machine.

use std::fmt;
use std::ops::Range;
use std::path::Path;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

/// Most parts of a job.
const MAX_SHARES: u32 = 100_000;

/// Missing parts that a message names.
const NAMED: usize = 10;

/// Part `index` of `count`, written `I/N` with I from 0 to N - 1: as Slurm's array tasks of
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

/// Why parts do not make the whole.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum NotWhole {
    /// One is of another number of parts than the first.
    #[error("{path}: number of parts is {found}; expected: {expected}")]
    Count {
        /// Its file.
        path: String,
        /// Its number of parts.
        found: u32,
        /// That of the first.
        expected: u32,
    },
    /// One is there twice.
    #[error("{path}: part {part} is there twice, also as {other}; expected: each part once")]
    Twice {
        /// The file.
        path: String,
        /// Which part.
        part: Share,
        /// The other file.
        other: String,
    },
    /// Some are missing.
    #[error("{found} of {count} parts; expected: all; missing: {missing}")]
    Missing {
        /// Parts that are there.
        found: usize,
        /// All parts.
        count: u32,
        /// Indices of the missing ones.
        missing: String,
    },
}

impl Share {
    /// Checks that parts, with their files, are all there, each once.
    ///
    /// # Errors
    /// [`NotWhole`].
    pub fn check_whole<'a>(
        parts: impl IntoIterator<Item = (&'a Path, Self)>,
    ) -> Result<(), NotWhole> {
        let mut parts: Vec<(&Path, Self)> = parts.into_iter().collect();
        let count = parts.first().map_or(1, |(_, part)| part.count);
        let name = |path: &Path| path.display().to_string();
        if let Some((path, part)) = parts.iter().find(|(_, part)| part.count != count) {
            return Err(NotWhole::Count {
                path: name(path),
                found: part.count,
                expected: count,
            });
        }
        parts.sort_by_key(|(_, part)| part.index);
        let twice = parts.windows(2).find(|pair| pair[0].1 == pair[1].1);
        if let Some([(other, _), (path, part)]) = twice {
            return Err(NotWhole::Twice {
                path: name(path),
                part: *part,
                other: name(other),
            });
        }
        let is_there = |index: &u32| parts.binary_search_by_key(index, |(_, part)| part.index);
        let missing = (0..count).filter(|index| is_there(index).is_err());
        let mut names: Vec<_> = missing.map(|index| index.to_string()).collect();
        if names.is_empty() {
            return Ok(());
        }
        let more = names.len().saturating_sub(NAMED);
        names.truncate(NAMED);
        if more > 0 {
            names.push(format!("and {more} more"));
        }
        Err(NotWhole::Missing {
            found: parts.len(),
            count,
            missing: names.join(", "),
        })
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
    fn parts_are_whole_only_if_each_is_there_once() {
        let check = |parts: &[&str]| {
            let files = parts.iter().map(|text| (Path::new(*text), share(text)));
            Share::check_whole(files).map_err(|error| error.to_string())
        };
        assert_eq!(check(&["2/3", "0/3", "1/3"]), Ok(()));
        for (parts, words) in [
            (&[][..], "0 of 1 parts; expected: all; missing: 0"),
            (&["1/3"], "1 of 3 parts; expected: all; missing: 0, 2"),
            (
                &["5/40"],
                "missing: 0, 1, 2, 3, 4, 6, 7, 8, 9, 10, and 29 more",
            ),
            (
                &["0/2", "1/2", "0/2"],
                "0/2: part 0/2 is there twice, also as 0/2; expected: each",
            ),
            (&["0/2", "1/3"], "1/3: number of parts is 3; expected: 2"),
        ] {
            let message = check(parts).unwrap_err();
            assert!(message.contains(words), "{message}");
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
