//! The memory while it grows: samples (x, y) of the successful trajectories, asked by k-NN.

use serde::{Deserialize, Serialize};
use vpc::features::{self, MAX_INPUTS, largest_distance};
use vpc::prediction::{InitialState, Radii};
use vpc::{MotionMemory, Points, Strategy, Task, Twist, cost};

use crate::settings::{BuildSettings, WayPoint};
use crate::sight;

/// Distance between the places at which a straight line is checked, px.
const CHECK_EVERY_PX: f64 = 3.0;
/// Way points are at least this far along the trajectory, share of the image width: nearer ones lie
/// in the neighbourhood of the same sample, and the features would come to rest there.
const LEAST_AHEAD: f64 = 0.05;
/// A straight line may cut this deep into an occlusion, share of the image width: the controller
/// slides round such a corner by itself.
const SLIDE: f64 = 0.015;

/// A successful trajectory: features and commands, one a control period.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Trajectory {
    /// Features before each command, and at last those at the goal, px.
    pub features: Vec<Vec<[f64; 2]>>,
    /// Commands; one fewer than features.
    pub twists: Vec<Twist>,
}

/// Samples of a memory, row by row.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Store {
    /// x = (s, area, angle), raw.
    pub inputs: Vec<Vec<f64>>,
    /// y = (v, way point), raw.
    pub outputs: Vec<Vec<f64>>,
    /// Index of the trajectory of each sample.
    pub trajectory: Vec<usize>,
    /// Index of the control period of each sample in its trajectory.
    pub step: Vec<usize>,
    /// Cost of the rest of its trajectory from each sample on.
    pub cost_to_go: Vec<f64>,
    /// Per input: what it is divided by before distances are taken.
    scale: Vec<f64>,
    trajectories: usize,
}

impl Store {
    /// An empty store for a task.
    pub fn new(task: &Task) -> Self {
        Self {
            scale: input_scale(task),
            ..Self::default()
        }
    }

    /// Trajectories stored.
    pub fn trajectories(&self) -> usize {
        self.trajectories
    }

    /// Per input: what it is divided by before Euclidean distances are taken.
    pub fn scale(&self) -> &[f64] {
        &self.scale
    }

    /// Stores the samples of a trajectory, each at least the settings' spacing from the one before.
    pub fn add(&mut self, task: &Task, settings: &BuildSettings, trajectory: &Trajectory) {
        let spacing = settings.sample_spacing * task.camera.width;
        let costs = costs_to_go(task, trajectory);
        let radii: Vec<Radii> = trajectory.features.iter().map(|s| radii(task, s)).collect();
        let mut last: Option<&[[f64; 2]]> = None;
        for (j, twist) in trajectory.twists.iter().enumerate() {
            let points = &trajectory.features[j];
            if last.is_some_and(|last| largest_distance(last, points) < spacing) {
                continue;
            }
            last = Some(points);
            let way_point = way_point(task, settings.way_point, trajectory, &radii, j);
            let pixels = way_point.iter().flatten().copied();
            let features: Points = points.iter().copied().collect();
            self.inputs.push(task.recall_input(&features).to_vec());
            self.outputs
                .push(twist.iter().copied().chain(pixels).collect());
            self.trajectory.push(self.trajectories);
            self.step.push(j);
            self.cost_to_go.push(costs[j]);
        }
        self.trajectories += 1;
    }

    fn distance(&self, a: &[f64], b: &[f64]) -> f64 {
        a.iter()
            .zip(b)
            .zip(&self.scale)
            .map(|((a, b), s)| ((a - b) / s) * ((a - b) / s))
            .sum()
    }
}

/// The cost of the rest of a trajectory from each of its control periods on: the sum of k_Q |s -
/// s*|^2 + r v' R v.
fn costs_to_go(task: &Task, trajectory: &Trajectory) -> Vec<f64> {
    let periods = trajectory.features.iter().zip(&trajectory.twists);
    let mut costs: Vec<f64> = periods
        .map(|(points, twist)| {
            let distance = features::rms_distance(points, &task.goal);
            let weighted = task.cost.r.iter().zip(twist).map(|(r, v)| r * v * v);
            let effort = cost::r_share(task, points, &task.goal) * weighted.sum::<f64>();
            task.cost.k_q * distance * distance * points.len() as f64 + effort
        })
        .collect();
    for j in (1..costs.len()).rev() {
        costs[j - 1] += costs[j];
    }
    costs
}

/// The way point of sample `j` of a trajectory.
///
/// Source: paper, Sect. IV.A; the rule by distance replaces the rule by samples, which makes slow
/// stretches crawl.
fn way_point(
    task: &Task,
    rule: WayPoint,
    trajectory: &Trajectory,
    radii: &[Radii],
    j: usize,
) -> Vec<[f64; 2]> {
    let ahead = match rule {
        WayPoint::Samples(count) => trajectory.features.get(j + count),
        WayPoint::Sight(share) => {
            return in_sight(task, share * task.camera.width, trajectory, radii, j);
        }
    };
    ahead.map_or_else(|| task.goal.to_vec(), Clone::clone)
}

/// The last features ahead, no further than `far` px along the trajectory, that every point can
/// reach on a straight line without being stopped by an occlusion; the goal itself where the
/// trajectory's end is in sight. A sub-goal behind an occlusion would leave the controller stuck in
/// front of it.
fn in_sight(
    task: &Task,
    far: f64,
    trajectory: &Trajectory,
    radii: &[Radii],
    j: usize,
) -> Vec<[f64; 2]> {
    let here = &trajectory.features[j];
    let last = trajectory.features.len() - 1;
    let least = LEAST_AHEAD * task.camera.width;
    let (mut seen, mut travelled) = (j, 0.0);
    for (there, pair) in trajectory.features[j..].windows(2).enumerate() {
        travelled += largest_distance(&pair[0], &pair[1]);
        // On the way the markers are as large as at the larger end.
        let ends = radii[j].iter().zip(&radii[j + there + 1]);
        let largest: Radii = ends.map(|(a, b)| a.max(*b)).collect();
        if travelled > far || (travelled > least && !is_in_sight(task, here, &pair[1], &largest)) {
            break;
        }
        seen = j + there + 1;
    }
    if seen >= last {
        task.goal.to_vec()
    } else {
        trajectory.features[seen].clone()
    }
}

/// Whether no occlusion stops a point, with a marker of its radius, on its straight way from `a` to
/// `b`.
fn is_in_sight(task: &Task, a: &[[f64; 2]], b: &[[f64; 2]], radii: &[f64]) -> bool {
    sight::is_free(task, a, b, radii, SLIDE * task.camera.width, CHECK_EVERY_PX)
}

/// The radius of the marker of each feature, px.
fn radii(task: &Task, features: &[[f64; 2]]) -> Radii {
    if !task.has_markers() {
        return features.iter().map(|_| 0.0).collect();
    }
    let features = features.iter().copied().collect();
    InitialState::new(task, BuildSettings::MODEL, &features).radii(task)
}

/// What inputs are divided by, so that an image motion of the whole pattern counts alike in points,
/// area and angle: points by the image width; the area by twice the goal's (its relative change is
/// twice that of lengths, seen over the pattern's size); the angle so that a turn counts as the arc
/// that it moves the points by.
fn input_scale(task: &Task) -> Vec<f64> {
    let width = task.camera.width;
    let size = task.goal_area.sqrt();
    let points = std::iter::repeat_n(width, 2 * task.goal.len());
    points
        .chain([2.0 * task.goal_area * width / size, width / size])
        .collect()
}

impl MotionMemory for Store {
    fn infer(&self, strategy: Strategy, input: &[f64], output: &mut [f64]) -> bool {
        let Strategy::Knn { k: 1 } = strategy else {
            return false;
        };
        debug_assert!(input.len() <= MAX_INPUTS);
        let nearest = self
            .inputs
            .iter()
            .zip(&self.outputs)
            .map(|(x, y)| (self.distance(x, input), y))
            .min_by(|a, b| a.0.total_cmp(&b.0));
        let Some((_, y)) = nearest else { return false };
        output.copy_from_slice(y);
        true
    }
}
