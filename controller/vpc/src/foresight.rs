//! Foresight: whole futures, simulated in the time that a cycle leaves over; the best is followed.
//!
//! A *candidate* is a [`Guide`]: a sub-goal, after which the goal is tracked. It is rolled out: the
//! law itself, with its own model, solver and constraints, steers period by period until the
//! features arrive, the cost exceeds the best one's, or the horizon ends. Its value is the sum of
//! the running cost l(v) / Np until arrival.
//!
//! The *incumbent* is the candidate that is followed. It is kept unless another one arrives at a
//! cost that is lower by 3 %. In the exact model the cost to go of what is followed therefore
//! never rises, and a stall cannot last: who stalls does not arrive.
//!
//! Candidates are, in this order, the incumbent, the goal, near an occlusion the way points that
//! k-NN and the Gaussian process infer, and samples of the memory, alternately one of the nearest
//! and any. Work is counted in simulated periods, so many a cycle; no clock decides, and a replay
//! gives the same bits.
//!
//! Source: D. Bertsekas, "Rollout, Policy Iteration, and Distributed Reinforcement Learning" (2020),
//! Sect. 2.3 (fortified rollout).

use serde::{Deserialize, Serialize};

use crate::command::{Law, Present};
use crate::features::{self, MAX_INPUTS};
use crate::guide::{Guide, Kind};
use crate::prediction::{InitialState, Plan};
use crate::recall::{self, MotionMemory, Recall};
use crate::solver::Solver;
use crate::strategy::Strategy;
use crate::{MAX_POINTS, Points, Twist, gate};

/// A candidate that arrives replaces one that does where it costs less than this share.
const BETTER: f64 = 0.97;
/// A candidate that does not arrive replaces one that does not where it comes nearer than this
/// share.
const NEARER: f64 = 0.9;
/// Errors below this multiple of the threshold of convergence are regulation around the goal: the
/// goal is tracked.
const FAR: f64 = 10.0;
/// Every other sample is one of so many nearest ones.
const RANKS: f64 = 63.0;
/// A step aside shifts the features by at most this share of the image width,
const SHIFT: f64 = 0.25;
/// turns them by at most this angle, rad,
const TURN: f64 = 1.0;
/// and shrinks them at most to this share.
const SMALLEST: f64 = 0.5;
/// A future that tracks the goal for so many periods and comes no nearer is stalled: it ends.
const PATIENCE: u32 = 6;
/// Coming nearer is to less than this share of the least distance before.
const PROGRESS: f64 = 0.99;
/// An incumbent that arrives is simulated again every so many cycles. In between it is trusted: what
/// it promised, less what the last period cost.
const TRUSTED: u32 = 4;
/// A sample is a candidate where the rest of its trajectory costs less than this multiple of what is
/// known.
const HOPEFUL: f64 = 1.0;
/// Places of a foreseen path.
pub const PLACES: usize = 8;

/// What a future leads to.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Outcome {
    /// The features arrive.
    Arrives {
        /// Sum of l(v) / Np until then.
        cost: f64,
        /// Periods until then.
        periods: u32,
    },
    /// They do not: they stall, or the horizon ends.
    Nears {
        /// Least distance from the goal (largest component), px.
        error_px: f64,
    },
    /// Not known to the end: a point is lost, or the budget or the allowed cost is used up.
    Unknown,
}

impl Outcome {
    fn is_better_than(self, other: Self) -> bool {
        match (self, other) {
            (Self::Arrives { cost, .. }, Self::Arrives { cost: than, .. }) => cost < BETTER * than,
            (Self::Arrives { .. }, _) => true,
            (Self::Nears { error_px }, Self::Nears { error_px: than }) => error_px < NEARER * than,
            (Self::Nears { .. }, Self::Unknown) => true,
            _ => false,
        }
    }
}

/// Where the features of a future are, at equal intervals. Plain data.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Path {
    /// Places that count, 0 to [`PLACES`].
    pub count: u32,
    /// Points at each, 0 to 8.
    pub points: u32,
    /// Periods from one to the next.
    pub every: u32,
    /// (u, v) of each point at each place, px; the rest is zero.
    pub places: [[[f32; 2]; MAX_POINTS]; PLACES],
}

impl Path {
    /// No path.
    pub const NONE: Self = Self {
        count: 0,
        points: 0,
        every: 1,
        places: [[[0.0; 2]; MAX_POINTS]; PLACES],
    };

    /// Notes the features after `period` periods; where there is no more room, every other place is
    /// forgotten.
    fn note(&mut self, period: u32, points: &[[f64; 2]]) {
        if !period.is_multiple_of(self.every) {
            return;
        }
        if self.count as usize == PLACES {
            for place in 1..PLACES / 2 {
                self.places.copy_within(2 * place..2 * place + 1, place);
            }
            (self.count, self.every) = (PLACES as u32 / 2, 2 * self.every);
            if !period.is_multiple_of(self.every) {
                return;
            }
        }
        if let Some(place) = self.places.get_mut(self.count as usize) {
            self.points = points.len() as u32;
            *place = [[0.0; 2]; MAX_POINTS];
            let pixels = points.iter().map(|pixel| pixel.map(|x| x as f32));
            place
                .iter_mut()
                .zip(pixels)
                .for_each(|(to, from)| *to = from);
            self.count += 1;
        }
    }
}

/// What is followed, and what is expected of it. Plain data.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Foresight {
    /// What is followed.
    pub guide: Guide,
    /// Where that leads from the next period on.
    pub outcome: Outcome,
    /// The features on the way.
    pub path: Path,
    /// Cycles since what is followed was simulated.
    pub trusted: u32,
    /// The twist that the memory infers for the next period, near an occlusion.
    pub recalled: Option<Twist>,
    /// Samples drawn so far: the next one follows from it.
    pub drawn: u64,
    /// Candidates of the last cycle, the incumbent not counted.
    pub tried: u32,
    /// Periods simulated in the last cycle.
    pub periods: u32,
    /// Changes of what is followed.
    pub switches: u32,
}

impl Foresight {
    /// Before the first cycle.
    pub const NONE: Self = Self {
        guide: Guide::GOAL,
        outcome: Outcome::Unknown,
        path: Path::NONE,
        trusted: 0,
        recalled: None,
        drawn: 0,
        tried: 0,
        periods: 0,
        switches: 0,
    };
}

/// A candidate with its future.
#[derive(Clone, Copy)]
struct Future {
    guide: Guide,
    outcome: Outcome,
    path: Path,
}

/// What one cycle thinks with.
pub(crate) struct Thinker<'a> {
    pub law: Law<'a>,
    pub solver: &'a mut Solver,
    pub memory: Option<&'a dyn MotionMemory>,
    /// Where futures begin: the features in the next period, the command in force until then, and
    /// the plan that warms its solver.
    pub initial: &'a InitialState,
    pub standing: &'a Twist,
    pub previous: &'a Plan,
    /// l(v) / Np of the period that leads there.
    pub spent: f64,
    /// At the goal below this distance (largest component), px.
    pub converged_px: f64,
    /// The twist that the memory infers there.
    pub recalled: Option<Twist>,
    /// Most periods of a future.
    pub horizon: u32,
    /// Periods that may still be simulated in this cycle.
    pub budget: u32,
}

impl Thinker<'_> {
    /// Looks for something better to follow.
    pub(crate) fn think(&mut self, foresight: &mut Foresight) {
        let points = &self.initial.points;
        let begun = self.budget;
        let is_far =
            features::largest_error(points, &self.law.task.goal) >= FAR * self.converged_px;
        foresight.tried = 0;
        let answers = self.ask();
        foresight.recalled = answers
            .iter()
            .flatten()
            .last()
            .map(|(_, answer)| answer.twist);
        self.recalled = foresight.recalled;
        if !is_far {
            foresight.guide = Guide::GOAL;
        }
        let mut best = self.incumbent(foresight);
        if is_far {
            self.improve(&answers, &mut best, foresight);
        }
        if best.guide != foresight.guide {
            foresight.switches += 1;
            foresight.trusted = 0;
        }
        (foresight.guide, foresight.outcome, foresight.path) =
            (best.guide, best.outcome, best.path);
        foresight.periods = begun - self.budget;
    }

    /// What is followed, with its future.
    fn incumbent(&mut self, foresight: &mut Foresight) -> Future {
        let Foresight { guide, path, .. } = *foresight;
        match foresight.outcome {
            Outcome::Arrives { cost, periods }
                if foresight.trusted < TRUSTED && periods > 1 && cost > self.spent =>
            {
                foresight.trusted += 1;
                let outcome = Outcome::Arrives {
                    cost: cost - self.spent,
                    periods: periods - 1,
                };
                Future {
                    guide,
                    outcome,
                    path,
                }
            }
            _ => {
                foresight.trusted = 0;
                self.roll_out(guide, f64::INFINITY)
            }
        }
    }

    /// Compares candidates with the incumbent until the budget is used up.
    fn improve(
        &mut self,
        answers: &[Option<(Kind, Recall)>],
        best: &mut Future,
        foresight: &mut Foresight,
    ) {
        if best.guide.kind != Kind::Goal {
            self.consider(Guide::GOAL, best, foresight);
        }
        for (kind, answer) in answers.iter().flatten() {
            let guide = Guide::GOAL.after(*kind, &answer.way_point);
            self.consider(guide, best, foresight);
        }
        // Each that is simulated takes a period at least; the others are bounded in number.
        for _ in 0..self.budget {
            if self.budget == 0 {
                return;
            }
            foresight.drawn += 1;
            if let Some(guide) = self.drawn(foresight.drawn, best.outcome) {
                self.consider(guide, best, foresight);
            }
        }
    }

    /// The candidate of this number: over a sample; while no way is known, in turn also over two
    /// samples, or with a step aside first. `None` where it needs a memory and there is none, or where
    /// a sample is left out for its cost.
    fn drawn(&self, number: u64, best: Outcome) -> Option<Guide> {
        let (knows_a_way, most) = match best {
            Outcome::Arrives { cost, .. } => (true, HOPEFUL * cost),
            _ => (false, f64::INFINITY),
        };
        let sample = || self.over_sample(Guide::GOAL, number, most);
        match number % 4 {
            1 if !knows_a_way => {
                let second = self.over_sample(Guide::GOAL, 4 * number + 1, most)?;
                self.over_sample(second, number, most)
            }
            2 if !knows_a_way => Some(self.aside(Guide::GOAL, number)),
            3 if !knows_a_way => Some(self.aside(sample().unwrap_or(Guide::GOAL), number)),
            _ => sample(),
        }
    }

    /// What k-NN and the Gaussian process infer for the next period, near an occlusion.
    fn ask(&self) -> [Option<(Kind, Recall)>; 2] {
        let (task, points) = (self.law.task, &self.initial.points);
        let is_near = recall::clearance(task, points) < self.law.settings.trigger_px;
        let memory = self.memory.filter(|_| is_near);
        let kinds = [
            (Kind::Neighbour, Strategy::Knn { k: 1 }),
            (Kind::Regression, Strategy::Gpr),
        ];
        kinds.map(|(kind, strategy)| {
            let answer = recall::query(task, strategy, memory?, points)?;
            Some((kind, answer))
        })
    }

    fn consider(&mut self, guide: Guide, best: &mut Future, foresight: &mut Foresight) {
        foresight.tried += 1;
        let most = match best.outcome {
            Outcome::Arrives { cost, .. } => BETTER * cost,
            _ => f64::INFINITY,
        };
        let future = self.roll_out(guide, most);
        if future.outcome.is_better_than(best.outcome) {
            *best = future;
        }
    }

    /// The guide that goes over a sample first, then on as `then`; `None` without a memory, or where
    /// the rest of the sample's trajectory alone costs more than `most`.
    fn over_sample(&self, then: Guide, number: u64, most: f64) -> Option<Guide> {
        let points = &self.initial.points;
        let input = self.law.task.recall_input(points);
        let mut found = [0.0; MAX_INPUTS];
        let found = found.get_mut(..input.len())?;
        let memory = self.memory?;
        let uniform = uniform(number, 0);
        let cost_to_go = match number % 2 {
            0 => memory.neighbour(&input, 1 + (uniform * uniform * RANKS) as usize, found),
            _ => memory.sample((uniform * memory.count() as f64) as usize, found),
        }?;
        let target = found.as_chunks().0.get(..points.len())?;
        (cost_to_go <= most).then(|| then.after(Kind::Sample, target))
    }

    /// The guide that steps aside first, then goes on as `then`: the features shifted, turned and
    /// shrunk at random.
    fn aside(&self, then: Guide, number: u64) -> Guide {
        let task = self.law.task;
        let points = &self.initial.points;
        let [u, v, turn, size] = [1, 2, 3, 4].map(|k| uniform(number, k));
        let count = points.len() as f64;
        let centre = [0, 1].map(|c| points.iter().filter_map(|p| p.get(c)).sum::<f64>() / count);
        let shift = [u, v].map(|x| SHIFT * task.camera.width * (2.0 * x - 1.0));
        let (sin, cos) = libm::sincos(TURN * (2.0 * turn - 1.0));
        let size = SMALLEST + (1.0 - SMALLEST) * size;
        let target: Points = points
            .iter()
            .map(|p| {
                let (a, b) = (size * (p[0] - centre[0]), size * (p[1] - centre[1]));
                let (a, b) = (cos * a - sin * b, sin * a + cos * b);
                [
                    (centre[0] + shift[0] + a).clamp(0.0, task.camera.width),
                    (centre[1] + shift[1] + b).clamp(0.0, task.camera.height),
                ]
            })
            .collect();
        then.after(Kind::Aside, &target)
    }

    /// Simulates the law under a guide, at a cost of at most `most`.
    fn roll_out(&mut self, guide: Guide, most: f64) -> Future {
        let Law { task, settings } = self.law;
        let np = settings.np as f64;
        let mut future = Future {
            guide,
            outcome: Outcome::Unknown,
            path: Path::NONE,
        };
        let mut guide = guide;
        let (mut initial, mut previous) = (self.initial.clone(), *self.previous);
        let mut standing = *self.standing;
        let (mut cost, mut nearest, mut idle) = (0.0, f64::INFINITY, 0);
        let is_from_front = gate::is_from_front(task, &initial.points);
        for period in 0..self.horizon {
            // Where the camera would look from the side, the features are soon refused.
            if is_from_front && !gate::is_from_front(task, &initial.points) {
                return future;
            }
            future.path.note(period, &initial.points);
            let error_px = features::largest_error(&initial.points, &task.goal);
            if error_px < PROGRESS * nearest {
                (nearest, idle) = (error_px, 0);
            } else if guide.ahead == 0 {
                idle += 1;
            }
            if idle > PATIENCE {
                break;
            }
            if error_px < self.converged_px {
                let periods = period;
                future.outcome = Outcome::Arrives { cost, periods };
                return future;
            }
            // Every candidate takes at least one period, so that a cycle ends.
            let Some(left) = self.budget.checked_sub(1) else {
                return future;
            };
            self.budget = left;
            let tracked = guide.advance(&initial.points, self.converged_px);
            let aim = tracked.as_ref().unwrap_or(&task.goal);
            let recalled = self.recalled.as_ref().filter(|_| period == 0);
            let present = Present {
                initial: &initial,
                standing: &standing,
                warm: &previous,
                recalled,
            };
            let (twist, solution) = self.law.command(self.solver, &present, aim, aim);
            cost += match guide.ahead == 0 && settings.nc == 1 && solution.sends(&twist) {
                // The solver has summed it up already.
                true => solution.cost / np,
                false => self.law.running_cost(self.solver, &initial, &twist) / np,
            };
            if cost > most {
                return future;
            }
            (previous, standing) = (solution.plan, twist);
            match initial.moved(task, settings.model, &twist, task.ts) {
                Some(next) => initial = next,
                None => return future,
            }
        }
        future.outcome = Outcome::Nears { error_px: nearest };
        future
    }
}

/// A number in [0, 1) that follows from two others (SplitMix64).
fn uniform(number: u64, index: u64) -> f64 {
    let mut z = (8 * number + index).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
}

#[cfg(test)]
mod tests {
    use scene::Scene;

    use super::*;
    use crate::{Controller, Measurement, Settings, Task};

    /// A memory whose samples are the goal, shifted.
    struct Shifted(Points);

    impl MotionMemory for Shifted {
        fn infer(&self, _: Strategy, _: &[f64], _: &mut [f64]) -> bool {
            false
        }

        fn neighbour(&self, _: &[f64], rank: usize, found: &mut [f64]) -> Option<f64> {
            self.sample(rank, found)
        }

        fn count(&self) -> usize {
            100
        }

        fn sample(&self, index: usize, input: &mut [f64]) -> Option<f64> {
            let goal = self.0.iter().flatten();
            for (to, from) in input.iter_mut().zip(goal) {
                *to = from + index as f64 - 50.0;
            }
            Some(0.0)
        }
    }

    #[test]
    fn a_cycle_ends_within_its_budget_wherever_the_camera_jumps() {
        let scene = Scene::parse(scene::PAPER_SIM, "sim").unwrap();
        let memory = Shifted(Task::new(&scene).unwrap().goal);
        let settings = Settings {
            strategy: Strategy::Foresight,
            ..Settings::default()
        };
        let mut law = Box::new(Controller::new(&scene, settings).unwrap());
        let mut arrived = 0;
        for k in 0..300_u64 {
            // Now and then somewhere else, so that what was promised is wrong.
            let [x, y, z] = [0, 1, 2].map(|axis| uniform(k / 4, axis) - 0.5);
            let mut pose = scene.goal;
            pose.translation = [0.5 * x, 0.5 * y, 0.9 + 0.5 * z];
            let points = law.task().features_at(&pose).unwrap();
            let now_ns = k * 33_333_333;
            let measured = Measurement::from_points(&points).taken(now_ns, now_ns);
            if let Ok(step) = law.step(&measured, Some(&memory)) {
                law.sent(&step.twist, now_ns);
                law.think(Some(&memory));
                let foreseen = law.foreseen();
                assert!(foreseen.periods <= law.foreseen_periods());
                assert!(foreseen.tried <= law.foreseen_periods());
                arrived += u32::from(matches!(foreseen.outcome, Outcome::Arrives { .. }));
            }
        }
        assert!(arrived > 100, "{arrived}");
    }

    #[test]
    fn a_path_keeps_places_at_equal_intervals_however_long_it_is() {
        for length in [1, 7, 8, 9, 100, 1000] {
            let mut path = Path::NONE;
            for period in 0..length {
                path.note(period, &[[f64::from(period), 1.0]; 4]);
            }
            assert!(path.count >= length.min(PLACES as u32 / 2) && path.points == 4);
            for (place, points) in path.places.iter().enumerate().take(path.count as usize) {
                assert_eq!(points[3], [(place as u32 * path.every) as f32, 1.0]);
            }
            assert!(path.count * path.every >= length, "{length}");
        }
    }
}
