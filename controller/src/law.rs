//! The law with what it needs: scene, settings, memory. Opened at start-up, stepped in the loop.

use std::path::Path;

use ipc::{CycleRecord, Features, Hold, RecallCode, SolverStatus, StrategyCode, TwistState};
use memory_blob::{MemoryFile, OpenError};
use scene::{FileError, Scene};
use vpc::{Measurement, MotionMemory, Refusal, Settings, SettingsError, Strategy};

use crate::exit::Exit;
use crate::gate::Link;

// A step takes all the points that a message can have: more than the law has room for would panic in the loop.
const _: () = assert!(ipc::MAX_POINTS <= vpc::MAX_POINTS);

/// Rounding that a command may have beyond the limits, as a share of them.
const ROUNDING: f64 = 1e-9;

/// Stack for setting up the law: the controller (some 600 KB) passes through several frames on its way to the heap.
const SETUP_STACK: usize = 16 << 20;

/// Why the law could not be set up.
#[derive(Debug, thiserror::Error)]
pub enum LawError {
    /// The scene file.
    #[error(transparent)]
    Scene(#[from] FileError),
    /// The scene and the settings do not give a task.
    #[error("{path}: {source}")]
    Task {
        /// The scene file.
        path: String,
        /// The law's reason.
        source: SettingsError,
    },
    /// The thread that sets up the law.
    #[error("no thread to set up the law: {0}")]
    Thread(std::io::Error),
    /// The memory file.
    #[error(transparent)]
    Memory(#[from] OpenError),
    /// The memory lacks what the strategy asks for.
    #[error(
        "{path}: no {lacking} in this memory; allowed: a memory with one for the strategy {strategy}"
    )]
    Lacking {
        /// The memory file.
        path: String,
        /// What is lacking.
        lacking: &'static str,
        /// The strategy.
        strategy: Strategy,
    },
}

impl LawError {
    /// The exit code that it asks for.
    pub fn exit(&self) -> Exit {
        match self {
            Self::Scene(FileError::Read { .. }) | Self::Memory(OpenError::Read { .. }) => {
                Exit::NoInput
            }
            Self::Thread(_) => Exit::Software,
            _ => Exit::Data,
        }
    }
}

/// The law, ready to run.
pub struct Law {
    // The controller is large and stays where it is.
    controller: Box<vpc::Controller>,
    memory: Option<MemoryFile>,
    scene: Scene,
    /// The text of the scene's file.
    text: String,
}

/// What the law decided about some features.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Decision {
    /// Camera twist to send; zero where held.
    pub twist: [f64; 6],
    /// What the controller is about.
    pub state: TwistState,
    /// Why it is zero.
    pub hold: Hold,
}

impl Law {
    /// Opens scene and memory, and sets up the law. The memory is verified, and refused if it was built for another
    /// task.
    ///
    /// # Errors
    /// [`LawError`] names the file and what is wrong.
    pub fn open(scene: &Path, memory: Option<&Path>, settings: Settings) -> Result<Self, LawError> {
        let path = scene.display().to_string();
        match std::fs::read_to_string(scene) {
            Ok(text) => Self::parse(text, path, memory, settings),
            Err(source) => Err(FileError::Read { path, source }.into()),
        }
    }

    /// As [`Law::open`], from the text of a scene; `path` is for messages.
    ///
    /// # Errors
    /// As [`Law::open`].
    pub fn parse(
        text: String,
        path: String,
        memory: Option<&Path>,
        settings: Settings,
    ) -> Result<Self, LawError> {
        let scene = Scene::parse(&text, &path)?;
        Self::of(scene, text, path, memory, settings)
    }

    /// As [`Law::parse`], from a scene that was parsed from this text: its masks may be elsewhere by now.
    ///
    /// # Errors
    /// As [`Law::open`].
    pub fn of(
        scene: Scene,
        text: String,
        path: String,
        memory: Option<&Path>,
        settings: Settings,
    ) -> Result<Self, LawError> {
        let controller = boxed(&scene, settings)
            .map_err(LawError::Thread)?
            .map_err(|source| LawError::Task { path, source })?;
        let memory = match memory {
            Some(file) => Some(open_memory(file, &scene, settings.strategy)?),
            None => None,
        };
        Ok(Self {
            controller,
            memory,
            scene,
            text,
        })
    }

    /// What the law leaves to the next step. A copy; never allocates.
    pub fn state(&self) -> vpc::State {
        self.controller.state()
    }

    /// Goes on from a state of this law.
    pub fn restore(&mut self, state: &vpc::State) {
        self.controller.restore(state);
    }

    /// Takes it that the last step's command was this one.
    pub fn follow(&mut self, twist: &[f64; 6]) {
        self.controller.follow(twist);
    }

    /// The text of the scene's file.
    pub fn text(&self) -> &str {
        &self.text
    }

    /// The scene.
    pub fn scene(&self) -> &Scene {
        &self.scene
    }

    /// The memory, where the strategy has one.
    pub fn memory(&self) -> Option<&MemoryFile> {
        self.memory.as_ref()
    }

    /// The settings.
    pub fn settings(&self) -> &Settings {
        self.controller.settings()
    }

    /// Changes the strategy; `false` where the memory lacks what it needs, or there is none. Nothing changes then.
    pub fn set_strategy(&mut self, strategy: Strategy) -> bool {
        let has = match &self.memory {
            Some(memory) => lacking(memory, strategy).is_none(),
            None => !strategy.needs_memory(),
        };
        has && self.controller.set_strategy(strategy).is_ok()
    }

    /// Tells that time is real: commands are obeyed for `validity_ns` at most, and what moved the camera before the
    /// first one is unknown. In lockstep the camera is at rest before the first answer of a run.
    pub fn go_live(&mut self, validity_ns: u64) {
        self.controller.go_live(validity_ns);
    }

    /// Remembers that `twist` was sent, whoever chose it, and took effect at `effective_ns`.
    pub fn sent(&mut self, twist: &[f64; 6], effective_ns: u64) {
        self.controller.sent(twist, effective_ns);
    }

    /// Tells that the last step's command was not sent, but another one.
    pub fn overruled(&mut self) {
        self.controller.overruled();
    }

    /// Forgets which point is which: some were out of sight, and may bear other names when they come back.
    pub fn lose_sight(&mut self) {
        self.controller.lose_sight();
    }

    /// Forgets what was sent: a command did not go out, and which one the camera obeys is unknown.
    pub fn forget_sent(&mut self) {
        self.controller.forget_sent();
    }

    /// One step: features in, decision out, and what there is to tell about it in `record`. The decision is for a
    /// command that takes effect at `effective_ns`, on the clock of the features' exposure. Never allocates.
    pub fn step(
        &mut self,
        features: &Features,
        effective_ns: u64,
        link: Link,
        record: &mut CycleRecord,
    ) -> Decision {
        match link {
            Link::Next => (),
            Link::Broken => self.controller.skip_mismatch(),
            Link::New => self.controller.reset(),
        }
        let exposed_ns = match features.stamp.data_ns {
            // Not known: no later than they were published.
            0 => features.stamp.published_ns,
            data_ns => data_ns,
        };
        let mut measurement = Measurement::from_points(&[]).taken(exposed_ns, effective_ns);
        measurement.points.extend(features.pairs());
        let view = self.memory.as_ref().map(MemoryFile::view);
        let memory = view.as_ref().map(|view| view as &dyn MotionMemory);
        let step = match self.controller.step(&measurement, memory) {
            Ok(step) => step,
            Err(refusal) => return held(refused(refusal)),
        };
        tell(&step, record);
        if step.status == vpc::Status::NumericalFailure {
            return held(Hold::Solver);
        }
        if !self.is_within_limits(&step.twist) {
            return held(Hold::BadTwist);
        }
        let arrived = step.error_px < self.scene.success.convergence_px;
        Decision {
            twist: step.twist,
            state: if arrived {
                TwistState::Arrived
            } else {
                TwistState::Moving
            },
            hold: Hold::None,
        }
    }

    /// What stays the same in the record of each cycle.
    pub fn describe(&self, record: &mut CycleRecord) {
        let settings = self.controller.settings();
        record.np = settings.np as u32;
        let (strategy, neighbours) = strategy_code(settings.strategy);
        (record.strategy, record.neighbours) = (strategy.code(), neighbours);
    }

    /// The last look at a command before it goes out, independent of the law. A NaN is not within.
    fn is_within_limits(&self, twist: &[f64; 6]) -> bool {
        let limits = &self.scene.limits;
        let within = |v: &f64, limit: f64| v.abs() <= limit * (1.0 + ROUNDING);
        twist[..3].iter().all(|v| within(v, limits.linear))
            && twist[3..].iter().all(|w| within(w, limits.angular))
    }
}

/// The contract's words for a strategy: its code, and the neighbours of k-NN or 0.
pub fn strategy_code(strategy: Strategy) -> (StrategyCode, u32) {
    match strategy {
        Strategy::Previous => (StrategyCode::Previous, 0),
        Strategy::Knn { k } => (StrategyCode::Knn, k as u32),
        Strategy::Gpr => (StrategyCode::Gpr, 0),
        Strategy::Ibvs => (StrategyCode::Ibvs, 0),
    }
}

/// The strategy by the contract's words for it; `None` where the neighbours do not belong to it.
pub fn strategy_of(code: StrategyCode, neighbours: u32) -> Option<Strategy> {
    let k = neighbours as usize;
    match (code, neighbours) {
        (StrategyCode::Knn, _) => (1..=vpc::settings::MAX_NEIGHBOURS)
            .contains(&k)
            .then_some(Strategy::Knn { k }),
        (StrategyCode::Previous, 0) => Some(Strategy::Previous),
        (StrategyCode::Gpr, 0) => Some(Strategy::Gpr),
        (StrategyCode::Ibvs, 0) => Some(Strategy::Ibvs),
        _ => None,
    }
}

/// The decision to hold.
pub const fn held(hold: Hold) -> Decision {
    Decision {
        twist: [0.0; 6],
        state: TwistState::Holding,
        hold,
    }
}

/// Sets up the controller in a thread with room for it, whatever stack the caller has.
fn boxed(
    scene: &Scene,
    settings: Settings,
) -> std::io::Result<Result<Box<vpc::Controller>, SettingsError>> {
    std::thread::scope(|threads| {
        std::thread::Builder::new()
            .stack_size(SETUP_STACK)
            .spawn_scoped(threads, || {
                vpc::Controller::new(scene, settings).map(Box::new)
            })?
            .join()
            .map_err(|_| std::io::Error::other("it panicked"))
    })
}

fn open_memory(file: &Path, scene: &Scene, strategy: Strategy) -> Result<MemoryFile, LawError> {
    let memory = MemoryFile::open(file, Some(scene.fingerprint().bytes()))?;
    match lacking(&memory, strategy) {
        Some(lacking) => Err(LawError::Lacking {
            path: file.display().to_string(),
            lacking,
            strategy,
        }),
        None => Ok(memory),
    }
}

/// What a memory lacks for a strategy.
fn lacking(memory: &MemoryFile, strategy: Strategy) -> Option<&'static str> {
    let view = memory.view();
    match strategy {
        Strategy::Gpr if view.gpr().is_none() => Some("regression"),
        _ => None,
    }
}

/// The contract's word for a refusal.
fn refused(refusal: Refusal) -> Hold {
    match refusal {
        Refusal::Count { .. } => Hold::Count,
        Refusal::NotFinite { .. } => Hold::NotFinite,
        Refusal::OffImage { .. } | Refusal::Lost => Hold::OffImage,
        Refusal::Mixed { .. }
        | Refusal::Leap { .. }
        | Refusal::Coincident { .. }
        | Refusal::Flat { .. } => Hold::Mixed,
        Refusal::Frozen { .. } => Hold::Frozen,
        Refusal::Late { .. } => Hold::Stale,
    }
}

/// Copies what the law tells about a step.
fn tell(step: &vpc::Step, record: &mut CycleRecord) {
    record.status = match step.status {
        vpc::Status::Converged => SolverStatus::Converged,
        vpc::Status::IterationLimit => SolverStatus::IterationLimit,
        vpc::Status::Stalled => SolverStatus::Stalled,
        vpc::Status::Infeasible => SolverStatus::Infeasible,
        vpc::Status::NumericalFailure => SolverStatus::NumericalFailure,
    }
    .code();
    record.recalled = match step {
        _ if step.detour => RecallCode::Detour,
        _ if step.recalled => RecallCode::Followed,
        _ if step.recall_refused => RecallCode::Refused,
        _ => RecallCode::Unasked,
    }
    .code();
    record.iterations = step.iterations;
    record.qp_iterations = step.qp_iterations;
    record.cost = step.cost;
    record.violation_px = step.violation_px;
    record.clearance_px = step.clearance_px;
    record.error_px = step.error_px;
    if let Some(way_point) = &step.way_point {
        record.way_point_count = way_point.len() as u32;
        let pairs = record.way_point.chunks_exact_mut(2);
        pairs
            .zip(way_point)
            .for_each(|(to, from)| to.copy_from_slice(from));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn law() -> Law {
        law_with(Settings::default())
    }

    fn law_with(settings: Settings) -> Law {
        let scene = Scene::parse(scene::PAPER_SIM, "sim").unwrap();
        Law {
            controller: boxed(&scene, settings).unwrap().unwrap(),
            memory: None,
            scene,
            text: scene::PAPER_SIM.to_owned(),
        }
    }

    fn features(law: &Law, offset: f64) -> Features {
        let goal = law.controller.task().goal.clone();
        let points: Vec<_> = goal.iter().map(|p| [p[0] + offset, p[1]]).collect();
        Features::new(&points, 0)
    }

    #[test]
    fn on_the_way_it_moves_and_at_the_goal_it_has_arrived() {
        let mut law = law();
        let mut record = CycleRecord::default();
        let (far, near) = (features(&law, 60.0), features(&law, 0.0));
        let decision = law.step(&far, 0, Link::New, &mut record);
        assert_eq!(
            (decision.state, decision.hold),
            (TwistState::Moving, Hold::None)
        );
        assert!(decision.twist.iter().any(|v| v.abs() > 1e-3));
        assert!((record.error_px - 60.0).abs() < 1e-6 && record.cost > 0.0);
        let decision = law.step(&near, 0, Link::New, &mut record);
        assert_eq!(decision.state, TwistState::Arrived);
    }

    #[test]
    fn what_the_law_refuses_is_held_with_its_cause() {
        let mut law = law();
        let mut off = features(&law, 0.0);
        off.points[0] = 1e6;
        let mut nan = features(&law, 0.0);
        nan.points[1] = f64::NAN;
        let mut five = features(&law, 0.0);
        five.count = 5;
        let mut mixed = features(&law, 0.0);
        mixed.points[..4].rotate_left(2);
        let mut zeros = features(&law, 0.0);
        zeros.points.fill(0.0);
        for (bad, cause) in [
            (off, Hold::OffImage),
            (nan, Hold::NotFinite),
            (five, Hold::Count),
            (mixed, Hold::Mixed),
            (zeros, Hold::Mixed),
        ] {
            let decision = law.step(&bad, 0, Link::Next, &mut CycleRecord::default());
            assert_eq!(decision, held(cause));
        }
    }

    #[test]
    fn where_the_law_has_no_answer_the_camera_is_held() {
        let mut law = law_with(Settings {
            strategy: Strategy::Ibvs,
            ..Settings::default()
        });
        // Seen as a line, nearly: the interaction matrix is singular.
        let points = [
            [300.0, 299.0],
            [500.0, 299.0],
            [500.0, 301.0],
            [300.0, 301.0],
        ];
        let mut record = CycleRecord::default();
        let decision = law.step(&Features::new(&points, 0), 0, Link::New, &mut record);
        assert_eq!(decision, held(Hold::Solver));
        assert_eq!(record.status, SolverStatus::NumericalFailure.code());
    }

    #[test]
    fn on_a_live_robot_features_from_before_the_first_command_are_stale() {
        let mut law = law();
        law.go_live(100);
        let mut far = features(&law, 60.0);
        // The instant of the exposure is not known: it is no later than this.
        far.stamp.published_ns = 30;
        let step = |law: &mut Law| law.step(&far, 50, Link::New, &mut CycleRecord::default());
        assert_eq!(step(&mut law), held(Hold::Stale));
        law.sent(&[0.0; 6], 0);
        assert_eq!(step(&mut law).state, TwistState::Moving);
        law.forget_sent();
        assert_eq!(step(&mut law), held(Hold::Stale));
    }

    #[test]
    fn a_live_robot_whose_image_ignores_the_commands_is_not_believed() {
        const PERIOD: u64 = 33_000_000;
        let mut law = law();
        law.go_live(3 * PERIOD);
        let mut frame = features(&law, 60.0);
        let mut holds = Vec::new();
        for k in 1..20 {
            frame.stamp.data_ns = k * PERIOD;
            law.sent(&[0.1, 0.0, 0.0, 0.0, 0.0, 0.0], k * PERIOD);
            let decision = law.step(&frame, k * PERIOD, Link::Next, &mut CycleRecord::default());
            holds.push(decision.hold);
        }
        assert!(holds.contains(&Hold::Frozen), "{holds:?}");
        // The points by other names, in the place of the old ones: until they were out of sight.
        frame.points[..8].rotate_left(2);
        let mut step = |law: &mut Law, k: u64| {
            frame.stamp.data_ns = k * PERIOD;
            law.step(&frame, k * PERIOD, Link::Next, &mut CycleRecord::default())
                .hold
        };
        assert_eq!(step(&mut law, 20), Hold::Mixed);
        law.lose_sight();
        assert_eq!(step(&mut law, 21), Hold::None);
    }

    #[test]
    fn on_a_live_robot_a_point_that_leaps_is_not_believed_at_once() {
        const PERIOD: u64 = 33_000_000;
        let mut law = law();
        law.go_live(100 * PERIOD);
        law.sent(&[0.0; 6], 0);
        let good = features(&law, 60.0);
        let mut leapt = good;
        leapt.points[0] += 100.0;
        let mut step = |k: u64, mut frame: Features| {
            frame.stamp.data_ns = k * PERIOD;
            // No two images are the same.
            frame.points[1] += 1e-6 * k as f64;
            law.step(&frame, k * PERIOD, Link::Next, &mut CycleRecord::default())
                .hold
        };
        assert_eq!(step(1, good), Hold::None);
        assert_eq!(step(2, leapt), Hold::Mixed);
        assert_eq!(step(3, good), Hold::None);
        // It stays where it went: whoever it was is now the point.
        for k in 4..7 {
            assert_eq!(step(k, leapt), Hold::Mixed, "{k}");
        }
        assert_eq!(step(7, leapt), Hold::None);
    }

    #[test]
    fn a_command_beyond_the_limits_or_not_finite_is_not_within() {
        let law = law();
        let limits = law.scene().limits;
        let linear = |v| law.is_within_limits(&[v, 0.0, 0.0, 0.0, 0.0, 0.0]);
        assert!(linear(limits.linear) && linear(-limits.linear));
        assert!(!linear(limits.linear * 1.01) && !linear(f64::NAN) && !linear(f64::INFINITY));
        assert!(!law.is_within_limits(&[0.0, 0.0, 0.0, 0.0, 0.0, -1.01 * limits.angular]));
    }
}
