//! Pictures of runs and memories.

use std::collections::BTreeMap;
use std::fmt::Display;
use std::path::{Path, PathBuf};

use figures::{Animation, Comparison, ImagePlane, Joints, Points, Samples, Velocity};
use hw_sim::recording::Record;
use hw_sim::robot::arm::joint_limits;
use memory_blob::MemoryFile;
use scene::Scene;
use vpc::Task;

use crate::robot::{Reason, RobotRun, approach};
use crate::run::Run;

/// Trajectories shown of a memory; more hide each other.
const SHOWN_TRAJECTORIES: usize = 250;
/// Most frames of an animation; a long run is shown faster than it was.
const FRAMES: usize = 50;
/// Time from one frame of an animation to the next, and time that the last one stays, s.
const FRAME_S: (f64, f64) = (0.07, 2.0);

/// What is drawn of a run: features, way points, foreseen ways and twists, period by period.
#[derive(Clone, Debug)]
pub struct Drawn {
    /// Strategy and outcome.
    pub title: String,
    path: Vec<Points>,
    way_points: Vec<Option<Points>>,
    foreseen: Vec<Vec<Points>>,
    twists: Vec<[f64; 6]>,
}

/// A run that can be drawn.
pub trait Draw {
    /// Whether it arrived without a violation.
    fn is_success(&self) -> bool;
    /// What is drawn of it, by the name of its strategy.
    fn drawn(&self, name: &str, task: &Task) -> Drawn;
}

impl Draw for Run {
    fn is_success(&self) -> bool {
        self.success
    }

    fn drawn(&self, name: &str, task: &Task) -> Drawn {
        let outcome = if self.success { "arrived" } else { "failed" };
        let seconds = self.steps as f64 * task.ts;
        let title = format!("{name}: {outcome} after {seconds:.1} s");
        let history = self.history.iter();
        let drawn = Drawn::of(title, history.map(|m| (&m.features, &m.way_point, m.twist)));
        Drawn {
            foreseen: self.history.iter().map(|m| m.foreseen.clone()).collect(),
            ..drawn
        }
    }
}

impl Draw for RobotRun {
    fn is_success(&self) -> bool {
        self.success
    }

    /// Until the robot lets the object go.
    fn drawn(&self, name: &str, _: &Task) -> Drawn {
        let outcome = match self.arrived_s {
            Some(seconds) if self.success => format!("arrived after {seconds:.1} s"),
            _ => {
                let why = self.reason.map_or("arm violation", Reason::name);
                format!("{why} after {:.1} s", self.time_s)
            }
        };
        let title = format!("{name}: {outcome}");
        let history = approach(&self.history).iter();
        Drawn::of(title, history.map(|s| (&s.features, &s.way_point, s.twist)))
    }
}

impl Drawn {
    /// Of features, way point and twist, period by period.
    fn of<'a>(
        title: String,
        history: impl Iterator<Item = (&'a Points, &'a Option<Points>, [f64; 6])>,
    ) -> Self {
        let history =
            history.map(|(points, way_point, twist)| (points.clone(), (way_point.clone(), twist)));
        let (path, (way_points, twists)) = history.unzip();
        Self {
            title,
            path,
            way_points,
            foreseen: Vec::new(),
            twists,
        }
    }

    /// The image plane after so many periods.
    fn plane<'a>(&self, scene: &'a Scene, task: &Task, periods: usize) -> ImagePlane<'a> {
        let way_points = self.way_points.iter().take(periods);
        ImagePlane {
            scene,
            path: self.path.iter().take(periods).cloned().collect(),
            goal: task.goal.to_vec(),
            way_points: way_points.flatten().cloned().collect(),
            foreseen: Vec::new(),
            ellipses: Vec::new(),
            title: self.title.clone(),
        }
    }
}

/// Draws, into `directory`: the samples in the memory, and all strategies on one start: `only`,
/// else the first that the first strategy fails and the last one solves, else the first.
///
/// # Errors
/// If a picture cannot be drawn or written.
pub fn of_table<R: Draw>(
    directory: &Path,
    scene: &Scene,
    task: &Task,
    memory: Option<&MemoryFile>,
    all: &[(impl Display, Vec<R>)],
    only: Option<usize>,
) -> anyhow::Result<Vec<PathBuf>> {
    let mut written = Vec::new();
    if let Some(memory) = memory {
        let canvas = samples(scene, task, memory).canvas();
        written.extend(canvas.write(&directory.join("memory"))?);
    }
    if let (Some((_, first)), Some((_, last))) = (all.first(), all.last()) {
        let telling = |i: &usize| !first[*i].is_success() && last[*i].is_success();
        let index = (0..first.len()).find(telling).unwrap_or(0);
        let runs = all
            .iter()
            .filter_map(|(name, runs)| Some((name, runs.get(index)?)));
        let name = format!("start-{}", only.unwrap_or(index));
        let canvas = comparison(scene, task, runs).canvas();
        written.extend(canvas.write(&directory.join(name))?);
    }
    Ok(written)
}

/// Runs side by side.
pub fn comparison<'a, 'r, R: Draw + 'r>(
    scene: &'a Scene,
    task: &Task,
    runs: impl Iterator<Item = (impl Display, &'r R)>,
) -> Comparison<'a> {
    let columns = runs.map(|(name, run)| {
        let drawn = run.drawn(&name.to_string(), task);
        let velocity = Velocity {
            period_s: task.ts,
            twists: drawn.twists.clone(),
            own: Vec::new(),
            limits: scene.limits,
            periods: 0,
            title: format!("{name}: velocity command"),
        };
        (drawn.plane(scene, task, usize::MAX), velocity)
    });
    Comparison {
        columns: columns.collect(),
    }
}

/// Runs side by side as they go on, with the way that is foreseen from there, until the last of
/// those that arrive has arrived.
pub fn animation<R: Draw>(scene: &Scene, task: &Task, runs: &[&(String, R)]) -> Animation {
    let length = |drawn: &Drawn| drawn.path.len();
    let drawn: Vec<(bool, Drawn)> = runs
        .iter()
        .map(|(name, run)| (run.is_success(), run.drawn(name, task)))
        .collect();
    let arrived = drawn.iter().filter(|(is_success, _)| *is_success);
    let longest = arrived.map(|(_, drawn)| length(drawn)).max();
    let periods = longest.or(drawn.iter().map(|(_, drawn)| length(drawn)).min());
    let periods = periods.unwrap_or(0);
    let frame = |periods: usize| {
        let planes = drawn.iter().map(|(is_success, drawn)| {
            let mut plane = drawn.plane(scene, task, periods);
            let has_ended = *is_success && periods >= length(drawn);
            if !has_ended {
                let foreseen = drawn.foreseen.get(periods - 1);
                plane.foreseen = foreseen.cloned().unwrap_or_default();
                let name = drawn.title.split(':').next().unwrap_or_default();
                plane.title = format!("{name}: {:.1} s", periods as f64 * task.ts);
            }
            plane
        });
        figures::side_by_side(planes.map(|plane| plane.canvas()))
    };
    let mut frames: Vec<_> = (1..=periods)
        .step_by(periods.div_ceil(FRAMES).max(1))
        .map(frame)
        .collect();
    frames.push(frame(periods));
    Animation {
        frames,
        period_s: FRAME_S.0,
        last_s: FRAME_S.1,
    }
}

/// The joints of a recorded arm with the steps of its task; none if no arm carried the camera.
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
        limits: joint_limits().to_vec(),
        margin: 0.0,
        bound: Vec::new(),
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
