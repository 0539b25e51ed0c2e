//! One trajectory from a start to the goal.

use nalgebra::Vector3;
use rand_chacha::ChaCha8Rng;
use scene::{Pose, Scene};
use vpc::features::{largest_distance, largest_error};
use vpc::motion::Motion;
use vpc::task::placed;
use vpc::{Points, Task, Twist, camera, constraint};

use crate::planner;
use crate::solution::Finder;
use crate::store::{Store, Trajectory};

/// Periods without motion after which a trajectory of the paper's algorithms counts as stuck, and
/// those after which the solver starts from other directions.
const STUCK_PERIODS: usize = 6;
const STALLED_PERIODS: usize = 3;
/// Image motion below which a period counts as one without motion: share of the motion that the
/// camera's linear limit gives the pattern at its goal.
const STILL: f64 = 2e-3;
/// Constraint violation that an exact step may show after the solver's tolerance, px.
const TOLERATED_PX: f64 = 1.0;

/// Why a start gave no trajectory.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Failure {
    /// The features stopped moving short of the goal.
    Stuck,
    /// No start of the solver gave a feasible command.
    NoSolution,
    /// A feature went into an occlusion or out of the image.
    Violation,
    /// The scene's time ran out.
    TimeOut,
}

/// A start that was tried: a trajectory, a failure of the paper's algorithms, or both, where the
/// planner found a way nevertheless.
#[derive(Clone, Debug)]
pub struct Trial {
    /// The trajectory, if there is one.
    pub trajectory: Option<Trajectory>,
    /// Why the paper's algorithms gave none.
    pub failure: Option<Failure>,
}

/// Runs from a start to the goal, step by step; `command` gives the next command from features,
/// last command, and whether the features have not moved for some periods. After `most_still` of
/// them it counts as stuck.
///
/// Source: paper, the first algorithm (its inner loop, with the condition "not converged and not
/// failed").
pub(crate) fn run(
    scene: &Scene,
    task: &Task,
    start: &Pose,
    most_still: usize,
    mut command: impl FnMut(&Points, &Twist, bool) -> Option<Twist>,
) -> Result<Trajectory, Failure> {
    let periods = (scene.success.time_s * scene.camera.rate_hz) as usize;
    let fastest = scene.limits.linear * task.ts * task.camera.fx / scene.goal.translation[2];
    let still = STILL * fastest;
    // The pattern's points in the frame of a camera that obeys exactly.
    let mut pattern: Vec<Vector3<f64>> = placed(&task.pattern, start).collect();
    let mut trajectory = Trajectory {
        features: Vec::new(),
        twists: Vec::new(),
    };
    let (mut twist, mut rest) = ([0.0; 6], 0);
    for _ in 0..=periods {
        let see = |x: &Vector3<f64>| camera::project(&task.camera, (*x).into());
        let points: Option<Points> = pattern.iter().map(see).collect();
        let points = points.ok_or(Failure::Violation)?;
        if !is_visible(task, &points, &pattern) {
            return Err(Failure::Violation);
        }
        let moved = trajectory
            .features
            .last()
            .map_or(f64::INFINITY, |last| largest_distance(last, &points));
        rest = if moved < still { rest + 1 } else { 0 };
        trajectory.features.push(points.to_vec());
        // Half of what counts as arrived, so that the end of a trajectory lies inside it.
        if largest_error(&points, &task.goal) < 0.5 * scene.success.convergence_px {
            return Ok(trajectory);
        }
        if rest >= most_still {
            return Err(Failure::Stuck);
        }
        twist = command(&points, &twist, rest >= STALLED_PERIODS).ok_or(Failure::NoSolution)?;
        trajectory.twists.push(twist);
        let motion = Motion::of_camera(&twist, task.ts);
        pattern.iter_mut().for_each(|x| *x = motion.apply(x));
    }
    Err(Failure::TimeOut)
}

/// A trajectory by the paper's algorithms, guided by `store` where it is given; where that fails
/// and the settings allow it, along a path that the planner finds.
pub fn generate(
    scene: &Scene,
    finder: &mut Finder<'_>,
    start: &Pose,
    store: Option<&Store>,
    rng: &mut ChaCha8Rng,
) -> Trial {
    let task = finder.task;
    let command = |points: &Points, previous: &Twist, is_stalled| {
        finder.find(points, previous, is_stalled, store, rng)
    };
    let found = run(scene, task, start, STUCK_PERIODS, command);
    let failure = found.as_ref().err().copied();
    let may_plan = finder.settings.planner && failure.is_some();
    let planned = may_plan.then(|| planner::path(scene, task, start, rng));
    let followed = planned
        .flatten()
        .and_then(|path| follow(scene, finder, start, &path));
    Trial {
        trajectory: found.ok().or(followed),
        failure,
    }
}

/// Tracks a path of features by the controller: the way point runs ahead of the features by a
/// distance that is halved until the trajectory gets through.
fn follow(
    scene: &Scene,
    finder: &mut Finder<'_>,
    start: &Pose,
    path: &[Points],
) -> Option<Trajectory> {
    let task = finder.task;
    [0.15, 0.08, 0.04, 0.02].iter().find_map(|share| {
        let ahead = share * task.camera.width;
        let mut next = 0;
        run(scene, task, start, STUCK_PERIODS, |points, previous, _| {
            while next < path.len() && largest_distance(points, &path[next]) < ahead {
                next += 1;
            }
            let target = path.get(next).unwrap_or(&task.goal).clone();
            finder.solve(points, &target, previous)
        })
        .ok()
    })
}

/// Whether the marker of every point, which is at this place in the camera frame, is inside the
/// image and outside the occlusions.
fn is_visible(task: &Task, points: &Points, places: &[Vector3<f64>]) -> bool {
    points.iter().zip(places).all(|(&pixel, x)| {
        let least = task.radius(x.z) - TOLERATED_PX;
        constraint::least_clearance(task, pixel) > least
            && constraint::border_clearance(task, pixel) > least
    })
}
