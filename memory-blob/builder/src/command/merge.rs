//! `vpc-memory merge`.

use std::path::PathBuf;
use std::time::Instant;

use anyhow::bail;
use clap::Args;
use memory_blob::{Report, is_among};
use memory_builder::merge::Parts;

use super::build::set_threads;
use crate::open;

#[derive(Args)]
pub struct Merge {
    /// The parts, in any order: all of them, each once.
    #[arg(required = true)]
    parts: Vec<PathBuf>,
    /// The memory to write.
    #[arg(short, long)]
    output: PathBuf,
    /// Threads; all cores by default.
    #[arg(long)]
    threads: Option<usize>,
}

impl Merge {
    /// Merges, and says what came out.
    ///
    /// # Errors
    /// Names the file, what is wrong with it, and what is expected.
    pub fn run(&self) -> anyhow::Result<String> {
        if is_among(&self.output, &self.parts) {
            bail!(
                "--output {}: allowed: a file that is no part",
                self.output.display()
            );
        }
        set_threads(self.threads)?;
        let clock = Instant::now();
        let merged = Parts::of(&self.parts)?.merge()?;
        merged.contents.write(&self.output)?;
        let took = clock.elapsed();
        let file = open(&self.output, Some(&merged.scene.scene))?;
        let (found, tried) = merged.trajectories;
        Ok(format!(
            "{}: {} bytes; {found} trajectories of {tried} starts, {} parts merged in {:.1} s\n{}",
            self.output.display(),
            file.size(),
            self.parts.len(),
            took.as_secs_f64(),
            Report::of(&file),
        ))
    }
}
