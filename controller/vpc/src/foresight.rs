//! Foresight: the law simulates whole closed-loop futures in the spare time of a cycle, and follows
//! the best one.
//!
//! A *candidate* is a [`Guide`]: sub-goals, after which the goal is tracked. To roll a candidate
//! out, the law simulates itself, with its own model, solver and constraints, step by step until
//! the features arrive, the cost exceeds that of the best candidate, or the horizon ends. The value
//! of a candidate is the sum of the running cost l(v) / Np until arrival.
//!
//! The *incumbent* is the candidate that the law follows. It stays unless another candidate arrives
//! at a cost that is lower by 3 %. With an exact model the incumbent's cost-to-go therefore never
//! rises, and a stall cannot persist: a future that stalls never beats one that arrives.
//!
//! The candidates are, in this order: the incumbent; a path in the joints that was just found; the
//! goal; near an occlusion, the way points that k-NN and the Gaussian process infer; and samples of
//! the memory, in turn one of the nearest and any one. A cycle may simulate a fixed number of
//! steps. No clock decides, so a replay gives the same bits. A future that takes more steps
//! continues in the next cycle; its cost is then accurate up to the camera's motion in between.
//! Where the scene has a crossable occlusion, half of the drawn candidates may cross it
//! (`crossing.rs`).
//!
//! A part of each cycle's work refines a [`Draft`]: commands all the way to the goal. Where the
//! simulated law costs less along it than the incumbent by 0.5 %, it becomes the incumbent.
//!
//! Source: D. Bertsekas, "Rollout, Policy Iteration, and Distributed Reinforcement Learning"
//! (2020), Sect. 2.3 (fortified rollout).

use ::arm::JOINTS;
use nalgebra::Vector6;
use serde::{Deserialize, Serialize};

use crate::command::{Policy, Present};
use crate::course::{Barrier, Course};
use crate::crossing::{self, Crossing};
use crate::draft::{self, Draft, Progress};
use crate::features::{self, MAX_INPUTS, PlainPoints};
use crate::guess::Guess;
use crate::guide::{At, Guide, Kind};
use crate::joint_path::JointPath;
use crate::motion::{Motion, Own};
use crate::pose::Tilt;
use crate::prediction::{InitialState, Plan};
use crate::random::uniform_of;
use crate::recall::{self, MotionMemory, Recall};
use crate::refine::Refiner;
use crate::solver::Solver;
use crate::strategy::Strategy;
use crate::task::Task;
use crate::way::{COMMANDS, Way};
use crate::work::{search, search_trajectory};
use crate::{DOF, MAX_POINTS, Points, Twist, blind, gate};

/// A candidate that arrives replaces another one that arrives if it costs less than this share of
/// the other's cost.
const BETTER: f64 = 0.97;
/// The same for a refined way.
const CHEAPER: f64 = 0.995;
/// Share of a cycle's work after which no pass over a draft begins: in the first cycle of a run,
/// while a way is known, and while none is.
const FIRST: f64 = 0.9;
const REFINING: f64 = 0.85;
const SEEKING: f64 = 0.6;
const _: () = assert!(
    COMMANDS <= recall::LONGEST,
    "a trajectory's rest fills a draft"
);
/// A simulated future is a first guess if it costs less than this multiple of the best known cost.
const PROMISING: f64 = 2.0;
/// Clearance of a draft beside the law's, px, and for each second by which features are older than
/// the command that answers them: an arm that is slower than told is elsewhere by then.
const SPARE_PX: f64 = 0.2;
const SPARE_PX_S: f64 = 100.0;
/// Steps of a draft beside those in which the incumbent arrives.
const TAIL: usize = 5;
/// A candidate that does not arrive replaces another such one if its error is below this share of
/// the other's.
const NEARER: f64 = 0.9;
/// Below this multiple of the convergence threshold the law only regulates: it tracks the goal.
pub(crate) const FAR: f64 = 10.0;
/// Every second sample is drawn from this many nearest ones.
const RANKS: f64 = 63.0;
/// Largest shift of the features in a step aside, as a share of the image width.
const SHIFT: f64 = 0.25;
/// Largest turn of the features in a step aside, rad.
const TURN: f64 = 1.0;
/// Smallest size of the features after a step aside, as a share of their size before it.
const SMALLEST: f64 = 0.5;
/// A future ends as stalled after this many steps towards the goal without progress.
const PATIENCE: u32 = 6;
/// Below this multiple of the convergence threshold it takes so many times longer.
const NEAR: f64 = 2.0;
const LAST: u32 = 4;
/// A step is progress if it reduces the least distance so far to below this share.
const PROGRESS: f64 = 0.99;
/// An incumbent that arrives is simulated again after this many steps. Until then its promised cost
/// counts, less the cost of the periods since.
const TRUSTED: f64 = 4.5;
/// A sample is a candidate if the rest of its trajectory costs less than this multiple of the best
/// known cost.
const HOPEFUL: f64 = 1.0;
/// Places of a foreseen path.
pub const PLACES: usize = 8;

/// What a future leads to.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Outcome {
    /// The features arrive.
    Arrives {
        /// Sum of l(v) / Np over the periods until then.
        cost: f64,
        /// Time until then, in steps of the preview.
        steps: f64,
    },
    /// The features do not arrive: they stall, or the horizon ends.
    Nears {
        /// Least distance from the goal (largest component), px.
        error_px: f64,
    },
    /// The end is unknown: a point is lost, or the allowed cost is used up.
    Unknown,
}

impl Outcome {
    fn is_better_than(self, other: Self) -> bool {
        self.is_below(BETTER, other)
    }

    /// The same where an arriving one must cost less than this share of the other's.
    fn is_below(self, share: f64, other: Self) -> bool {
        match (self, other) {
            (Self::Arrives { cost, .. }, Self::Arrives { cost: than, .. }) => cost < share * than,
            (Self::Arrives { .. }, _) => true,
            (Self::Nears { error_px }, Self::Nears { error_px: than }) => error_px < NEARER * than,
            (Self::Nears { .. }, Self::Unknown) => true,
            _ => false,
        }
    }
}

/// The features of a future at equal intervals. Plain data.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Path {
    /// Valid places, 0 to [`PLACES`].
    pub count: u32,
    /// Points at each, 0 to 8.
    pub points: u32,
    /// Steps from one to the next.
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

    /// Records the features after `step` steps; without room, drops every second place first.
    fn note(&mut self, step: u32, points: &[[f64; 2]]) {
        if !step.is_multiple_of(self.every) {
            return;
        }
        if self.count as usize == PLACES {
            for place in 1..PLACES / 2 {
                self.places.copy_within(2 * place..2 * place + 1, place);
            }
            (self.count, self.every) = (PLACES as u32 / 2, 2 * self.every);
            if !step.is_multiple_of(self.every) {
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

/// The incumbent, its expected outcome, and the state of the search. Plain data.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Foresight {
    /// The guide of the incumbent.
    pub guide: Guide,
    /// The expected outcome from the next period on.
    pub outcome: Outcome,
    /// The expected path of the features.
    pub path: Path,
    /// Steps since the incumbent was simulated.
    pub trusted: f64,
    /// A simulation that continues in the next cycle.
    pub suspended: Option<Suspended>,
    /// Samples drawn so far; the seed of the next one.
    pub drawn: u64,
    /// Drafts begun so far.
    pub drafted: u64,
    /// Whether a path in the joints was found that is no candidate yet.
    pub has_new_path: bool,
    /// Cycles in a row in which no way was known.
    pub lost: u32,
    /// Candidates tried in the last cycle, without the incumbent.
    pub tried: u32,
    /// Steps simulated in the last cycle.
    pub simulated: u32,
    /// Counted [work](crate::work) of these steps.
    pub work: u64,
    /// Changes of the incumbent so far.
    pub switches: u32,
}

impl Foresight {
    /// Whether the incumbent arrives.
    pub fn knows_a_way(&self) -> bool {
        matches!(self.outcome, Outcome::Arrives { .. })
    }

    /// Whether the incumbent, or the future that is being simulated, goes along a path in the
    /// joints.
    pub(crate) fn needs_path(&self) -> bool {
        let is_along = |guide: &Guide| guide.kind == Kind::Joints;
        self.has_new_path
            || is_along(&self.guide)
            || self.suspended.is_some_and(|rest| is_along(&rest.candidate))
    }

    /// Advances the expectations by one period, in which the camera came `passed` steps further on
    /// its way, which cost `spent`.
    pub(crate) fn pass(&mut self, task: &Task, passed: f64, spent: f64) {
        self.trusted += task.period / task.ts;
        if let Some(suspended) = &mut self.suspended {
            suspended.since += passed;
            suspended.spent += spent;
        }
        if let Outcome::Arrives { cost, steps } = &mut self.outcome {
            (*cost, *steps) = (*cost - spent, *steps - passed);
        }
    }

    /// The state before the first cycle.
    pub const NONE: Self = Self {
        guide: Guide::GOAL,
        outcome: Outcome::Unknown,
        path: Path::NONE,
        trusted: TRUSTED,
        suspended: None,
        drawn: 0,
        drafted: 0,
        has_new_path: false,
        lost: 0,
        tried: 0,
        simulated: 0,
        work: 0,
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

/// An unfinished simulation. Plain data.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Suspended {
    /// The candidate as it was at the beginning.
    candidate: Guide,
    /// The part of the candidate that is still ahead.
    guide: Guide,
    /// Whether the candidate is the incumbent.
    is_incumbent: bool,
    /// Steps that an earlier simulation has covered; the checks for a stall begin after them.
    known: u32,
    /// The features at the current step, px.
    points: PlainPoints,
    /// Which of two poses the model believes there.
    tilt: Option<Tilt>,
    /// How the pattern moves by itself there.
    drift: Own,
    /// The joints of the arm there, where it is known.
    q: Option<[f64; JOINTS]>,
    /// The command in force.
    standing: Twist,
    /// The plan from which the solver starts.
    previous: Plan,
    /// Whether the camera saw the front of the pattern at the beginning.
    is_from_front: bool,
    /// Simulated steps so far.
    step: u32,
    /// Simulated cost so far.
    cost: f64,
    /// Least distance from the goal so far, px.
    nearest_px: f64,
    /// Steps since that least distance.
    idle: u32,
    /// For how long points have been out of sight there, s.
    blind_s: f64,
    /// Steps that the camera has moved since the beginning.
    since: f64,
    /// Cost of the camera's motion since the beginning.
    spent: f64,
    /// The features along the future.
    path: Path,
}

/// How a simulation ended for this cycle.
#[expect(clippy::large_enum_variant, reason = "the law does not allocate")]
enum RollOut {
    Ended(Future),
    Suspended(Suspended),
}

/// The inputs, the solver and the budget of one cycle of foresight.
pub(crate) struct Thinker<'a> {
    pub policy: Policy<'a>,
    pub solver: &'a mut Solver<'a>,
    pub memory: Option<&'a dyn MotionMemory>,
    /// The path in the joints that was found last.
    pub path: &'a JointPath,
    /// The refined way that was found last.
    pub way: &'a mut Way,
    /// The way that is being refined.
    pub draft: &'a mut Draft,
    /// What refines it.
    pub refiner: Option<Refiner<'a>>,
    /// Where futures may cross an occlusion.
    pub crossing: Option<&'a Crossing>,
    /// For how long a future may take points out of sight, s.
    pub most_blind_s: f64,
    /// For how long they have been out of sight in the next period, s, if they are.
    pub blind_s: f64,
    /// Time from the last exposure to the command that answers it, s.
    pub lead_s: f64,
    /// The features in the next period, where every future begins.
    pub initial: &'a InitialState,
    /// The command in force until then.
    pub standing: &'a Twist,
    /// The plan from which the solver starts then.
    pub previous: &'a Plan,
    /// Clearance that the present command keeps beside the settings', px: so do all futures.
    pub extra_px: f64,
    /// Steps by which the camera comes further on its way in the present period: fewer than it has
    /// where another command than the law's was sent.
    pub passed: f64,
    /// l(v) / Np of these.
    pub spent: f64,
    /// Distance below which the features are at the goal (largest component), px.
    pub converged_px: f64,
    /// Most steps of a future.
    pub horizon: u32,
    /// Steps that a whole cycle may simulate.
    pub whole: u32,
    /// Steps that remain in this cycle.
    pub budget: u32,
    /// Most [work](crate::work) of these steps; the step that passes it is the last of the cycle.
    pub most_work: u64,
    /// Steps simulated so far.
    pub simulated: u32,
    /// Commands of the last simulation that are recorded.
    pub recorded: usize,
    /// Counted work of the searches in the memory.
    pub searched: u64,
}

impl Thinker<'_> {
    /// Simulates futures, and replaces the incumbent if a better one is found.
    pub(crate) fn think(&mut self, foresight: &mut Foresight) {
        let points = &self.initial.points;
        let is_far =
            features::largest_error(points, &self.policy.task.goal) >= FAR * self.converged_px;
        foresight.tried = 0;
        let answers = self.ask();
        let direct = foresight.guide.direct();
        let is_along = foresight.guide.kind == Kind::Joints;
        if !is_far && !is_along && foresight.guide != direct {
            (foresight.guide, foresight.suspended) = (direct, None);
        }
        foresight.pass(self.policy.task, self.passed, self.spent);
        foresight.lost = match foresight.knows_a_way() {
            true => 0,
            false => foresight.lost.saturating_add(1),
        };
        let suspended = foresight.suspended.take().map(|rest| match rest.step {
            // It has not begun: the camera has moved on since.
            0 => Suspended {
                is_incumbent: rest.is_incumbent,
                known: rest.known,
                ..self.begun(rest.candidate)
            },
            _ => rest,
        });
        let (rest, candidate) = match suspended {
            Some(suspended) if suspended.is_incumbent => (Some(suspended), None),
            candidate => (None, candidate),
        };
        let mut best = self.incumbent(foresight, rest);
        if foresight.has_new_path && foresight.suspended.is_none() {
            // It goes before a candidate that is under way.
            foresight.has_new_path = false;
            let along = self.begun(Guide::along(self.path));
            self.consider(along, &mut best, foresight);
        }
        if is_far {
            self.refine(&mut best, foresight);
        } else {
            self.draft.discard();
        }
        if is_far && foresight.suspended.is_none() {
            self.improve(&answers, &mut best, foresight, candidate);
        }
        if best.guide != foresight.guide {
            foresight.switches += 1;
            foresight.trusted = 0.0;
        }
        (foresight.guide, foresight.outcome, foresight.path) =
            (best.guide, best.outcome, best.path);
        foresight.simulated = self.simulated;
        foresight.work = self.done();
    }

    /// Records a command of a simulation.
    fn record(&mut self, step: usize, command: &Twist) {
        let tried = self
            .refiner
            .iter_mut()
            .flat_map(|refiner| &mut *refiner.tried);
        if let Some(place) = tried.into_iter().nth(step) {
            *place = *command;
            self.recorded = step + 1;
        }
    }

    /// Counted work so far.
    fn done(&self) -> u64 {
        let refined = self.refiner.as_ref().map_or(0, |refiner| refiner.work);
        self.solver.done() + refined + self.searched
    }

    /// Refines drafts, and follows one if its simulated future is cheaper.
    fn refine(&mut self, best: &mut Future, foresight: &mut Foresight) {
        let extra_px = self.extra_px + SPARE_PX + SPARE_PX_S * self.lead_s;
        let Some(mut course) = course(&self.policy, self.initial, extra_px) else {
            return self.draft.discard();
        };
        let least_px = course.margin_px;
        if self.draft.passes > 0 {
            self.draft.pass_by(self.passed, &course);
        }
        let share = match foresight.drafted {
            0 => FIRST,
            _ if foresight.knows_a_way() => REFINING,
            _ => SEEKING,
        };
        let most = (share * self.most_work as f64) as u64;
        while self.done() < most && self.budget > 0 {
            if let Outcome::Arrives { steps, .. } = best.outcome {
                course.steps = COMMANDS.min(steps.max(0.0) as usize + TAIL);
            }
            // No draft is begun that no pass follows.
            if self.draft.passes == 0 && self.fits(&course) {
                self.begin_draft(&course, best, foresight);
            }
            course.margin_px = least_px.max(self.policy.settings.margin_px + self.draft.spare_px);
            // What the law does under a guide has been simulated meanwhile.
            let fits = self.fits(&course);
            let Some(refiner) = self.refiner.as_mut().filter(|_| fits) else {
                return;
            };
            // A future is paid by the period, a draft by the step.
            let periods = self.policy.task.ts / self.policy.task.period;
            let known = match best.outcome {
                Outcome::Arrives { cost, .. } if cost > 0.0 => cost / periods,
                _ => f64::INFINITY,
            };
            match self.draft.refine(refiner, &course, known) {
                Progress::Going => continue,
                Progress::Done if foresight.suspended.is_none() => {
                    self.try_draft(&course, best, foresight);
                }
                Progress::Done | Progress::Blocked => (),
            }
            self.draft.discard();
        }
    }

    /// Whether another pass over a draft fits into this cycle.
    fn fits(&self, course: &Course<'_>) -> bool {
        let pass = |refiner: &Refiner<'_>| refiner.most(course.steps);
        let pass = self.refiner.as_ref().map_or(0, pass);
        self.done() + pass <= self.most_work
    }

    /// Begins the next draft with a [first guess](Guess).
    fn begin_draft(&mut self, course: &Course<'_>, best: &Future, foresight: &mut Foresight) {
        foresight.drafted += 1;
        let is_refined = best.guide.kind == Kind::Refined;
        for guess in Guess::of(foresight.drafted, is_refined) {
            if self.begin_with(&guess, course, best, foresight).is_some() {
                self.draft.spare_px = guess.spare_px();
                return;
            }
        }
    }

    /// Begins a draft with this guess; `None` if there is no such thing.
    fn begin_with(
        &mut self,
        guess: &Guess,
        course: &Course<'_>,
        best: &Future,
        foresight: &mut Foresight,
    ) -> Option<()> {
        match guess {
            Guess::Detour(detour) | Guess::Close(detour) => {
                course.guess(detour, self.draft.begin(&course.start, draft::SOFT));
            }
            Guess::Remembered(rank) => self.begin_remembered(course, *rank)?,
            Guess::Kept => self.begin_rest(course, best, draft::CLOSE),
            Guess::Loosened => self.begin_rest(course, best, draft::SOFT),
            Guess::Changed(change) => {
                self.begin_rest(course, best, draft::CLOSE);
                change.apply(course, self.draft.way.commands_mut());
            }
            Guess::Simulated => {
                let Outcome::Arrives { .. } = best.outcome else {
                    return None;
                };
                self.begin_simulated(course, best.guide, best);
            }
            Guess::Candidate => {
                foresight.drawn += 1;
                let guide = self.drawn(foresight.drawn, best.outcome)?;
                self.begin_simulated(course, guide, best);
            }
        }
        Some(())
    }

    /// Begins a draft with what is left of the incumbent, a refined way.
    fn begin_rest(&mut self, course: &Course<'_>, best: &Future, barrier: Barrier) {
        let commands = self.draft.begin(&course.start, barrier);
        let left = self.way.left(best.guide.ahead);
        let pairs = commands.iter_mut().zip(left);
        pairs.for_each(|(to, from)| *to = *from);
    }

    /// Begins a draft with what the law does under a guide.
    fn begin_simulated(&mut self, course: &Course<'_>, guide: Guide, best: &Future) {
        let most = match best.outcome {
            Outcome::Arrives { cost, .. } => PROMISING * cost,
            _ => f64::INFINITY,
        };
        self.recorded = 0;
        self.roll_out(self.begun(guide), most);
        let commands = self.draft.begin(&course.start, draft::CLOSE);
        let recorded = self.refiner.iter().flat_map(|refiner| &*refiner.tried);
        let pairs = commands.iter_mut().zip(recorded.take(self.recorded));
        pairs.for_each(|(to, from)| *to = *from);
    }

    /// Begins a draft with the rest of the memory's `rank`-th nearest trajectory; `None` if there is
    /// none.
    fn begin_remembered(&mut self, course: &Course<'_>, rank: usize) -> Option<()> {
        let Policy { task, settings } = self.policy;
        let input = task.recall_input(&self.initial.points);
        let mut found = [0.0; MAX_INPUTS];
        let found = found.get_mut(..input.len())?;
        let mut remembered = [[0.0; DOF]; COMMANDS];
        let periods = task.ts / task.period;
        let memory = self.memory?;
        self.searched += search_trajectory(memory.count(), input.len());
        memory.trajectory(&input, rank, periods, found, &mut remembered)?;
        let points = found.as_chunks().0.get(..self.initial.points.len())?;
        let points: Points = points.iter().copied().collect();
        let start = pattern(&InitialState::new(task, settings.model, &points), task)?;
        // The nearest is bent least, and keeps its side of the occlusions.
        let barrier = match rank {
            1 => draft::CLOSE,
            _ => draft::SOFT,
        };
        self.draft
            .begin(&start, barrier)
            .copy_from_slice(&remembered);
        self.draft.pass_by(0.0, course);
        for command in self.draft.way.commands_mut() {
            *command = course.within(&Vector6::from(*command));
        }
        Some(())
    }

    /// Simulates the law along the draft; it becomes the incumbent if it is cheaper.
    fn try_draft(&mut self, course: &Course<'_>, best: &mut Future, foresight: &mut Foresight) {
        foresight.tried += 1;
        let most = match best.outcome {
            Outcome::Arrives { cost, .. } => CHEAPER * cost,
            _ => f64::INFINITY,
        };
        let guide = Guide::refined(&self.draft.way, &course.start);
        if let RollOut::Ended(future) = self.roll_out(self.begun(guide), most)
            && future.outcome.is_below(CHEAPER, best.outcome)
        {
            *self.way = self.draft.way;
            *best = future;
        }
    }

    /// The incumbent with its future, as promised or simulated again.
    fn incumbent(&mut self, foresight: &mut Foresight, rest: Option<Suspended>) -> Future {
        let Foresight {
            guide,
            outcome,
            path,
            ..
        } = *foresight;
        let promised = Future {
            guide,
            outcome,
            path,
        };
        let is_trusted = match outcome {
            Outcome::Arrives { cost, steps } => {
                foresight.trusted < TRUSTED && cost > 0.0 && steps > 0.5
            }
            _ => foresight.trusted < 1.0,
        };
        if is_trusted && rest.is_none() {
            return promised;
        }
        let known = match outcome {
            Outcome::Arrives { steps, .. } => libm::ceil(steps.max(0.0)) as u32,
            _ => 0,
        };
        let rest = rest.unwrap_or_else(|| Suspended {
            is_incumbent: true,
            known,
            ..self.begun(guide)
        });
        match self.roll_out(rest, f64::INFINITY) {
            RollOut::Ended(future) => {
                foresight.trusted = 0.0;
                // The guide has advanced since the simulation began.
                Future { guide, ..future }
            }
            RollOut::Suspended(rest) => {
                foresight.suspended = Some(rest);
                promised
            }
        }
    }

    /// Compares candidates with the incumbent until the budget is used up.
    fn improve(
        &mut self,
        answers: &[Option<(Kind, Recall)>],
        best: &mut Future,
        foresight: &mut Foresight,
        rest: Option<Suspended>,
    ) {
        if let Some(rest) = rest {
            self.consider(rest, best, foresight);
        } else {
            if best.guide != Guide::GOAL {
                self.try_out(Guide::GOAL, best, foresight);
            }
            if self.crossing.is_some() && best.guide != Guide::ACROSS {
                self.try_out(Guide::ACROSS, best, foresight);
            }
            for (kind, answer) in answers.iter().flatten() {
                let guide = Guide::GOAL.after(*kind, &answer.way_point);
                self.try_out(guide, best, foresight);
            }
        }
        // Each simulated candidate takes at least one step, so this number of draws is enough.
        for _ in 0..self.budget {
            let is_over = self.budget == 0 || self.done() >= self.most_work;
            if is_over || foresight.suspended.is_some() {
                return;
            }
            foresight.drawn += 1;
            if let Some(mut guide) = self.drawn(foresight.drawn, best.outcome) {
                // In fours, so that each kind of candidate takes its turn.
                guide.crosses = self.crossing.is_some() && foresight.drawn / 4 % 2 == 1;
                self.try_out(guide, best, foresight);
            }
        }
    }

    /// The candidate of this number, over a sample. While no way is known, candidates over two
    /// samples and with a step aside take turns with it. `None` if there is no memory, or if the
    /// sample costs too much.
    fn drawn(&mut self, number: u64, best: Outcome) -> Option<Guide> {
        let (knows_a_way, most) = match best {
            Outcome::Arrives { cost, .. } => (true, HOPEFUL * cost),
            _ => (false, f64::INFINITY),
        };
        match number % 4 {
            1 if !knows_a_way => {
                let second = self.over_sample(Guide::GOAL, 4 * number + 1, most)?;
                self.over_sample(second, number, most)
            }
            2 if !knows_a_way => Some(self.aside(Guide::GOAL, number)),
            3 if !knows_a_way => {
                let sample = self.over_sample(Guide::GOAL, number, most);
                Some(self.aside(sample.unwrap_or(Guide::GOAL), number))
            }
            _ => self.over_sample(Guide::GOAL, number, most),
        }
    }

    /// The answers of k-NN and of the Gaussian process for the next period, near an occlusion.
    fn ask(&self) -> [Option<(Kind, Recall)>; 2] {
        let (task, points) = (self.policy.task, &self.initial.points);
        let is_near = recall::clearance(task, self.initial) < self.policy.settings.trigger_px;
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

    fn try_out(&mut self, guide: Guide, best: &mut Future, foresight: &mut Foresight) {
        if foresight.suspended.is_none() {
            foresight.tried += 1;
            self.consider(self.begun(guide), best, foresight);
        }
    }

    /// Simulates a candidate further. An unfinished simulation waits for the next cycle, unless the
    /// incumbent is known to arrive within the steps of one cycle.
    fn consider(&mut self, rest: Suspended, best: &mut Future, foresight: &mut Foresight) {
        let is_whole = self.budget == self.whole;
        let is_resumed = rest.step > 0;
        let (must_fit, most) = match best.outcome {
            Outcome::Arrives { cost, steps } => (steps <= f64::from(self.whole), BETTER * cost),
            _ => (false, f64::INFINITY),
        };
        match self.roll_out(rest, most) {
            RollOut::Ended(future) if !future.outcome.is_better_than(best.outcome) => (),
            RollOut::Ended(future) if is_resumed => self.confirm(&future, best, foresight),
            RollOut::Ended(future) => *best = future,
            RollOut::Suspended(rest) if is_whole || !must_fit => {
                foresight.suspended = Some(rest);
            }
            RollOut::Suspended(_) => (),
        }
    }

    /// Simulates a future that took several cycles again, from the camera's present place. If that
    /// does not fit into this cycle, the law follows the future only while no way is known, and its
    /// outcome stays unknown until a simulation ends.
    fn confirm(&mut self, found: &Future, best: &mut Future, foresight: &mut Foresight) {
        match self.roll_out(self.begun(found.guide), f64::INFINITY) {
            RollOut::Ended(future) if future.outcome.is_better_than(best.outcome) => *best = future,
            RollOut::Suspended(rest) if !matches!(best.outcome, Outcome::Arrives { .. }) => {
                *best = Future {
                    outcome: Outcome::Unknown,
                    ..*found
                };
                foresight.suspended = Some(Suspended {
                    is_incumbent: true,
                    ..rest
                });
            }
            _ => (),
        }
    }

    /// The guide `then` with a sample as a sub-goal before it; `None` without a memory, or if the
    /// rest of the sample's trajectory alone costs more than `most`.
    fn over_sample(&mut self, then: Guide, number: u64, most: f64) -> Option<Guide> {
        let points = &self.initial.points;
        let input = self.policy.task.recall_input(points);
        let mut found = [0.0; MAX_INPUTS];
        let found = found.get_mut(..input.len())?;
        let memory = self.memory?;
        let uniform = uniform_of(number, 0);
        let cost_to_go = match number % 2 {
            0 => {
                self.searched += search(memory.count(), input.len());
                memory.neighbour(&input, 1 + (uniform * uniform * RANKS) as usize, found)
            }
            _ => memory.sample((uniform * memory.count() as f64) as usize, found),
        }?;
        let target = found.as_chunks().0.get(..points.len())?;
        (cost_to_go <= most).then(|| then.after(Kind::Sample, target))
    }

    /// The guide `then` with a step aside before it: the features shifted, turned and shrunk at
    /// random.
    fn aside(&self, then: Guide, number: u64) -> Guide {
        let task = self.policy.task;
        let points = &self.initial.points;
        let [u, v, turn, size] = [1, 2, 3, 4].map(|k| uniform_of(number, k));
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

    /// A simulation of a candidate before its first step.
    fn begun(&self, candidate: Guide) -> Suspended {
        Suspended {
            candidate,
            guide: candidate,
            is_incumbent: false,
            known: 0,
            points: self.initial.points.as_slice().into(),
            tilt: self.initial.tilt,
            drift: self.initial.drift,
            q: self.initial.q.map(Into::into),
            standing: *self.standing,
            previous: *self.previous,
            is_from_front: gate::is_from_front(self.policy.task, &self.initial.points),
            step: 0,
            cost: 0.0,
            nearest_px: f64::INFINITY,
            idle: 0,
            blind_s: self.blind_s,
            since: 0.0,
            spent: 0.0,
            path: Path::NONE,
        }
    }

    /// Simulates the law under a guide until its future is known, at a cost of at most `most` from
    /// now on, or until the budget is used up.
    fn roll_out(&mut self, mut now: Suspended, most: f64) -> RollOut {
        let crossing = self.crossing.filter(|_| now.candidate.crosses);
        let policy = Policy {
            task: crossing.map_or(self.policy.task, |crossing| &crossing.task),
            ..self.policy
        };
        let Policy { task, settings } = policy;
        let mut initial = match now.step {
            0 => self.initial.clone(),
            _ => {
                let points = now.points.get().unwrap_or_default();
                InitialState::turned(task, settings.model, &points, now.tilt.as_ref())
                    .with_drift(now.drift)
                    .with_joints(now.q.map(Into::into))
            }
        };
        // Costs are counted by the period.
        let share = task.ts / task.period / settings.np as f64;
        let ended = |now: &Suspended, outcome| {
            RollOut::Ended(Future {
                guide: now.candidate,
                outcome,
                path: now.path,
            })
        };
        while now.step < self.horizon {
            // Every candidate takes at least one step, so that a cycle ends.
            if self.budget == 0 {
                now.points = initial.points.as_slice().into();
                (now.tilt, now.drift) = (initial.tilt, initial.drift);
                now.q = initial.q.map(Into::into);
                return RollOut::Suspended(now);
            }
            // Where the camera would look from the side, the features are soon refused.
            let is_known = now.step < now.known;
            if now.is_from_front && !is_known && !gate::is_from_front(task, &initial.points) {
                return ended(&now, Outcome::Unknown);
            }
            if crossing.is_some() {
                let is_hidden = crossing::is_hidden(self.policy.task, &initial);
                now.blind_s = match is_hidden {
                    true => now.blind_s + task.ts,
                    false => (now.blind_s - blind::REFILL * task.ts).max(0.0),
                };
                if now.blind_s > self.most_blind_s {
                    return ended(&now, Outcome::Unknown);
                }
            }
            now.path.note(now.step, &initial.points);
            let error_px = features::largest_error(&initial.points, &task.goal);
            if error_px < FAR * self.converged_px && now.guide.kind != Kind::Joints {
                now.guide = now.guide.direct();
            }
            if error_px < PROGRESS * now.nearest_px {
                (now.nearest_px, now.idle) = (error_px, 0);
            } else if now.guide.ahead == 0 {
                now.idle += 1;
            }
            // The last pixels take longer.
            let patience = match error_px < NEAR * self.converged_px {
                true => LAST * PATIENCE,
                false => PATIENCE,
            };
            if now.idle > patience && !is_known {
                break;
            }
            if error_px < self.converged_px {
                let (cost, steps) = (now.cost - now.spent, f64::from(now.step) - now.since);
                return ended(&now, Outcome::Arrives { cost, steps });
            }
            self.budget -= 1;
            self.simulated += 1;
            let towards = now.guide.posture(self.path);
            let dampers = task.dampers(initial.q.as_ref(), task.ts, towards);
            let at = At {
                task,
                points: &initial.points,
                q: initial.q.as_ref(),
                path: self.path,
            };
            let way = match now.guide.way == self.way.number {
                true => &*self.way,
                false => &self.draft.way,
            };
            let wanted = now.guide.follow(&at, way, &initial.drift.twist, 1.0);
            let tracked = match wanted {
                Some(_) => None,
                None => now.guide.advance(&at, self.converged_px, 1.0),
            };
            let aim = tracked.as_ref().unwrap_or(&task.goal);
            let present = Present {
                initial: &initial,
                standing: &now.standing,
                interval: task.ts,
                warm: &now.previous,
                extra_px: self.extra_px,
                dampers: dampers.as_ref(),
                view: None,
                wanted,
            };
            let (twist, solution) = policy.command(self.solver, &present, aim, aim);
            let is_to_goal = now.guide.ahead == 0 && towards.is_none() && wanted.is_none();
            let is_counted = is_to_goal && settings.nc == 1 && !task.brakes();
            let cost = match is_counted && solution.sends(&twist) {
                // The solver has summed it up already.
                true => solution.cost,
                false => policy.running_cost(self.solver, &initial, &twist),
            };
            if self.done() >= self.most_work {
                self.budget = 0;
            }
            self.record(now.step as usize, &initial.relative(&twist));
            now.cost += share * cost;
            if now.cost - now.spent > most {
                return ended(&now, Outcome::Unknown);
            }
            (now.previous, now.standing) = (solution.warm(&twist), twist);
            now.step += 1;
            initial.elbow = dampers.map_or(0.0, |dampers| dampers.elbow(&twist));
            match initial.moved(task, settings.model, &twist, task.ts) {
                Some(next) => initial = next,
                None => return ended(&now, Outcome::Unknown),
            }
        }
        let error_px = now.nearest_px;
        ended(&now, Outcome::Nears { error_px })
    }
}

/// The course of ways that begin at `initial`, with so much more clearance than by the settings;
/// `None` where the pattern's pose is not known.
fn course<'a>(policy: &Policy<'a>, initial: &InitialState, extra_px: f64) -> Option<Course<'a>> {
    let Policy { task, settings } = *policy;
    let start = pattern(initial, task)?;
    let drift = Vector6::from(initial.drift.twist);
    let limits = Vector6::from(task.limits);
    Some(Course {
        task,
        start,
        bounds: [-limits - drift, limits - drift].map(Into::into),
        np: settings.np,
        steps: COMMANDS,
        margin_px: settings.margin_px + extra_px,
        barrier: Barrier::NONE,
        damping: 0.0,
    })
}

/// Where the pattern is in the camera frame; `None` where its pose is not known.
fn pattern(initial: &InitialState, task: &Task) -> Option<Motion> {
    let pose = initial.pose(task)?;
    Some(Motion {
        rotation: pose.rotation,
        translation: pose.translation,
    })
}

#[cfg(test)]
mod tests {
    use scene::Scene;

    use super::*;
    use crate::{Law, Measurement, Settings, Task};

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
        jump(60);
    }

    #[test]
    #[ignore = "long: 300 cycles"]
    fn each_of_many_cycles_ends_within_its_budget_wherever_the_camera_jumps() {
        jump(300);
    }

    fn jump(cycles: u32) {
        let scene = Scene::parse(scene::PAPER_SIM, "sim").unwrap();
        let memory = Shifted(Task::new(&scene).unwrap().goal);
        let settings = Settings {
            strategy: Strategy::Foresight,
            ..Settings::default()
        };
        let mut law = Law::new(&scene, settings, |len| vec![0.0; len]).unwrap();
        let mut arrived = 0;
        for k in 0..u64::from(cycles) {
            // Now and then somewhere else, so that what was promised is wrong.
            let [x, y, z] = [0, 1, 2].map(|axis| uniform_of(k / 4, axis) - 0.5);
            let mut pose = scene.goal;
            pose.translation = [0.5 * x, 0.5 * y, 0.9 + 0.5 * z];
            let points = law.task().features_at(&pose).unwrap();
            let now_ns = k * 33_333_333;
            let measured = Measurement::from_points(&points).taken(now_ns, now_ns);
            if let Ok(step) = law.step(&measured, Some(&memory)) {
                law.sent(&step.twist, now_ns);
                law.think(Some(&memory));
                let foreseen = law.foreseen();
                assert!(foreseen.simulated <= law.foreseen_steps());
                assert!(foreseen.tried <= law.foreseen_steps());
                arrived += u32::from(matches!(foreseen.outcome, Outcome::Arrives { .. }));
            }
        }
        assert!(arrived > cycles / 3, "{arrived}");
    }

    #[test]
    fn a_path_keeps_places_at_equal_intervals_however_long_it_is() {
        for length in [1, 7, 8, 9, 100, 1000] {
            let mut path = Path::NONE;
            for step in 0..length {
                path.note(step, &[[f64::from(step), 1.0]; 4]);
            }
            assert!(path.count >= length.min(PLACES as u32 / 2) && path.points == 4);
            for (place, points) in path.places.iter().enumerate().take(path.count as usize) {
                assert_eq!(points[3], [(place as u32 * path.every) as f32, 1.0]);
            }
            assert!(path.count * path.every >= length, "{length}");
        }
    }
}
