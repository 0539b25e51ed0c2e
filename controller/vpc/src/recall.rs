//! Recall: when to ask the memory, and how to use its answer.

use memory_blob::Samples;

use crate::prediction::InitialState;
use crate::settings::Settings;
use crate::strategy::{MAX_NEIGHBOURS, Strategy};
use crate::task::Task;
use crate::{DOF, MAX_POINTS, Points, Twist, constraint, limit};

/// Largest allowed twist of the memory, as a multiple of the limits: a regression overshoots a
/// little.
const MOST_TWIST: f64 = 2.0;
/// Samples of a memory that is searched for a trajectory, at most: each is looked at.
const MOST_SCANNED: usize = 65_536;
/// Most commands of the rest of a trajectory.
pub(crate) const LONGEST: usize = 64;
/// Largest allowed distance of a way point from the image, as a share of the image.
const MOST_OUTSIDE: f64 = 0.25;

/// The memory's answer to some features: y = (v, way point).
#[derive(Clone, Debug, PartialEq)]
pub struct Recall {
    /// Warm start, inside the velocity limits.
    pub twist: Twist,
    /// Way point, px.
    pub way_point: Points,
}

/// Whether the memory is asked at this [`clearance`] of the nearest feature, px. Queries begin
/// below `trigger_px` and end at `hysteresis` times that, so that the law does not switch between
/// memory and goal at the edge of the zone.
pub fn is_near(was_near: bool, clearance_px: f64, settings: &Settings) -> bool {
    let widening = if was_near { settings.hysteresis } else { 1.0 };
    clearance_px < settings.trigger_px * widening
}

/// Least clearance of any marker's edge (of any feature, where markers are points) from any
/// occlusion, px.
pub fn clearance(task: &Task, initial: &InitialState) -> f64 {
    let places = initial.points.iter().zip(initial.radii(task));
    places
        .map(|(&pixel, radius)| constraint::least_clearance(task, pixel) - radius)
        .fold(f64::INFINITY, f64::min)
}

/// A memory of motion: infers y = (v, way point) from x = (s, area, angle), raw units, without the
/// heap. Access to single samples is optional.
///
/// The daemon asks a memory-mapped file, the builder the memory that it is growing.
pub trait MotionMemory {
    /// Writes the inferred output; `false` if the memory has no answer for this strategy and
    /// input.
    fn infer(&self, strategy: Strategy, input: &[f64], output: &mut [f64]) -> bool;

    /// Writes the input of the `rank`-th nearest sample, from 1, and returns the cost of the rest
    /// of its trajectory; `None` if there is none.
    fn neighbour(&self, _input: &[f64], _rank: usize, _found: &mut [f64]) -> Option<f64> {
        None
    }

    /// The number of samples to look at.
    fn count(&self) -> usize {
        0
    }

    /// As [`MotionMemory::neighbour`], for the sample at an index below [`MotionMemory::count`], in
    /// the memory's own order.
    fn sample(&self, _index: usize, _input: &mut [f64]) -> Option<f64> {
        None
    }

    /// The rest of the `rank`-th nearest trajectory, from 1, from its nearest sample on: writes the
    /// input of that sample, and a command for every `periods` control periods, zero after its end
    /// and after 64. `None` if there is none.
    fn trajectory(
        &self,
        _input: &[f64],
        _rank: usize,
        _periods: f64,
        _found: &mut [f64],
        _commands: &mut [Twist],
    ) -> Option<()> {
        None
    }
}

impl MotionMemory for memory_blob::Memory<'_> {
    fn infer(&self, strategy: Strategy, input: &[f64], output: &mut [f64]) -> bool {
        strategy.infer(self, input, output)
    }

    fn neighbour(&self, input: &[f64], rank: usize, found: &mut [f64]) -> Option<f64> {
        let nearest = self.samples().search(input, rank).ok()?;
        self.sample(*nearest.indices().last()?, found)
    }

    fn count(&self) -> usize {
        self.samples().len()
    }

    fn sample(&self, index: usize, input: &mut [f64]) -> Option<f64> {
        let samples = self.samples();
        let is_there = index < samples.len() && samples.input(index, input).is_ok();
        is_there.then(|| samples.cost_to_go(index))
    }

    fn trajectory(
        &self,
        input: &[f64],
        rank: usize,
        periods: f64,
        found: &mut [f64],
        commands: &mut [Twist],
    ) -> Option<()> {
        let samples = self.samples();
        let index = nearest_of_trajectory(&samples, input, rank)?;
        samples.input(index, found).ok()?;
        write_rest(&samples, index, periods, commands);
        Some(())
    }
}

/// The nearest sample of the `rank`-th nearest trajectory, from 1; those with a sample among the
/// nearest [`MAX_NEIGHBOURS`] count.
fn nearest_of_trajectory(samples: &Samples<'_>, input: &[f64], rank: usize) -> Option<usize> {
    if samples.len() > MOST_SCANNED {
        return None;
    }
    let nearest = samples
        .search(input, MAX_NEIGHBOURS.min(samples.len()))
        .ok()?;
    let mut seen = heapless::Vec::<u32, MAX_NEIGHBOURS>::new();
    let mut indices = nearest.indices().iter().copied();
    indices.find(|&index| {
        let [trajectory, _] = samples.origin(index);
        !seen.contains(&trajectory) && seen.push(trajectory).is_ok() && seen.len() == rank
    })
}

/// The commands of a trajectory from a sample on, each held until the next one that is stored; the
/// mean where several are stored between two of them.
fn write_rest(samples: &Samples<'_>, index: usize, periods: f64, commands: &mut [Twist]) {
    commands.fill([0.0; DOF]);
    let mut counts = [0_u32; LONGEST];
    samples.rest(index, |period, other| {
        let at = (f64::from(period) / periods) as usize;
        let twist = samples.output(other).first_chunk::<DOF>();
        if let (Some(mean), Some(count), Some(twist)) =
            (commands.get_mut(at), counts.get_mut(at), twist)
        {
            *count += 1;
            let pairs = mean.iter_mut().zip(twist);
            pairs.for_each(|(mean, v)| *mean += (v - *mean) / f64::from(*count));
        }
    });
    let last = counts.iter().rposition(|count| *count > 0);
    let mut held = [0.0; DOF];
    for (at, (command, count)) in commands.iter_mut().zip(counts).enumerate() {
        match count {
            0 if Some(at) < last => *command = held,
            _ => held = *command,
        }
    }
}

/// The outcome of a query of the memory.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Asked {
    /// It was not asked.
    #[default]
    Not,
    /// Its answer was followed.
    Followed,
    /// The Gaussian process knew nothing, or its answer was [out of range](Recall::from_output):
    /// the nearest neighbour's was followed.
    Replaced,
    /// No answer could be followed.
    Refused,
}

/// Asks the memory, and where the Gaussian process has no answer, the nearest neighbour.
pub fn advise(
    task: &Task,
    strategy: Strategy,
    memory: &dyn MotionMemory,
    points: &Points,
) -> (Option<Recall>, Asked) {
    if let Some(answer) = query(task, strategy, memory, points) {
        return (Some(answer), Asked::Followed);
    }
    let nearest = Strategy::Knn { k: 1 };
    match query(task, nearest, memory, points) {
        Some(answer) if strategy == Strategy::Gpr => (Some(answer), Asked::Replaced),
        _ => (None, Asked::Refused),
    }
}

/// Asks the memory; `None` if it has no answer, or one beyond what [`Recall::from_output`] allows.
pub fn query(
    task: &Task,
    strategy: Strategy,
    memory: &dyn MotionMemory,
    points: &Points,
) -> Option<Recall> {
    let mut output = [0.0; DOF + 2 * MAX_POINTS];
    let output = output.get_mut(..DOF + 2 * points.len())?;
    let has_answer = memory.infer(strategy, &task.recall_input(points), output);
    has_answer.then(|| Recall::from_output(task, output))?
}

impl Recall {
    /// Splits an output y = (v, way point), clamps the twist to the limits and the way point to the
    /// image, and moves a point of it that is inside an occlusion out of it. `None` if the output
    /// is out of range: a number is not finite, the twist beyond twice the limits, or a point
    /// further outside the image than a quarter of it. No plan of the memory is like that.
    pub fn from_output(task: &Task, output: &[f64]) -> Option<Self> {
        let (twist, way_point) = output.split_at_checked(DOF)?;
        let twist: Twist = twist.try_into().ok()?;
        let size = [task.camera.width, task.camera.height];
        // A NaN is in no range.
        let is_near = |(y, size): (&f64, f64)| {
            (-MOST_OUTSIDE * size..=(1.0 + MOST_OUTSIDE) * size).contains(y)
        };
        let mut twists = twist.iter().zip(task.limits);
        let mut ways = way_point.iter().zip(size.into_iter().cycle());
        if !twists.all(|(v, limit)| v.abs() <= MOST_TWIST * limit) || !ways.all(is_near) {
            return None;
        }
        let (way_point, _) = way_point.as_chunks();
        let inside = |[u, v]: &[f64; 2]| [u.clamp(0.0, size[0]), v.clamp(0.0, size[1])];
        Some(Self {
            twist: limit::clamp(&twist, &task.limits),
            way_point: way_point
                .iter()
                .map(|pixel| constraint::moved_out(task, inside(pixel)))
                .collect(),
        })
    }
}

#[cfg(test)]
mod tests {
    use memory_blob::{Contents, Draft};

    use super::*;

    #[test]
    fn the_rest_of_a_trajectory_holds_each_command_until_the_next() {
        // Two trajectories side by side, stored every third period.
        let samples = (0..2).flat_map(|k| (0..5).map(move |j| (k, 3 * j)));
        let sample = |(k, step): (u32, u32)| {
            let x = vec![f64::from(step), f64::from(k)];
            let mut y = vec![0.0; DOF + 2];
            (y[0], y[1]) = (f64::from(k), 1.0 + f64::from(step));
            (x, y)
        };
        let (x, y) = samples.clone().map(sample).unzip();
        let contents = Contents {
            task: [0; 32],
            offset: vec![0.0; 2],
            scale: vec![1.0; 2],
            x,
            y,
            trajectory: samples.clone().map(|(k, _)| k).collect(),
            step: samples.clone().map(|(_, step)| step).collect(),
            cost_to_go: samples.map(|_| 0.0).collect(),
            regression: None,
            provenance: Default::default(),
        };
        let draft = Draft::of(&contents).unwrap();
        let ask = |rank, periods| {
            let (mut found, mut commands) = ([0.0; 2], [[9.0; DOF]; 8]);
            let memory = draft.view();
            let input = [6.2, 0.9];
            memory.trajectory(&input, rank, periods, &mut found, &mut commands)?;
            Some((found, commands.map(|command| [command[0], command[1]])))
        };
        let (found, commands) = ask(1, 1.0).unwrap();
        assert_eq!(found, [6.0, 1.0]);
        let held = [7.0, 7.0, 7.0, 10.0, 10.0, 10.0, 13.0];
        assert_eq!(commands[..7], held.map(|v| [1.0, v]));
        assert_eq!(commands[7], [0.0; 2]);
        // The other trajectory, with a command for every three periods.
        let (found, commands) = ask(2, 3.0).unwrap();
        assert_eq!(found, [6.0, 0.0]);
        assert_eq!(
            commands[..4],
            [[0.0, 7.0], [0.0, 10.0], [0.0, 13.0], [0.0; 2]]
        );
        assert_eq!(ask(3, 1.0), None);
        // Two samples in the time of each command.
        let (_, commands) = ask(1, 6.0).unwrap();
        assert_eq!(commands[..3], [[1.0, 8.5], [1.0, 13.0], [0.0; 2]]);
    }

    #[test]
    fn the_trigger_has_hysteresis() {
        let (settings, mut near) = (Settings::default(), false);
        let seen = [30.0, 19.0, 30.0, 39.0, 41.0, 30.0].map(|clearance_px| {
            near = is_near(near, clearance_px, &settings);
            near
        });
        assert_eq!(seen, [false, true, true, true, false, false]);
    }

    #[test]
    fn an_answer_is_clamped_near_the_range_and_refused_far_from_it() {
        let task = Task::new(&scene::Scene::parse(scene::PAPER_SIM, "sim").unwrap()).unwrap();
        let mut answer = [0.0; DOF + 8];
        answer[DOF..].fill(300.0);
        let ask = |index: usize, value: f64| {
            let mut answer = answer;
            answer[index] = value;
            Recall::from_output(&task, &answer)
        };
        let (limit, width) = (task.limits[3], task.camera.width);
        assert_eq!(ask(3, -1.5 * limit).map(|r| r.twist[3]), Some(-limit));
        assert_eq!(ask(8, 1.1 * width).map(|r| r.way_point[1][0]), Some(width));
        for (index, value) in [
            (3, 2.1 * limit),
            (8, 1.3 * width),
            (9, -400.0),
            (0, f64::NAN),
            (7, f64::INFINITY),
        ] {
            assert_eq!(ask(index, value), None, "{index}: {value}");
        }
        assert_eq!(Recall::from_output(&task, &answer[..3]), None);
    }

    #[test]
    fn a_way_point_inside_an_occlusion_is_moved_out() {
        let task = Task::new(&scene::Scene::parse(scene::PAPER_SIM, "sim").unwrap()).unwrap();
        // The spot on the right is a circle about (850, 560) of radius 75.
        let mut answer = [300.0; DOF + 8];
        answer[..DOF].fill(0.0);
        (answer[DOF], answer[DOF + 1]) = (850.0 - 60.0, 560.0);
        let recall = Recall::from_output(&task, &answer).unwrap();
        let [u, v] = recall.way_point[0];
        assert!(
            (u - 775.0).abs() < 1.0 && (v - 560.0).abs() < 1.0,
            "{u} {v}"
        );
        assert_eq!(recall.way_point[1], [300.0; 2]);
    }

    /// A memory with these answers of the process and of the nearest neighbour.
    struct Answers {
        process: Option<f64>,
        neighbour: Option<f64>,
    }

    impl MotionMemory for Answers {
        fn infer(&self, strategy: Strategy, _: &[f64], output: &mut [f64]) -> bool {
            let twist = match strategy {
                Strategy::Gpr => self.process,
                _ => self.neighbour,
            };
            output.fill(300.0);
            output[..DOF].fill(twist.unwrap_or(0.0));
            twist.is_some()
        }
    }

    #[test]
    fn an_answer_out_of_range_falls_back_to_the_nearest_neighbour() {
        let task = Task::new(&scene::Scene::parse(scene::PAPER_SIM, "sim").unwrap()).unwrap();
        let ask = |strategy, process, neighbour| {
            let memory = Answers { process, neighbour };
            let (recall, asked) = advise(&task, strategy, &memory, &task.goal);
            (recall.map(|recall| recall.twist[0]), asked)
        };
        let gpr = Strategy::Gpr;
        assert_eq!(ask(gpr, Some(0.1), Some(0.2)), (Some(0.1), Asked::Followed));
        for wrong in [None, Some(f64::NAN), Some(9.0)] {
            let replaced = (Some(0.2), Asked::Replaced);
            assert_eq!(ask(gpr, wrong, Some(0.2)), replaced);
            assert_eq!(ask(gpr, wrong, wrong), (None, Asked::Refused));
            let knn = ask(Strategy::Knn { k: 1 }, Some(0.1), wrong);
            assert_eq!(knn, (None, Asked::Refused));
        }
    }
}
