//! Pictures of runs and memories.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use figures::{Comparison, ImagePlane, Samples, Velocity};
use memory_blob::MemoryFile;
use scene::Scene;
use vpc::Task;

use crate::run::Run;
use crate::spec::Spec;

/// Trajectories shown of a memory; more hide each other.
const SHOWN_TRAJECTORIES: usize = 250;

/// Draws, into `directory`: the samples in the memory, and the comparison of all strategies on one start: the first
/// that the first strategy fails and the last one solves, else the first.
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
    let mut written = Vec::new();
    if let Some(memory) = memory {
        written.extend(samples(scene, task, memory).write(&directory.join("memory"))?);
    }
    if let (Some((_, first)), Some((_, last))) = (all.first(), all.last()) {
        let telling = |i: &usize| !first[*i].success && last[*i].success;
        let start = (0..first.len()).find(telling).unwrap_or(0);
        let columns = all
            .iter()
            .filter_map(|(spec, runs)| Some((spec.to_string(), runs.get(start)?)));
        let comparison = comparison(scene, task, columns);
        written.extend(comparison.write(&directory.join(format!("start-{start}")))?);
    }
    Ok(written)
}

/// Named runs side by side.
pub fn comparison<'a, 'r>(
    scene: &'a Scene,
    task: &Task,
    runs: impl Iterator<Item = (String, &'r Run)>,
) -> Comparison<'a> {
    let columns = runs.map(|(name, run)| {
        let outcome = if run.success { "arrived" } else { "failed" };
        let title = format!(
            "{name}: {outcome} after {:.1} s",
            run.steps as f64 * task.ts
        );
        let plane = ImagePlane {
            scene,
            path: run
                .history
                .iter()
                .map(|moment| moment.features.clone())
                .collect(),
            goal: task.goal.to_vec(),
            way_points: run
                .history
                .iter()
                .filter_map(|moment| moment.way_point.clone())
                .collect(),
            title,
        };
        let velocity = Velocity {
            period_s: task.ts,
            twists: run.history.iter().map(|moment| moment.twist).collect(),
            limits: scene.limits,
            title: format!("{name}: velocity command"),
        };
        (plane, velocity)
    });
    Comparison {
        columns: columns.collect(),
    }
}

/// The samples in a memory.
pub fn samples<'a>(scene: &'a Scene, task: &Task, memory: &MemoryFile) -> Samples<'a> {
    let contents = memory.contents();
    let mut trajectories: BTreeMap<u32, Vec<Vec<[f64; 2]>>> = BTreeMap::new();
    for (x, index) in contents.x.iter().zip(&contents.trajectory) {
        let points = x[..2 * task.goal.len()]
            .chunks_exact(2)
            .map(|p| [p[0], p[1]])
            .collect();
        trajectories.entry(*index).or_default().push(points);
    }
    let count = trajectories.len();
    let every = count.div_ceil(SHOWN_TRAJECTORIES).max(1);
    Samples {
        scene,
        trajectories: trajectories.into_values().step_by(every).collect(),
        goal: task.goal.to_vec(),
        title: format!(
            "{} of {count} trajectories in the memory",
            count.div_ceil(every)
        ),
    }
}
