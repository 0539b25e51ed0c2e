//! Where starts and memories come from: a file, or `vpc-memory` with a seed.

use std::convert::Infallible;
use std::fmt;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Stdio;
use std::str::FromStr;

use anyhow::{Context, bail};

use crate::children::Children;

/// Where starts or a memory come from.
#[derive(Clone, Debug, PartialEq)]
pub enum Source {
    /// A file.
    File(PathBuf),
    /// Made by `vpc-memory`: starts, or trajectories.
    Made {
        /// How many.
        count: u32,
        /// Of the random numbers.
        seed: u64,
    },
}

impl FromStr for Source {
    type Err = Infallible;

    fn from_str(text: &str) -> Result<Self, Infallible> {
        let made = text.split_once('@').and_then(|(count, seed)| {
            Some(Self::Made {
                count: count.parse().ok()?,
                seed: seed.parse().ok()?,
            })
        });
        Ok(made.unwrap_or_else(|| Self::File(text.into())))
    }
}

impl fmt::Display for Source {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::File(path) => path.display().fmt(f),
            Self::Made { count, seed } => write!(f, "{count}@{seed}"),
        }
    }
}

/// What `vpc-memory` makes.
#[derive(Clone, Copy, Debug)]
pub enum Product {
    /// A file of starts.
    Starts,
    /// A memory of motion.
    Memory,
}

impl Source {
    /// The file; one that is to be made is made for a scene, in a directory.
    ///
    /// # Errors
    /// `vpc-memory` cannot be built or started, or fails.
    pub fn file(
        &self,
        children: &Children,
        scene: &Path,
        product: Product,
        directory: &Path,
    ) -> anyhow::Result<PathBuf> {
        let (count, seed) = match self {
            Self::File(path) => return Ok(path.clone()),
            Self::Made { count, seed } => (count.to_string(), seed.to_string()),
        };
        let (command, number, noun) = match product {
            Product::Starts => ("starts", "--count", "starts"),
            Product::Memory => ("build", "--trajectories", "trajectories"),
        };
        let programs = children.build(&["vpc-memory"])?;
        fs::create_dir_all(directory).with_context(|| directory.display().to_string())?;
        let path = directory.join(command);
        let mut maker = testkit::command(programs.join("vpc-memory"));
        maker.arg(command).arg(scene).arg("-o").arg(&path);
        maker.args([number, &count, "--seed", &seed]);
        eprintln!("vpc-memory {command}: {count} {noun} by seed {seed}");
        // Standard output is the caller's.
        maker.stdout(Stdio::piped());
        let (status, said) = children.start("vpc-memory", maker)?.output()?;
        if !status.success() {
            bail!("vpc-memory {command} made nothing: {said}");
        }
        Ok(path)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn starts_and_memories_are_files_or_made_by_a_seed() {
        let source = |text: &str| text.parse::<Source>().unwrap();
        assert_eq!(source("50@3"), Source::Made { count: 50, seed: 3 });
        for file in ["starts.csv", "me@home/5.csv", "50@", "@3", "50"] {
            assert_eq!(source(file), Source::File(file.into()));
        }
    }
}
