//! Refining a way: from a first guess to the cheapest commands near it, pass by pass.
//!
//! A pass is one of differential dynamic programming. Backwards it expands the cost to go in the
//! pose of the pattern, and gives each step a correction inside the velocity limits and a feedback;
//! forwards it applies them, shortened until the merit falls.
//!
//! Source: Y. Tassa, N. Mansard and E. Todorov, "Control-limited differential dynamic programming",
//! ICRA 2014.
#![expect(
    clippy::indexing_slicing,
    reason = "a dense kernel: steps are below those of the arrays, components below DOF"
)]

use nalgebra::{Cholesky, Matrix3, Matrix6, Vector3, Vector6};

use crate::course::{Course, Quadratic, Stage, Worth, clamped};
use crate::motion::Motion;
use crate::size::Size;
use crate::way::COMMANDS;
use crate::workspace::Workspace;
use crate::{DOF, Twist};

/// Shares of the corrections that are tried.
const SHARES: [f64; 5] = [1.0, 0.5, 0.25, 0.1, 0.03];
/// Share of the promised decrease that a pass must achieve.
const SUFFICIENT: f64 = 1e-3;
/// Curvature that every component of a command has at least, as a share of their mean.
const FLOOR: f64 = 1e-9;
/// Most projected Newton steps to a correction.
const NEWTON: usize = 8;
/// A Newton step that gains less than this share is the last.
const EXACT: f64 = 1e-9;

/// Numbers of a state, and of a correction with its feedback.
const STATE: usize = 12;
const GAIN: usize = DOF + DOF * DOF;
/// Numbers of workspace.
pub const ROOM: usize = (COMMANDS + 1) * STATE + COMMANDS * (GAIN + DOF);

/// What a step takes, [work](crate::work): in a forward and in a backward pass.
#[derive(Clone, Copy, Debug)]
struct Prices {
    forward: u32,
    backward: u32,
}

impl Prices {
    /// In problems of this size.
    const fn of(size: Size) -> Self {
        let (np, points) = (size.np as u32, size.points as u32);
        let clearances = 2 * points * (20 + 3 * size.obstacles as u32 / 2);
        Self {
            forward: 200 + np * points * 10 + clearances,
            backward: 900 + np * (200 + points * 60) + clearances,
        }
    }
}

/// The method, in a workspace that the caller lends.
pub struct Refiner<'w> {
    /// The pattern before each step of the way that was judged last, and after them.
    states: &'w mut [[f64; STATE]],
    gains: &'w mut [[f64; GAIN]],
    /// The commands that were tried last.
    pub tried: &'w mut [Twist],
    prices: Prices,
    /// Counted [work](crate::work) so far.
    pub work: u64,
}

impl<'w> Refiner<'w> {
    /// For problems of this size; `None` if the workspace is shorter than [`ROOM`].
    pub fn new(size: Size, workspace: &'w mut [f64]) -> Option<Self> {
        let mut workspace = Workspace(workspace);
        Some(Self {
            states: workspace.arrays(COMMANDS + 1)?,
            gains: workspace.arrays(COMMANDS)?,
            tried: workspace.arrays(COMMANDS)?,
            prices: Prices::of(size),
            work: 0,
        })
    }

    /// Most work of a pass over so many steps.
    pub fn most(&self, steps: usize) -> u64 {
        let forward = (1 + SHARES.len()) as u64 * u64::from(self.prices.forward);
        steps as u64 * (forward + u64::from(self.prices.backward))
    }

    /// One pass: the worth of the way after it, and whether that fell. `None` where the way brings
    /// a point behind the camera.
    pub fn pass(&mut self, course: &Course<'_>, way: &mut [Twist]) -> Option<(Worth, bool)> {
        let count = course.steps.min(way.len()).min(COMMANDS);
        let (way, rest) = way.split_at_mut(count);
        rest.fill([0.0; DOF]);
        let now = self.judge(course, way)?;
        let Some(promised) = self.backward(course, way) else {
            return Some((now, false));
        };
        for share in SHARES {
            let Some(worth) = self.forward(course, way, share) else {
                continue;
            };
            if worth.merit() < now.merit() - SUFFICIENT * share * promised {
                way.copy_from_slice(&self.tried[..count]);
                return Some((worth, true));
            }
        }
        Some((now, false))
    }

    /// What a way is worth; keeps its states.
    fn judge(&mut self, course: &Course<'_>, way: &[Twist]) -> Option<Worth> {
        self.work += way.len() as u64 * u64::from(self.prices.forward);
        let (mut worth, mut state) = (Worth::default(), course.start);
        for (place, command) in self.states.iter_mut().zip(way) {
            *place = stored(&state);
            state = course.step(&state, command, &mut worth)?;
        }
        self.states[way.len()] = stored(&state);
        course.end(&state, &mut worth)?;
        Some(worth)
    }

    /// What the way is worth with a share of its corrections.
    fn forward(&mut self, course: &Course<'_>, way: &[Twist], share: f64) -> Option<Worth> {
        self.work += way.len() as u64 * u64::from(self.prices.forward);
        let (mut worth, mut state) = (Worth::default(), course.start);
        for (k, command) in way.iter().enumerate() {
            let off = read(&self.states[k]).inverse().then(&state).logarithm();
            let (change, feedback) = self.gains[k].split_at(DOF);
            let change = Vector6::from_column_slice(change);
            let feedback = Matrix6::from_column_slice(feedback);
            let command = Vector6::from(*command) + change * share + feedback * off;
            self.tried[k] = course.within(&command);
            state = course.step(&state, &self.tried[k], &mut worth)?;
        }
        course.end(&state, &mut worth)?;
        Some(worth)
    }

    /// Corrections and feedback from the end to the beginning; the decrease that they promise.
    /// `None` where a curvature is not positive.
    fn backward(&mut self, course: &Course<'_>, way: &[Twist]) -> Option<f64> {
        self.work += way.len() as u64 * u64::from(self.prices.backward);
        let mut to_go = course.expand_end(&read(&self.states[way.len()]));
        let mut promised = 0.0;
        for (k, command) in way.iter().enumerate().rev() {
            let mut stage = course.expand(&read(&self.states[k]), command, &to_go);
            let floor = FLOOR * stage.command.trace() / DOF as f64 + f64::MIN_POSITIVE;
            for i in 0..DOF {
                stage.command[(i, i)] += course.damping * stage.command[(i, i)] + floor;
            }
            let (change, feedback) = correction(&stage, command, &course.bounds)?;
            promised += before(&stage, &change, &feedback, &mut to_go);
            let (to, gain) = self.gains[k].split_at_mut(DOF);
            to.copy_from_slice(change.as_slice());
            gain.copy_from_slice(feedback.as_slice());
        }
        Some(promised)
    }
}

/// Makes the cost to go that before a step with this correction and feedback; the decrease by them.
fn before(
    stage: &Stage,
    change: &Vector6<f64>,
    feedback: &Matrix6<f64>,
    to_go: &mut Quadratic,
) -> f64 {
    let pull = stage.command * change + stage.of_command;
    to_go.slope = stage.of_pose + feedback.transpose() * pull + stage.mixed.transpose() * change;
    let curvature = stage.pose
        + feedback.transpose() * (stage.command * feedback + stage.mixed)
        + stage.mixed.transpose() * feedback;
    to_go.curvature = (curvature + curvature.transpose()) * 0.5;
    -0.5 * change.dot(&(pull + stage.of_command))
}

/// The correction of a command that is best inside its bounds, by projected Newton steps, and the
/// feedback of the components that are not at a bound.
fn correction(
    stage: &Stage,
    command: &Twist,
    bounds: &[Twist; 2],
) -> Option<(Vector6<f64>, Matrix6<f64>)> {
    let [least, most] = bounds.map(|bound| Vector6::from(bound) - Vector6::from(*command));
    let value = |x: &Vector6<f64>| x.dot(&(stage.of_command + stage.command * x * 0.5));
    let (mut change, mut lowest) = (Vector6::zeros(), 0.0);
    let mut free = [true; DOF];
    for _ in 0..NEWTON {
        let mut slope = stage.of_command + stage.command * change;
        for i in 0..DOF {
            let is_least = change[i] <= least[i] && slope[i] > 0.0;
            let is_most = change[i] >= most[i] && slope[i] < 0.0;
            free[i] = !is_least && !is_most;
            if !free[i] {
                slope[i] = 0.0;
            }
        }
        let step = Cholesky::new(reduced(&stage.command, &free))?.solve(&slope);
        let found = SHARES.iter().find_map(|share| {
            let next = clamped(&(change - step * *share), &least, &most);
            let value = value(&next);
            (value < lowest).then_some((next, value))
        });
        let Some((next, value)) = found else { break };
        let gained = lowest - value;
        (change, lowest) = (next, value);
        if gained < EXACT * lowest.abs() {
            break;
        }
    }
    let mut mixed = stage.mixed;
    for i in 0..DOF {
        if !free[i] {
            mixed.row_mut(i).fill(0.0);
        }
    }
    let feedback = Cholesky::new(reduced(&stage.command, &free))?.solve(&mixed);
    Some((change, -feedback))
}

/// The matrix of the free components, with the identity for the others.
fn reduced(matrix: &Matrix6<f64>, free: &[bool; DOF]) -> Matrix6<f64> {
    Matrix6::from_fn(|i, j| match (free[i] && free[j], i == j) {
        (true, _) => matrix[(i, j)],
        (false, true) => 1.0,
        (false, false) => 0.0,
    })
}

fn stored(motion: &Motion) -> [f64; STATE] {
    let mut numbers = [0.0; STATE];
    let (rotation, translation) = numbers.split_at_mut(9);
    rotation.copy_from_slice(motion.rotation.as_slice());
    translation.copy_from_slice(motion.translation.as_slice());
    numbers
}

fn read(numbers: &[f64; STATE]) -> Motion {
    let (rotation, translation) = numbers.split_at(9);
    Motion {
        rotation: Matrix3::from_column_slice(rotation),
        translation: Vector3::from_column_slice(translation),
    }
}

#[cfg(test)]
mod tests {
    use scene::{Pose, Scene};
    use serde_json::Value;

    use super::*;
    use crate::Task;
    use crate::course::Barrier;
    use crate::draft::{self, Draft, Progress};
    use crate::guess::DETOURS;
    use crate::motion::rotation;

    fn course<'a>(task: &'a Task, pose: &Pose) -> Course<'a> {
        Course {
            task,
            start: Motion {
                rotation: rotation(pose.rotation),
                translation: pose.translation.into(),
            },
            bounds: [task.limits.map(|v| -v), task.limits],
            np: 3,
            steps: COMMANDS,
            margin_px: 0.0,
            barrier: Barrier::NONE,
            damping: 0.0,
        }
    }

    /// The starts of paper-sim, each with the cost of the best way that IPOPT knows
    /// (`fixtures/oracle.py`), summed up over the periods.
    fn known_ways(task: &Task, time_s: f64) -> Vec<(Pose, f64)> {
        let known: Value =
            serde_json::from_str(include_str!("../fixtures/oracle-paper-sim.json")).unwrap();
        let starts = scene::parse_starts(scene::PAPER_SIM_STARTS, "starts").unwrap();
        let pairs = starts.into_iter().zip(known["ways"].as_array().unwrap());
        let periods = time_s / task.ts;
        pairs
            .filter_map(|(start, way)| Some((start, periods * way.get("cost")?.as_f64()?)))
            .collect()
    }

    #[test]
    fn ways_cost_what_those_of_an_interior_point_method_do() {
        compare(10);
    }

    #[test]
    #[ignore = "long: 98 starts"]
    fn ways_from_all_starts_cost_what_those_of_an_interior_point_method_do() {
        compare(1);
    }

    /// Compares the ways from every `every`-th start.
    fn compare(every: usize) {
        let scene = Scene::parse(scene::PAPER_SIM, "sim").unwrap();
        let task = Task::new(&scene).unwrap();
        let mut workspace = vec![0.0; ROOM];
        let mut refiner = Refiner::new(Size::of(&task, 3, 1), &mut workspace).unwrap();
        let known = known_ways(&task, scene.success.time_s);
        let (mut all, mut done, mut as_good) = (0, 0, 0);
        for (start, cost) in known.iter().step_by(every) {
            let course = course(&task, start);
            let mut refined = |detour| {
                let mut draft = Draft::NONE;
                course.guess(&detour, draft.begin(&course.start, draft::SOFT));
                let progress = loop {
                    match draft.refine(&mut refiner, &course, f64::INFINITY) {
                        Progress::Going => (),
                        ended => break ended,
                    }
                };
                let worth = refiner.judge(&course, draft.way.commands()).unwrap();
                (progress == Progress::Done && worth.worst_px < 1.0).then_some(worth.cost)
            };
            let least = DETOURS.into_iter().filter_map(&mut refined);
            let least = least.min_by(f64::total_cmp);
            all += 1;
            done += u32::from(least.is_some());
            as_good += u32::from(least.is_some_and(|least| least < 1.01 * cost));
        }
        assert_eq!(known.len(), 98);
        // Of the first guesses of a run.
        assert!(
            98 * done >= 93 * all && 98 * as_good >= 90 * all,
            "{done} ways of {all}, {as_good} as good"
        );
    }

    #[test]
    fn a_correction_is_the_best_inside_its_bounds() {
        let spread = Matrix6::from_fn(|i, j| libm::sin((7 * i + 3 * j) as f64));
        let stage = Stage {
            of_pose: Vector6::zeros(),
            of_command: Vector6::new(3.0, -2.0, 0.5, -4.0, 0.1, 1.0),
            pose: Matrix6::zeros(),
            mixed: Matrix6::identity(),
            command: spread.transpose() * spread + Matrix6::identity() * 0.1,
        };
        let (command, bounds) = ([0.1; DOF], [[-0.5; DOF], [0.5; DOF]]);
        let (change, feedback) = correction(&stage, &command, &bounds).unwrap();
        let slope = stage.of_command + stage.command * change;
        let mut bound = 0;
        for i in 0..DOF {
            let v = command[i] + change[i];
            assert!((-0.5..=0.5).contains(&v));
            if v == -0.5 || v == 0.5 {
                // Only beyond the bound is it cheaper, and no feedback leads there.
                assert!(slope[i] * v < 0.0, "{i}");
                assert_eq!(feedback.row(i).amax(), 0.0);
                bound += 1;
            } else {
                assert!(slope[i].abs() < 1e-6, "{i} {slope}");
            }
        }
        assert!((1..DOF).contains(&bound), "{bound}");
    }
}
