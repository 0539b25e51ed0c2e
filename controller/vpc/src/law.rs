//! The law, one cycle at a time.

use ::arm::{Dampers, Joints};
use scene::Scene;

use crate::arm::{Cause, Posture};
use crate::blind::Blind;
use crate::command::{Policy, Present};
use crate::crossing::{self, Crossing};
use crate::delay::{History, Unpredictable};
use crate::drift::{Drift, Elapsed, Evidence};
use crate::features::{self, PlainPoints};
use crate::follow::Follow;
use crate::foresight::{FAR, Foresight, Thinker};
use crate::guide::{At, Guide, Kind};
use crate::joint_path::{self, Planner};
use crate::measurement::{Measurement, Refusal};
use crate::motion::Own;
use crate::patience::Patience;
use crate::pose::Tilt;
use crate::prediction::{InitialState, Plan, repeated};
use crate::problem::{Solution, Status};
use crate::recall::{self, Asked, MotionMemory, Recall};
use crate::refine::{self, Refiner};
use crate::settings::{Settings, SettingsError};
use crate::solver::{Size, Solver};
use crate::state::State;
use crate::strategy::Strategy;
use crate::task::{Task, TaskError};
use crate::view::View;
use crate::way::Way;
use crate::work::Prices;
use crate::{DOF, MAX_VARIABLES, Points, Twist, arm, blind, follow, frozen, gate, ibvs, limit};

/// What a step proposed.
#[derive(Clone, Copy)]
struct Proposed {
    /// The twist against the pattern, which moves at `drift`.
    relative: Twist,
    drift: Twist,
    /// The share of the twist that was sent.
    share: f64,
    /// What foresight followed before the step, and follows after it.
    before: Guide,
    after: Guide,
    /// Steps by which the twist goes on along a refined way.
    steps: f64,
    /// l(v) / Np of the step.
    spent: f64,
}

impl Proposed {
    /// The share of the twist that `sent` has in its direction, each component by its limit: 0 to
    /// 1.
    fn share_of(&self, sent: &Twist, limits: &Twist) -> f64 {
        let sent = minus(sent, &self.drift);
        if self.relative == sent {
            return 1.0;
        }
        let along = |to: &Twist| -> f64 {
            let pairs = self.relative.iter().zip(to).zip(limits);
            pairs.map(|((a, b), limit)| a * b / (limit * limit)).sum()
        };
        let whole = along(&self.relative);
        match whole > 0.0 {
            true => (along(&sent) / whole).clamp(0.0, 1.0),
            false => 0.0,
        }
    }

    /// What foresight follows, where that share was sent: a sub-goal passes as soon as the camera
    /// moves, a refined way by the share.
    fn guide(&self, task: &Task, way: &Way) -> Guide {
        let is_part = self.share < 1.0 && self.before.kind == Kind::Refined;
        let mut guide = match is_part || self.share == 0.0 {
            true => self.before,
            false => return self.after,
        };
        guide.go_on(task, way, self.share * self.steps);
        guide
    }
}

/// The visual predictive control law: task, settings, what one cycle leaves to the next (together
/// some 50 KB), and the solver's workspace `W`, which the caller owns or lends: a `Vec<f64>`, or a
/// `&mut [f64]` where there is no heap.
#[derive(Clone)]
pub struct Law<W> {
    task: Task,
    /// Of a scene with a crossable occlusion.
    crossing: Option<Crossing>,
    settings: Settings,
    off_image_px: f64,
    converged_px: f64,
    workspace: W,
    state: State,
    /// The initial state of this cycle's preview, until [`Law::think`] takes it.
    root: Option<InitialState>,
    /// What the step of this cycle proposed, until [`Law::think`] takes it.
    proposed: Option<Proposed>,
    /// Whether this cycle has thought before its command.
    has_thought: bool,
    /// Time from the last exposure to the command that answers it, s.
    lead_s: f64,
    /// What another program wants, for [`Strategy::Follow`].
    wanted: Option<Twist>,
    /// The work that the law may do in a cycle.
    share: Share,
    /// Most steps of a future.
    horizon: u32,
}

/// Share of the period for the longest decision.
const DECIDING: f64 = 0.25;
/// Share of the period for foresight. With [`DECIDING`] it leaves half of the period free, so that
/// a processor may take twice as long as the counted work says.
const THINKING: f64 = 0.2;
/// A window is refused if the period has no room for this many iterations of a solution.
const FEWEST_ITERATIONS: u32 = 3;
/// A window is refused if the period has no room for this many simulated steps of foresight.
const FEWEST_STEPS: u32 = 10;
/// A future is at most this share of the scene's time long.
const HORIZON: f64 = 0.5;

/// Cycles without a way after which a path in the arm's joints is searched for.
const LOST: u32 = 15;

/// Older positions of an arm's joints say nothing of now, ns.
const OLDEST_JOINTS_NS: u64 = 500_000_000;

/// Deviations that points keep clear of every border: those of a hidden point, and those by what is
/// not known of the pattern's motion, of which no more than so many px count.
const BACK_OFF: f64 = 2.0;
const MOST_UNKNOWN_PX: f64 = 16.0;
/// Clearance that [`Strategy::Follow`] keeps beside that of other strategies, px: above what the
/// last check allows and what the way of a braking camera misses.
const SPARE_PX: f64 = 0.5;

/// What one cycle decided.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Step {
    /// The camera twist to send.
    pub twist: Twist,
    /// Whether the camera only brakes and stands, because no way is known and nothing has improved
    /// ([`crate::patience`]).
    pub stands: bool,
    /// What of the arm binds the twist, where the arm is known.
    pub cause: Option<Cause>,
    /// The velocity of the arm's elbow to send, rad/s: of joint 3 of seven, where it is not held.
    pub elbow: f64,
    /// How the solver ended.
    pub status: Status,
    /// Whether the memory was asked, and whether its answer was used.
    pub asked: Asked,
    /// The way point tracked instead of the goal, px.
    pub way_point: Option<Points>,
    /// Iterations of the solver.
    pub iterations: u32,
    /// Active-set changes in its quadratic programs.
    pub qp_iterations: u32,
    /// Counted [work](crate::work) of the solver.
    pub work: u32,
    /// The paper's running cost l(v) of the command that is sent, against the goal.
    pub cost: f64,
    /// Worst violation predicted over the window, px.
    pub violation_px: f64,
    /// Least clearance of a marker's edge (of a feature, where markers are points) from an
    /// occlusion, px; of the features at the command's effect.
    pub clearance_px: f64,
    /// Largest component of s - s*, px; of the features at the command's effect.
    pub error_px: f64,
}

impl Step {
    /// Takes in how the solver ended.
    fn tell(&mut self, solution: &Solution) {
        self.status = solution.status;
        self.iterations = solution.iterations;
        self.qp_iterations = solution.qp_iterations;
        self.work = solution.work;
        self.violation_px = solution.violation_px;
    }
}

impl<W: AsRef<[f64]> + AsMut<[f64]>> Law<W> {
    /// The law for a scene. `lend` receives how many numbers of workspace this problem takes
    /// (6,000 in the paper's scene, 60,000 at most), and returns at least that many, of any value.
    ///
    /// # Errors
    /// [`SettingsError`] if a setting is out of range, the goal of the scene cannot be seen, or the
    /// workspace is too short.
    pub fn new(
        scene: &Scene,
        settings: Settings,
        lend: impl FnOnce(usize) -> W,
    ) -> Result<Self, SettingsError> {
        settings.check()?;
        // Apart: their frames would not fit on a small stack together where nothing is optimized.
        Self::of(task(scene, &settings)?, scene, settings, lend)
    }

    fn of(
        task: Task,
        scene: &Scene,
        settings: Settings,
        lend: impl FnOnce(usize) -> W,
    ) -> Result<Self, SettingsError> {
        let horizon = libm::ceil(HORIZON * scene.success.time_s / task.ts);
        let share = Share::of(&task, &settings)?;
        let planner = task.arm.as_ref().map_or(0, |_| joint_path::ROOM);
        let needed = (share.size.workspace() + refine::ROOM).max(planner);
        let workspace = lend(needed);
        let found = workspace.as_ref().len();
        if found < needed {
            return Err(SettingsError::Workspace { found, needed });
        }
        Ok(Self {
            off_image_px: scene.success.violation_px,
            converged_px: scene.success.convergence_px,
            workspace,
            // A constant, for a small stack; the strategy in use is that of the settings.
            state: const { State::new(Strategy::Foresight) },
            settings,
            root: None,
            proposed: None,
            has_thought: false,
            lead_s: 0.0,
            wanted: None,
            share,
            horizon: horizon.max(1.0) as u32,
            crossing: Crossing::of(scene, &task),
            task,
        })
    }

    /// From now on this law steers a robot in real time: each command is obeyed for at most
    /// `validity_ns`, and what moved the camera before the first is unknown. Without this call,
    /// time is simulated: the camera stands still before the first command and obeys each until the
    /// next.
    pub fn go_live(&mut self, validity_ns: u64) {
        self.state.history = History::live(validity_ns);
    }

    /// Forgets the commands sent so far: delayed features are refused until enough new commands are
    /// known.
    pub fn forget_sent(&mut self) {
        self.state.history.forget();
    }

    /// Records that `twist` was really sent at `at_ns`, also a zero, repeated or braking one that
    /// the law did not choose; before [`Law::think`].
    pub fn sent(&mut self, twist: &Twist, at_ns: u64) {
        self.state.history.push(twist, at_ns);
        self.state.standing = *twist;
        self.stay_behind(twist);
        // In simulated time there are no instants to predict the next image by.
        if !self.state.history.is_live()
            && let Some(root) = self.root.clone()
        {
            self.predict(&root, twist);
        }
    }

    /// Where another twist was sent than the law's, the camera comes no further on its way than
    /// that brings it.
    fn stay_behind(&mut self, sent: &Twist) {
        let Some(proposed) = &mut self.proposed else {
            return;
        };
        proposed.share = proposed.share_of(sent, &self.task.limits);
        self.state.foresight.guide = proposed.guide(&self.task, &self.state.way);
    }

    /// Records that the last command left only at `at_ns`, because the decision took that long.
    pub fn sent_late(&mut self, at_ns: u64) {
        self.state.history.postpone(at_ns);
    }

    /// Records the velocity of the arm's elbow that was sent with the last command, rad/s.
    pub fn sent_elbow(&mut self, elbow: f64) {
        self.state.elbow = elbow;
    }

    /// The camera twist that another program wants in the next steps with [`Strategy::Follow`]
    /// (camera frame, m/s and rad/s). `None`, and one that is not finite, brakes.
    pub fn want(&mut self, wanted: Option<Twist>) {
        self.wanted = wanted.filter(|twist| twist.iter().all(|v| v.is_finite()));
    }

    /// Takes the positions of the arm's joints at an instant, base to flange, rad or m; only in a
    /// scene with an arm. Without those of every joint, or with old ones, features are refused.
    pub fn see_joints(&mut self, q: &[f64], at_ns: u64) {
        let arm = self.task.arm.as_ref();
        let is_whole = arm.is_some_and(|arm| arm.chain.count() == q.len());
        self.state.joints = is_whole.then(|| Posture::new(q, at_ns));
    }

    /// Runs foresight in the spare time of a cycle, after its command was sent.
    pub fn think(&mut self, memory: Option<&dyn MotionMemory>) {
        let (passed, spent) = self.passed();
        if core::mem::take(&mut self.has_thought) {
            self.root = None;
            self.state.draft.discard();
            return self.state.foresight.pass(&self.task, passed, spent);
        }
        // What a cycle without features or another strategy leaves is no work of its own.
        let idle = &mut self.state.foresight;
        (idle.tried, idle.simulated, idle.work) = (0, 0, 0);
        let Some(root) = self.root.take() else { return };
        if self.settings.strategy != Strategy::Foresight {
            return;
        }
        let (model, period) = (self.settings.model, self.task.period);
        let Some(next) = root.moved(&self.task, model, &self.state.standing, period) else {
            return;
        };
        let extra_px = self.back_off_px(&root);
        if self.seeks_path(&next) {
            self.state.foresight.pass(&self.task, passed, spent);
            return self.seek_path(&next, extra_px);
        }
        let most_s = |_: &Crossing| {
            let drift = &self.state.drift;
            crossing::most_s(&self.task, &self.settings, &root, drift)
        };
        let most_blind_s = self.crossing.as_ref().map_or(0.0, most_s);
        let blind_s = self.lead_s + self.state.blind.spent_s;
        let (room, rest) = self.workspace.as_mut().split_at_mut(refine::ROOM);
        let Some(solver) = &mut self.share.solver(&self.settings, rest) else {
            return;
        };
        let mut thinker = Thinker {
            policy: Policy {
                task: &self.task,
                settings: &self.settings,
            },
            solver,
            memory,
            path: &self.state.path,
            way: &mut self.state.way,
            draft: &mut self.state.draft,
            refiner: Refiner::new(self.share.size, room),
            crossing: self.crossing.as_ref(),
            most_blind_s,
            blind_s,
            lead_s: self.lead_s,
            initial: &next,
            standing: &self.state.standing,
            previous: &self.state.previous,
            extra_px,
            passed,
            spent,
            converged_px: self.converged_px,
            horizon: self.horizon,
            whole: self.share.steps,
            budget: self.share.steps,
            most_work: self.share.thinking,
            simulated: 0,
            recorded: 0,
            searched: 0,
        };
        thinker.think(&mut self.state.foresight);
    }

    /// Whether this cycle's spare time goes to the search for a path in the arm's joints: every
    /// second cycle where no way has been known for some.
    fn seeks_path(&self, next: &InitialState) -> bool {
        let foresight = &self.state.foresight;
        self.task.arm.is_some()
            && next.drift.is_none()
            && foresight.lost >= LOST
            && !foresight.needs_path()
            && !foresight.knows_a_way()
    }

    /// Searches for a path in the arm's joints.
    fn seek_path(&mut self, next: &InitialState, extra_px: f64) {
        let margin_px = self.settings.margin_px + extra_px;
        let (number, work) = (self.state.searches, self.share.thinking);
        self.state.searches = number.wrapping_add(1);
        let planner = Planner::new(&self.task, next, margin_px, number.into(), work);
        let Some(mut planner) = planner else { return };
        let found = planner.search(self.workspace.as_mut());
        let foresight = &mut self.state.foresight;
        foresight.work = work - planner.left();
        // Foresight has the next cycle.
        foresight.lost -= 1;
        if let Some(path) = found {
            self.state.path = path;
            foresight.has_new_path = true;
        }
    }

    /// The incumbent of foresight, and its expected outcome.
    pub fn foreseen(&self) -> &Foresight {
        &self.state.foresight
    }

    /// Most steps that foresight simulates in a cycle.
    pub fn foreseen_steps(&self) -> u32 {
        self.share.steps
    }

    /// Camera, pattern, goal, limits, occlusions.
    pub fn task(&self) -> &Task {
        &self.task
    }

    /// The settings in use.
    pub fn settings(&self) -> &Settings {
        &self.settings
    }

    /// What the last cycle left to the next. A copy; never allocates.
    pub fn state(&self) -> State {
        State {
            strategy: self.settings.strategy,
            ..self.state
        }
    }

    /// Continues from a state of this law, or of another one of the same task and settings.
    pub fn restore(&mut self, state: &State) {
        self.settings.strategy = state.strategy;
        self.state = *state;
        (self.root, self.proposed, self.has_thought) = (None, None, false);
    }

    /// Where the points of a live robot's camera are expected in an exposure at `exposed_ns`, px;
    /// `None` if they were not seen before, or the commands since then are unknown.
    pub fn expected(&self, exposed_ns: u64) -> Option<Points> {
        self.expected_since(exposed_ns, self.state.drift.believed)
            .map(|(points, _)| points)
    }

    /// The points of the last image that was believed, with those that it did not show, px.
    pub fn seen(&self) -> Option<Points> {
        self.state.seen.get()
    }

    /// How well the points are known that the last image did not show.
    pub fn blind(&self) -> &Blind {
        &self.state.blind
    }

    /// The mean command in force between two instants; zero where none is known.
    pub fn commanded_between(&self, from_ns: u64, to_ns: u64) -> Twist {
        self.state.history.mean(from_ns, to_ns)
    }

    /// The command that was sent last.
    pub fn standing(&self) -> &Twist {
        &self.state.standing
    }

    /// The pattern's own motion as it is believed, camera frame, m/s and rad/s.
    pub fn drift(&self) -> &Twist {
        &self.state.drift.believed.twist
    }

    /// Changes the strategy from the next cycle on; what earlier cycles left stays.
    ///
    /// # Errors
    /// [`SettingsError`] if the neighbours of k-NN are out of range; nothing changes then.
    pub fn set_strategy(&mut self, strategy: Strategy) -> Result<(), SettingsError> {
        let settings = Settings {
            strategy,
            ..self.settings
        };
        settings.check()?;
        self.settings = settings;
        Ok(())
    }

    /// Forgets everything of earlier cycles, for a new run. Of a live robot the commands stay
    /// known, for it executed them, and so does what was seen: its camera began again, and sees the
    /// same object.
    pub fn reset(&mut self) {
        self.root = None;
        let before = self.state;
        let new = State::new(self.settings.strategy);
        self.state = match before.history.is_live() {
            false => State {
                joints: before.joints,
                ..new
            },
            true => State {
                standing: before.standing,
                seen: before.seen,
                filtered: before.filtered,
                tilt: before.tilt,
                seen_ns: before.seen_ns,
                still_px: before.still_px,
                blind: before.blind,
                joints: before.joints,
                follow: before.follow,
                history: before.history,
                ..new
            },
        };
    }

    /// Forgets the last image: the next features are not compared with earlier ones.
    pub fn lose_sight(&mut self) {
        (self.state.seen, self.state.filtered) = (PlainPoints::NONE, PlainPoints::NONE);
        self.state.tilt = None;
        self.state.seen_ns = 0;
        self.state.still_px = 0.0;
        self.state.drift = Drift::NONE;
        self.state.follow = Follow::NEW;
    }

    /// Forgets the recent commands and images while a robot reports that it obeys no commands.
    pub fn expect_no_motion(&mut self) {
        self.state.follow = Follow::NEW;
    }

    /// Restores the patience, at an operator's request: the law tries again.
    pub fn be_patient(&mut self) {
        self.state.patience = Patience::NEW;
    }

    /// Forgets the prediction for this cycle, where the last command was not in force for one
    /// sampling time (a dropped frame, a skipped period): the mismatch would not be the model's.
    pub fn skip_mismatch(&mut self) {
        (self.state.predicted, self.state.predicted_tilt) = (PlainPoints::NONE, None);
        self.state.is_linked = false;
    }

    /// One cycle: measured features in, camera twist out. Never allocates; its work is bounded.
    ///
    /// # Errors
    /// [`Refusal`] if the features cannot be trusted: send the zero twist.
    pub fn step(
        &mut self,
        measurement: &Measurement,
        memory: Option<&dyn MotionMemory>,
    ) -> Result<Step, Refusal> {
        (self.root, self.proposed, self.has_thought) = (None, None, false);
        let is_linked = self.state.is_linked;
        let (initial, mismatch) = self.receive(measurement).inspect_err(|_| {
            self.skip_mismatch();
            self.state.previous = [0.0; MAX_VARIABLES];
        })?;
        self.think_first(&initial, memory);
        Ok(self.answer(initial, mismatch.as_ref(), is_linked, memory))
    }

    /// The command for a cycle without an image, that takes effect at `effective_ns`: the answer to
    /// the prediction. `None` if the commands since the last image are not known.
    pub fn coast(&mut self, effective_ns: u64, memory: Option<&dyn MotionMemory>) -> Option<Step> {
        (self.root, self.proposed, self.has_thought) = (None, None, false);
        let mut initial = self.state_at(effective_ns, self.state.drift.believed)?;
        initial.drift.rate = [0.0; DOF];
        initial.q = self.joints_at(effective_ns);
        if self.task.arm.is_some() && initial.q.is_none() {
            return None;
        }
        self.lead_s = effective_ns.saturating_sub(self.state.seen_ns) as f64 * 1e-9;
        let step = self.answer(initial, None, false, memory);
        // The next image is compared with the last one.
        self.skip_mismatch();
        Some(step)
    }

    /// Thinks before the first command of a run, which has no earlier thought to follow.
    fn think_first(&mut self, initial: &InitialState, memory: Option<&dyn MotionMemory>) {
        let is_foresight = self.settings.strategy == Strategy::Foresight;
        if is_foresight && self.state.foresight.drafted == 0 {
            self.root = Some(initial.clone());
            self.think(memory);
            self.has_thought = true;
        }
    }

    /// The command in answer to where the features are.
    fn answer(
        &mut self,
        initial: InitialState,
        mismatch: Option<&Points>,
        is_linked: bool,
        memory: Option<&dyn MotionMemory>,
    ) -> Step {
        let points = &initial.points;
        let clearance_px = recall::clearance(&self.task, &initial);
        let mut step = Step {
            clearance_px,
            error_px: features::largest_error(points, &self.task.goal),
            ..Step::default()
        };
        let seconds = match self.settings.strategy {
            // It does not look ahead: what is left must do for a stop.
            Strategy::Ibvs => self.task.reach,
            _ => self.task.period,
        };
        let is_foresight = self.settings.strategy == Strategy::Foresight;
        let mut steps = 0.0;
        let before = self.state.foresight.guide;
        let guide = Some(&self.state.foresight.guide).filter(|_| is_foresight);
        let towards = guide.and_then(|guide| guide.posture(&self.state.path));
        let dampers = self.task.dampers(initial.q.as_ref(), seconds, towards);
        let dampers = dampers.as_ref();
        let stands = is_foresight && self.loses_patience(dampers, step.error_px, is_linked);
        match self.settings.strategy {
            Strategy::Ibvs => self.servo(&initial, dampers, &mut step),
            Strategy::Follow => self.guard(&initial, dampers, &mut step),
            Strategy::Foresight if stands => {
                let (task, standing) = (&self.task, &self.state.standing);
                step.stands = true;
                step.twist = limit::approach(&[0.0; DOF], standing, task, task.period);
                self.state.previous = repeated(&step.twist);
            }
            Strategy::Foresight => {
                let certainty = self.certainty();
                let guide = &mut self.state.foresight.guide;
                let at = At {
                    task: &self.task,
                    points,
                    q: initial.q.as_ref(),
                    path: &self.state.path,
                };
                let whole = self.task.period / self.task.ts;
                let drift = &initial.drift.twist;
                // Along a way, time passes as slowly as the camera goes.
                let wanted = guide.follow(&at, &self.state.way, drift, certainty * whole);
                let tracked = match wanted {
                    Some(_) => None,
                    None => guide.advance(&at, self.converged_px, whole),
                };
                if wanted.is_some() {
                    steps = certainty * whole;
                }
                if tracked.is_some() && guide.kind.is_remembered() {
                    step.asked = Asked::Followed;
                }
                let warm = self.state.previous;
                let towards = Towards { tracked, wanted };
                self.plan(&initial, dampers, &warm, towards, mismatch, &mut step);
            }
            Strategy::Previous | Strategy::Knn { .. } | Strategy::Gpr => {
                let (recall, asked) = self.recall(points, clearance_px, memory);
                step.asked = asked;
                // The memory knows of twists against a pattern at rest.
                let against = |recall: &Recall| sum(&recall.twist, &initial.drift.twist);
                let warm = recall.as_ref().map(|recall| repeated(&against(recall)));
                let warm = warm.unwrap_or(self.state.previous);
                let tracked = recall.map(|recall| recall.way_point);
                let towards = Towards {
                    tracked,
                    wanted: None,
                };
                self.plan(&initial, dampers, &warm, towards, mismatch, &mut step);
            }
        }
        step.twist = self.slowed(&initial, dampers, &step.twist);
        step.cause = arm::cause(dampers, &step.twist, &self.task.limits);
        // An arm that stands moves no elbow, either.
        let turning = dampers.filter(|_| !step.stands);
        step.elbow = turning.map_or(0.0, |dampers| dampers.elbow(&step.twist));
        self.predict(&initial, &step.twist);
        let policy = Policy {
            task: &self.task,
            settings: &self.settings,
        };
        let solver = self.share.solver(&self.settings, self.workspace.as_mut());
        debug_assert!(solver.is_some(), "a workspace that holds no solver");
        step.cost = solver.map_or(0.0, |mut solver| {
            policy.running_cost(&mut solver, &initial, &step.twist)
        });
        let drift = initial.drift.twist;
        self.root = Some(initial.with_elbow(step.elbow));
        self.proposed = Some(Proposed {
            relative: minus(&step.twist, &drift),
            drift,
            share: 1.0,
            before,
            after: self.state.foresight.guide,
            steps,
            spent: step.cost / self.settings.np as f64,
        });
        step
    }

    /// Steps by which the camera comes further on its way in this period, and l(v) / Np of these;
    /// none before a command.
    fn passed(&mut self) -> (f64, f64) {
        let steps = self.task.period / self.task.ts;
        (self.proposed.take()).map_or((0.0, 0.0), |proposed| {
            (proposed.share * steps, proposed.share * proposed.spent)
        })
    }

    /// Whether the camera is to stand, because no way is known and nothing has improved. What
    /// another twist than the law's did does not count. Near the goal there is hope, unless the
    /// arm goes no farther.
    fn loses_patience(
        &mut self,
        dampers: Option<&Dampers>,
        error_px: f64,
        is_linked: bool,
    ) -> bool {
        let is_near = error_px < FAR * self.converged_px;
        let is_held_up = is_near
            && error_px >= self.converged_px
            && arm::cause(dampers, &self.state.standing, &self.task.limits).is_some();
        let State {
            foresight,
            patience,
            ..
        } = &mut self.state;
        let has_hope = foresight.knows_a_way() || (is_near && !is_held_up);
        if is_linked || has_hope {
            patience.pass(error_px, has_hope, self.task.period);
        }
        patience.is_over()
    }

    /// Where the preview starts: the features that pass all checks, filtered, and advanced to the
    /// command's effect; and without a filter the mismatch eps.
    fn receive(
        &mut self,
        measurement: &Measurement,
    ) -> Result<(InitialState, Option<Points>), Refusal> {
        let completed;
        let is_whole = measurement.is_whole();
        let (period, most_s) = (self.task.period, self.settings.blind_s);
        self.state.blind.count(measurement, period, most_s);
        let (measurement, blind) = match is_whole {
            true if self.state.blind.is_spent => return Err(self.hidden(&self.state.blind)),
            true => (measurement, self.state.blind.whole()),
            false => {
                let (whole, blind) = self.completed(measurement)?;
                completed = whole;
                (&completed, blind)
            }
        };
        let points = gate::pass(&self.task, measurement, self.off_image_px)?;
        let (exposed_ns, age_ns) = (measurement.exposed_ns, measurement.age_ns());
        let (expected, tilt) = self.expected_at_exposure(exposed_ns, age_ns).unzip();
        let tilt = tilt.flatten().or(self.state.tilt);
        let is_live = self.state.history.is_live();
        let commanded = self.commanded(expected.as_ref(), exposed_ns);
        let is_steady = match is_live && measurement.visible != 0 {
            true => self.check_motion(points, expected.as_ref(), commanded.as_ref(), exposed_ns)?,
            false => self.is_steady(points, expected.as_ref(), exposed_ns),
        };
        let is_telling = is_steady && self.is_continuous(exposed_ns);
        let before = self.state.filtered.get();
        let kept = expected
            .as_ref()
            .map_or(0.0, |expected| self.kept(points, expected));
        let filtered = match &expected {
            Some(expected) => mixed(points, expected, kept),
            None => points.clone(),
        };
        let model = self.settings.model;
        let mut measured = InitialState::turned(&self.task, model, &filtered, tilt.as_ref());
        if let Some(expected) = &expected {
            let (seconds, command) = match age_ns == 0 && !is_live {
                // What was expected is one period later, whatever the stamps say.
                true => (self.task.period, self.state.standing),
                false => self.since(exposed_ns),
            };
            let elapsed = Elapsed {
                at: &measured,
                seconds,
                command: &command,
            };
            let evidence = Evidence {
                seen: points,
                expected,
                visible: measurement.visible,
                is_telling,
                kept,
            };
            self.state.drift.learn(&self.task, &elapsed, &evidence);
            if !self.settings.drift_compensation {
                self.state.drift.stand();
            }
        }
        measured.drift = self.state.drift.believed;
        let tilt = measured.tilt;
        match (&before, &commanded) {
            (Some(from), Some(to)) if is_live => {
                let follow = &mut self.state.follow;
                let added = follow.add(&self.task, &measured, [from, to], exposed_ns, is_whole);
                added.inspect_err(|_| self.lose_sight())?;
            }
            _ => self.state.follow = Follow::NEW,
        }
        let is_unfiltered = self.settings.filter_s == 0.0 && self.state.is_linked;
        let mismatch = expected.filter(|_| is_unfiltered);
        let mismatch = mismatch.map(|expected| difference(points, &expected));
        let mut initial = if age_ns == 0 || !self.settings.delay_compensation {
            measured
        } else {
            let advanced = self.advance(&measured, exposed_ns, measurement.effective_ns);
            advanced.map_err(|reason| match reason {
                Unpredictable::Unknown { known_ns } => Refusal::Late { age_ns, known_ns },
                Unpredictable::Lost => Refusal::Lost,
            })?
        };
        initial.q = self.joints_at(measurement.effective_ns);
        if self.task.arm.is_some() && initial.q.is_none() {
            return Err(Refusal::NoJoints);
        }
        // A future is simulated with the motion in the middle of the next period.
        initial.drift = Own {
            rate: [0.0; DOF],
            ..initial.drift.after(0.5 * self.task.period)
        };
        self.state.seen = points.as_slice().into();
        self.state.filtered = filtered.as_slice().into();
        (self.state.tilt, self.state.blind) = (tilt, blind);
        self.state.seen_ns = exposed_ns;
        self.lead_s = age_ns as f64 * 1e-9;
        self.state.is_linked = true;
        Ok((initial, mismatch))
    }

    /// The joints at this instant, by the commands since they were seen.
    fn joints_at(&self, at_ns: u64) -> Option<Joints> {
        let Posture { q, at_ns: seen_ns } = self.state.joints?;
        let q = Joints::from(q);
        if seen_ns >= at_ns {
            return Some(q);
        }
        if at_ns - seen_ns > OLDEST_JOINTS_NS {
            return None;
        }
        let mean = self.state.history.mean(seen_ns, at_ns);
        let seconds = (at_ns - seen_ns) as f64 * 1e-9;
        let elbow = self.state.elbow;
        arm::moved(self.task.arm.as_ref(), Some(&q), &mean, elbow, seconds)
    }

    /// The share of the expected features that stays in those to steer by. None of these is further
    /// from the measured one than the settings say, so that a push, or an arm that lags behind, is
    /// believed at once.
    fn kept(&self, points: &Points, expected: &Points) -> f64 {
        let Settings {
            filter_s,
            filter_px,
            ..
        } = self.settings;
        if filter_s == 0.0 {
            return 0.0;
        }
        let most_px = features::largest_distance(expected, points);
        let kept = libm::exp(-self.task.period / filter_s);
        kept.min(filter_px / most_px.max(f64::MIN_POSITIVE))
    }

    /// Time since the last image, s, and the mean command in it.
    fn since(&self, exposed_ns: u64) -> (f64, Twist) {
        let seen_ns = self.state.seen_ns;
        let mean = self.state.history.mean(seen_ns, exposed_ns);
        (exposed_ns.saturating_sub(seen_ns) as f64 * 1e-9, mean)
    }

    /// The measurement with the points that it does not show where they should be, and how well
    /// that is known.
    ///
    /// # Errors
    /// [`Refusal::Hidden`] if that is not well enough, or nothing is known at all.
    fn completed(&self, measurement: &Measurement) -> Result<(Measurement, Blind), Refusal> {
        let State {
            mut blind, drift, ..
        } = self.state;
        let exposed_ns = measurement.exposed_ns;
        let found = measurement.points.len();
        if found != self.task.goal.len() {
            let expected = self.task.goal.len();
            return Err(Refusal::Count { found, expected });
        }
        let most_px = blind::most_px(&self.task);
        let is_over = |blind: &Blind| blind.is_spent || blind.deviation_px > most_px;
        let expected = self.state_at(exposed_ns, drift.believed);
        let Some(expected) = expected.filter(|_| !is_over(&blind)) else {
            return Err(self.hidden(&blind));
        };
        let (seconds, command) = self.since(exposed_ns);
        let elapsed = Elapsed {
            at: &expected,
            seconds,
            command: &command,
        };
        let (task, model) = (&self.task, self.settings.model);
        let pose = drift.pose(task, &elapsed);
        let points = pose.and_then(|pose| {
            blind.complete(task, model, &expected, measurement, pose, drift.noise())
        });
        match points.filter(|_| !is_over(&blind)) {
            Some(points) => {
                let whole = Measurement {
                    points,
                    ..measurement.clone()
                };
                Ok((whole, blind))
            }
            None => Err(self.hidden(&blind)),
        }
    }

    fn hidden(&self, blind: &Blind) -> Refusal {
        Refusal::Hidden {
            blind_s: blind.spent_s,
            most_s: self.settings.blind_s,
            deviation_px: blind.deviation_px,
            most_px: blind::most_px(&self.task),
        }
    }

    /// Refuses features that moved as no camera under these commands, and no object, moves them.
    /// Whether their motion may tell of the pattern's own: a push or a repeated image does not.
    fn check_motion(
        &mut self,
        points: &Points,
        expected: Option<&Points>,
        commanded: Option<&Points>,
        exposed_ns: u64,
    ) -> Result<bool, Refusal> {
        let (Some(seen), Some(filtered)) = (self.state.seen.get(), self.state.filtered.get())
        else {
            return Ok(true);
        };
        let since_s = exposed_ns.abs_diff(self.state.seen_ns) as f64 * 1e-9;
        let Some(expected) = expected else {
            // Any commands within the limits.
            let most_px = follow::camera_px(&self.task, &filtered, since_s)
                + follow::object_px(&self.task, &filtered, since_s);
            gate::check_place(&self.task, points, &filtered, most_px)?;
            return Ok(true);
        };
        gate::check_names(points, expected)?;
        if since_s < gate::LEAP_PERIODS * self.task.period {
            gate::check_leaps(&self.task, points, expected)?;
        }
        let moved_px = features::largest_distance(expected, &filtered);
        // A robot may not have begun, or may still be under way.
        let object_px = follow::object_px(&self.task, &filtered, since_s);
        let most_px = moved_px + self.state.follow.ahead_px() + object_px;
        gate::check_place(&self.task, points, expected, most_px)?;
        let is_push = gate::is_push(&self.task, points, expected, 2.0 * moved_px + object_px);
        if is_push && self.state.blind.deviation_px == 0.0 {
            // Not after an image whose points were predicted.
            self.state.follow.push(exposed_ns);
        }
        let commanded_px = commanded.map_or(moved_px, |commanded| {
            features::largest_distance(commanded, &filtered)
        });
        let expected_px = match self.has_begun(exposed_ns) {
            true => [moved_px, commanded_px],
            false => [0.0; 2],
        };
        frozen::check(&mut self.state.still_px, points, &seen, expected_px)
            .inspect_err(|_| self.lose_sight())?;
        Ok(!is_push && *points != seen)
    }

    /// Whether a robot that begins a period late moved before this exposure. A busy machine
    /// delivers a command as late as that.
    fn has_begun(&self, exposed_ns: u64) -> bool {
        let late_ns = (self.task.period * 1e9) as u64;
        let before = |at_ns: u64| at_ns.saturating_sub(late_ns);
        let (from_ns, to_ns) = (before(self.state.seen_ns), before(exposed_ns));
        self.state.history.mean(from_ns, to_ns) != [0.0; DOF]
    }

    /// Whether the last image is recent enough to learn the pattern's motion from: not across a
    /// gap, nor where the camera has begun again. The pattern may have been anywhere meanwhile.
    fn is_continuous(&self, exposed_ns: u64) -> bool {
        let State {
            seen_ns,
            is_linked,
            drift,
            ..
        } = &self.state;
        let since_s = exposed_ns.saturating_sub(*seen_ns) as f64 * 1e-9;
        let has_begun = !is_linked && drift.is_new();
        since_s < gate::LEAP_PERIODS * self.task.period && !has_begun
    }

    /// The same as [`Law::check_motion`] says, in simulated time: a push does not.
    fn is_steady(&self, points: &Points, expected: Option<&Points>, exposed_ns: u64) -> bool {
        let since_s = exposed_ns.saturating_sub(self.state.seen_ns) as f64 * 1e-9;
        let since_s = since_s.max(self.task.period);
        let most_px = follow::object_px(&self.task, points, since_s);
        expected.is_none_or(|expected| !gate::is_push(&self.task, points, expected, most_px))
    }

    /// Where the commands alone would have taken the features, if the pattern did not move.
    fn commanded(&self, expected: Option<&Points>, exposed_ns: u64) -> Option<Points> {
        let expected = expected?;
        if self.state.drift.believed.is_none() || !self.state.history.is_live() {
            return Some(expected.clone());
        }
        let (commanded, _) = self.expected_since(exposed_ns, Own::NONE)?;
        Some(commanded)
    }

    /// Where these features were expected: predicted for this exposure from those of the previous
    /// one, filtered, with the commands that were in force in between; and which of two poses is
    /// believed there.
    fn expected_at_exposure(&self, exposed_ns: u64, age_ns: u64) -> Option<(Points, Option<Tilt>)> {
        if age_ns == 0 && !self.state.history.is_live() {
            return Some((self.state.predicted.get()?, self.state.predicted_tilt));
        }
        self.expected_since(exposed_ns, self.state.drift.believed)
    }

    /// The same by the instants and commands that are known, of a pattern with this drift.
    fn expected_since(&self, exposed_ns: u64, drift: Own) -> Option<(Points, Option<Tilt>)> {
        let expected = self.state_at(exposed_ns, drift)?;
        Some((expected.explained(&self.task), expected.tilt))
    }

    /// The state that the last image leads to, of a pattern with this drift.
    fn state_at(&self, exposed_ns: u64, drift: Own) -> Option<InitialState> {
        let (filtered, seen_ns) = (self.state.filtered.get()?, self.state.seen_ns);
        if seen_ns >= exposed_ns {
            return None;
        }
        let (model, tilt) = (self.settings.model, self.state.tilt.as_ref());
        let before = InitialState::turned(&self.task, model, &filtered, tilt).with_drift(drift);
        self.advance(&before, seen_ns, exposed_ns).ok()
    }

    fn advance(
        &self,
        initial: &InitialState,
        from_ns: u64,
        to_ns: u64,
    ) -> Result<InitialState, Unpredictable> {
        let model = self.settings.model;
        self.state
            .history
            .advance(&self.task, model, initial, from_ns, to_ns)
    }

    /// The classic law, scaled as a whole into the limits of velocity, its change into those of
    /// acceleration.
    fn servo(&mut self, initial: &InitialState, dampers: Option<&Dampers>, step: &mut Step) {
        match ibvs::twist(&self.task, initial, &self.task.goal, self.settings.lambda) {
            Some(twist) => {
                let (task, standing) = (&self.task, &self.state.standing);
                let twist = limit::scale(&twist, &task.limits);
                let twist = arm::within(dampers, &twist);
                step.twist = limit::approach(&twist, standing, task, task.period);
            }
            None => step.status = Status::NumericalFailure,
        }
    }

    /// The nearest allowed twist to the wanted one; that itself, to the last bit, where it is
    /// allowed. The constraints are those of the other strategies, and the camera stays in front of
    /// the pattern; the cost is (v - v_d)' R (v - v_d), and no goal counts.
    fn guard(&mut self, initial: &InitialState, dampers: Option<&Dampers>, step: &mut Step) {
        let present = Present {
            initial,
            standing: &self.state.standing,
            interval: self.task.period,
            warm: &self.state.previous,
            extra_px: self.back_off_px(initial) + SPARE_PX,
            dampers,
            view: View::new(&self.task, initial, &self.state.standing, dampers),
            wanted: None,
        };
        let policy = Policy {
            task: &self.task,
            settings: &self.settings,
        };
        let wanted = self.wanted.unwrap_or_default();
        let Some(mut solver) = self.share.solver(&self.settings, self.workspace.as_mut()) else {
            step.status = Status::NumericalFailure;
            return;
        };
        let (twist, solution) = policy.nearest(&mut solver, &present, &wanted);
        step.twist = twist;
        if let Some(solution) = &solution {
            step.tell(solution);
        }
        self.state.previous = repeated(&twist);
    }

    /// The memory's answer, if features are near an occlusion.
    fn recall(
        &mut self,
        points: &Points,
        clearance_px: f64,
        memory: Option<&dyn MotionMemory>,
    ) -> (Option<Recall>, Asked) {
        let near = recall::is_near(self.state.near, clearance_px, &self.settings);
        self.state.near = near;
        let strategy = self.settings.strategy;
        match memory.filter(|_| near && strategy.needs_memory()) {
            Some(memory) => recall::advise(&self.task, strategy, memory, points),
            None => (None, Asked::Not),
        }
    }

    /// Solves the optimal-control problem towards the way point, else the goal, and limits its
    /// first command.
    fn plan(
        &mut self,
        initial: &InitialState,
        dampers: Option<&Dampers>,
        warm: &Plan,
        towards: Towards,
        mismatch: Option<&Points>,
        step: &mut Step,
    ) {
        let Towards { tracked, wanted } = towards;
        let aim = tracked.as_ref().unwrap_or(&self.task.goal);
        let target = corrected(aim, mismatch);
        let guide = &self.state.foresight.guide;
        let crosses = self.settings.strategy == Strategy::Foresight && guide.crosses;
        let open = self.crossing.as_ref().filter(|_| crosses);
        let policy = Policy {
            task: open.map_or(&self.task, |crossing| &crossing.task),
            settings: &self.settings,
        };
        let present = Present {
            initial,
            standing: &self.state.standing,
            interval: self.task.period,
            warm,
            extra_px: self.back_off_px(initial),
            dampers,
            view: None,
            wanted,
        };
        let Some(mut solver) = self.share.solver(&self.settings, self.workspace.as_mut()) else {
            step.status = Status::NumericalFailure;
            return;
        };
        let (twist, solution) = policy.command(&mut solver, &present, aim, &target);
        step.twist = twist;
        step.tell(&solution);
        step.way_point = tracked;
        self.state.previous = solution.warm(&twist);
    }

    /// How certain the places of hidden points are: 1 where none is hidden, 0 where they are not
    /// known well enough any more.
    fn certainty(&self) -> f64 {
        (1.0 - self.state.blind.deviation_px / blind::most_px(&self.task)).max(0.0)
    }

    /// The command, slowed down against the pattern as certainty of hidden points falls.
    fn slowed(&self, initial: &InitialState, dampers: Option<&Dampers>, twist: &Twist) -> Twist {
        let unsure = 1.0 - self.certainty();
        if unsure == 0.0 {
            return *twist;
        }
        let with = arm::within(dampers, &initial.drift.twist);
        let mut slower = *twist;
        let pairs = slower.iter_mut().zip(with);
        pairs.for_each(|(v, with)| *v -= unsure * (*v - with));
        limit::approach(&slower, &self.state.standing, &self.task, self.task.period)
    }

    /// Clearance kept from every border beside the settings': for hidden points, and for what is not
    /// known yet of the pattern's motion, px.
    fn back_off_px(&self, initial: &InitialState) -> f64 {
        let hidden_px = BACK_OFF * self.state.blind.deviation_px;
        if !self.settings.drift_compensation {
            return hidden_px;
        }
        // In whole periods, so that a hair of time does not move a border.
        let period = self.task.period;
        let seconds = period * (1.0 + libm::round(self.lead_s / period));
        let unknown_px = blind::lead_px(&self.task, initial, &self.state.drift, seconds);
        hidden_px + (BACK_OFF * unknown_px).min(MOST_UNKNOWN_PX)
    }

    /// Remembers where the features should be one period after `twist`.
    fn predict(&mut self, initial: &InitialState, twist: &Twist) {
        let next = initial.moved(&self.task, self.settings.model, twist, self.task.period);
        let state = &mut self.state;
        (state.predicted, state.predicted_tilt) = match next {
            Some(next) => (next.explained(&self.task).as_slice().into(), next.tilt),
            None => (PlainPoints::NONE, None),
        };
    }
}

/// The task of a scene under these settings.
fn task(scene: &Scene, settings: &Settings) -> Result<Task, TaskError> {
    let mut found = Task::new(scene);
    // In its place: nothing is optimized where the stack is smallest.
    if let Ok(task) = &mut found {
        task.acceleration = settings.acceleration(&scene.limits);
        let stop_s = task.period + task.stop_s(&task.limits);
        task.ts = settings.step_s.max(task.period);
        task.reach = task.ts.max(stop_s);
    }
    found
}

/// What the law may do in a period, in counted [work](crate::work).
#[derive(Clone, Copy, Debug)]
struct Share {
    /// How large the problems of the solver are.
    size: Size,
    /// Most work of a solution.
    solution: u32,
    /// Most work of foresight in a cycle; the step that passes it is the last.
    thinking: u64,
    /// Most steps of it.
    steps: u32,
}

impl Share {
    /// The share of these settings.
    ///
    /// # Errors
    /// [`SettingsError::Window`] if too few iterations, or too few steps of foresight, fit into the
    /// period.
    fn of(task: &Task, settings: &Settings) -> Result<Self, SettingsError> {
        let Settings {
            np, nc, iterations, ..
        } = *settings;
        let period_ns = 1e9 * task.period;
        let needed = match settings.strategy {
            Strategy::Foresight => FEWEST_STEPS.min(settings.foresight_steps),
            _ => 0,
        };
        let share = |np: usize| {
            let size = Size::of(task, np, nc.min(np));
            let prices = Prices::of(size);
            let free = DECIDING * period_ns - f64::from(prices.decision(0));
            let steps = (THINKING * period_ns / f64::from(prices.step())) as u32;
            let share = Self {
                size,
                solution: prices.budget(iterations).min((free / 1.5) as u32),
                thinking: (THINKING * period_ns) as u64,
                steps: settings.foresight_steps.min(steps.max(1)),
            };
            let fewest = prices.budget(FEWEST_ITERATIONS.min(iterations));
            (share.solution >= fewest && steps >= needed).then_some(share)
        };
        share(np).ok_or_else(|| SettingsError::Window {
            np,
            nc,
            points: task.pattern.len(),
            obstacles: task.obstacles().count(),
            period_ms: 1e3 * task.period,
            most: (1..np).rev().find(|np| share(*np).is_some()).unwrap_or(0),
        })
    }

    /// The solver of these settings in a workspace; `None` if that has become too short.
    fn solver<'w>(&self, settings: &Settings, workspace: &'w mut [f64]) -> Option<Solver<'w>> {
        Some(Solver::new(self.size, settings.solver(), workspace)?.with_budget(self.solution))
    }
}

/// What a command is to do.
struct Towards {
    /// A way point to track instead of the goal.
    tracked: Option<Points>,
    /// A wanted twist: the nearest allowed one is sent, instead of either.
    wanted: Option<Twist>,
}

/// s_d = s* - eps: the target, corrected by the mismatch between measurement and prediction.
///
/// Source: paper, Eq. (model).
fn corrected(tracked: &Points, mismatch: Option<&Points>) -> Points {
    match mismatch {
        Some(eps) => difference(tracked, eps),
        None => tracked.clone(),
    }
}

/// a + b.
fn sum(a: &Twist, b: &Twist) -> Twist {
    let mut sum = *a;
    sum.iter_mut().zip(b).for_each(|(sum, b)| *sum += b);
    sum
}

/// a - b.
fn minus(a: &Twist, b: &Twist) -> Twist {
    let mut rest = *a;
    rest.iter_mut().zip(b).for_each(|(rest, b)| *rest -= b);
    rest
}

/// The measured features with a share `kept` of what the expected ones differ.
fn mixed(points: &Points, expected: &Points, kept: f64) -> Points {
    if kept == 0.0 {
        return points.clone();
    }
    let pairs = points.iter().zip(expected);
    pairs
        .map(|(s, e)| [s[0] + kept * (e[0] - s[0]), s[1] + kept * (e[1] - s[1])])
        .collect()
}

/// a - b, point by point.
fn difference(a: &Points, b: &Points) -> Points {
    a.iter()
        .zip(b)
        .map(|(a, b)| [a[0] - b[0], a[1] - b[1]])
        .collect()
}
