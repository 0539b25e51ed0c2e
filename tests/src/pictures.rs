//! Pictures of runs and memories.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use figures::{Comparison, ImagePlane, Joints, Samples, Velocity};
use hw_sim::recording::Record;
use hw_sim::robot::arm::joint_limits;
use memory_blob::MemoryFile;
use scene::Scene;
use vpc::Task;

use crate::robot::{Reason, RobotRun, approach};
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
        written.extend(
            samples(scene, task, memory)
                .canvas()
                .write(&directory.join("memory"))?,
        );
    }
    if let (Some((_, first)), Some((_, last))) = (all.first(), all.last()) {
        let telling = |i: &usize| !first[*i].success && last[*i].success;
        let start = (0..first.len()).find(telling).unwrap_or(0);
        let columns = all
            .iter()
            .filter_map(|(spec, runs)| Some((spec.to_string(), runs.get(start)?)));
        let comparison = comparison(scene, task, columns);
        written.extend(
            comparison
                .canvas()
                .write(&directory.join(format!("start-{start}")))?,
        );
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

/// Named runs of the robot side by side, until it lets the object go.
pub fn robot_comparison<'a, 'r>(
    scene: &'a Scene,
    task: &Task,
    runs: impl Iterator<Item = (String, &'r RobotRun)>,
) -> Comparison<'a> {
    let columns = runs.map(|(name, run)| {
        let steered = approach(&run.history);
        let outcome = match run.arrived_s {
            Some(seconds) if run.success => format!("arrived after {seconds:.1} s"),
            _ => {
                let why = run.reason.map_or("arm violation", Reason::name);
                format!("{why} after {:.1} s", run.time_s)
            }
        };
        let plane = ImagePlane {
            scene,
            path: steered
                .iter()
                .map(|sample| sample.features.clone())
                .collect(),
            goal: task.goal.to_vec(),
            way_points: steered
                .iter()
                .filter_map(|sample| sample.way_point.clone())
                .collect(),
            title: format!("{name}: {outcome}"),
        };
        let velocity = Velocity {
            period_s: task.ts,
            twists: steered.iter().map(|sample| sample.twist).collect(),
            limits: scene.limits,
            title: format!("{name}: velocity command"),
        };
        (plane, velocity)
    });
    Comparison {
        columns: columns.collect(),
    }
}

/// Draws, into `directory`, all strategies on one start: the one that was asked for, else the first that the first
/// strategy fails and the last one solves, else the first.
///
/// # Errors
/// Where a picture cannot be drawn or written.
pub fn of_robot_table(
    directory: &Path,
    scene: &Scene,
    task: &Task,
    specs: &[Spec],
    all: &[Vec<RobotRun>],
    only: Option<usize>,
) -> anyhow::Result<Vec<PathBuf>> {
    let (Some(first), Some(last)) = (all.first(), all.last()) else {
        return Ok(Vec::new());
    };
    let telling = |i: &usize| !first[*i].success && last[*i].success;
    let index = (0..first.len()).find(telling).unwrap_or(0);
    let columns = specs
        .iter()
        .zip(all)
        .filter_map(|(spec, runs)| Some((spec.to_string(), runs.get(index)?)));
    let start = only.unwrap_or(index);
    let written = robot_comparison(scene, task, columns)
        .canvas()
        .write(&directory.join(format!("robot-start-{start}")))?;
    Ok(written.to_vec())
}

/// The joints of a recorded arm with the steps of its task; none where no arm carried the camera.
pub fn joints(records: &[Record], title: &str) -> Option<Joints> {
    let begun = records.iter().filter(|record| record.time_s > 0.0);
    let samples: Vec<_> = begun
        .filter_map(|record| Some((record.time_s, record.arm.as_ref()?)))
        .collect();
    samples.first()?;
    let changes = samples
        .windows(2)
        .filter(|pair| pair[0].1.phase != pair[1].1.phase);
    Some(Joints {
        time_s: samples.iter().map(|(time, _)| *time).collect(),
        q: samples.iter().map(|(_, arm)| arm.q).collect(),
        dq: samples.iter().map(|(_, arm)| arm.dq).collect(),
        limits: joint_limits(),
        marks: changes
            .map(|pair| (pair[1].0, pair[1].1.phase.name().to_owned()))
            .collect(),
        title: title.to_owned(),
    })
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
