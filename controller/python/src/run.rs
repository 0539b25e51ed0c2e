//! Runs from the same starts, as `cargo table` makes them.

use ::scene::Pose;
use ::vpc::Settings;
use hw_sim::robot::arm::ArmSettings;
use messages::ClockMode;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use system_tests::flags::{self, Common, FreeFlags, RobotFlags};
use system_tests::robot::{self, Course, RobotRun, RunError};
use system_tests::robot_table;
use system_tests::run::{self as closed_loop, Run};
use system_tests::simulated::Simulated;
use system_tests::spec::Spec;
use system_tests::steering::Steering;

use crate::controller::check_memory;
use crate::flags::given;
use crate::law::OwnLaw;
use crate::memory::Memory;
use crate::panda::Report;
use crate::scene::Scene;
use crate::{array, error};

/// Flags of the table whose figures are in no row here, and those that other arguments are.
const LEFT_OUT: [&str; 7] = [
    "strategies",
    "follow_s",
    "edge",
    "servo_rule",
    "joint_task",
    "arm",
    "only",
];

/// What happened in a run, as a dict; the stub tells of each key.
#[derive(IntoPyObject)]
pub struct Row {
    strategy: String,
    start: usize,
    success: bool,
    reason: Option<&'static str>,
    cause: Option<String>,
    steps: usize,
    cost: f64,
    np: usize,
    change: Option<f64>,
    standstill_s: Option<f64>,
    error_mm: Option<f64>,
    error_mrad: Option<f64>,
    least_clearance_px: f64,
    least_between_px: f64,
    least_edge_px: Option<f64>,
    iterations: u64,
    not_converged: u64,
}

impl Row {
    fn of(strategy: &str, start: usize, run: Run) -> Self {
        Self {
            strategy: strategy.to_owned(),
            start,
            success: run.success,
            reason: run.reason.map(word),
            cause: run.cause,
            steps: run.steps,
            cost: run.cost,
            np: run.np,
            change: run.change,
            standstill_s: run.standstill_s,
            error_mm: run.pose_error.map(|[mm, _]| mm),
            error_mrad: run.pose_error.map(|[_, mrad]| mrad),
            least_clearance_px: run.least_clearance_px,
            least_between_px: run.least_between_px,
            least_edge_px: run.least_edge_px,
            iterations: run.iterations,
            not_converged: run.not_converged,
        }
    }
}

/// The same of a run of the robot, without its referee's report.
#[derive(IntoPyObject)]
struct PandaRow {
    strategy: String,
    start: usize,
    success: bool,
    reason: Option<&'static str>,
    hold: Option<String>,
    time_s: f64,
    arrived_s: Option<f64>,
    cost: Option<f64>,
    error_px: f64,
    hidden_frames: u64,
    least_clearance_px: f64,
    least_between_px: f64,
    least_edge_px: Option<f64>,
}

impl PandaRow {
    fn of<'py>(
        py: Python<'py>,
        strategy: &str,
        start: usize,
        run: RobotRun,
    ) -> PyResult<Bound<'py, PyDict>> {
        let row = Self {
            strategy: strategy.to_owned(),
            start,
            success: run.success,
            reason: run.reason.map(robot_word),
            hold: run.hold,
            time_s: run.time_s,
            arrived_s: run.arrived_s,
            cost: Some(run.cost).filter(|cost| cost.is_finite()),
            error_px: run.error_px,
            hidden_frames: run.hidden,
            least_clearance_px: run.least_clearance_px,
            least_between_px: run.least_between_px,
            least_edge_px: run.least_edge_px,
        };
        let row = row.into_pyobject(py)?;
        let report = Report::from(&run.arm).into_pyobject(py)?;
        row.update(report.as_mapping())?;
        Ok(row)
    }
}

/// As the table's JSON has it.
fn word(reason: closed_loop::Reason) -> &'static str {
    use closed_loop::Reason;
    match reason {
        Reason::Violation => "violation",
        Reason::NotConverged => "not_converged",
        Reason::LostSight => "lost_sight",
        Reason::Disarmed => "disarmed",
        Reason::BeyondLimits => "beyond_limits",
    }
}

/// The same of a run of the robot.
fn robot_word(reason: robot::Reason) -> &'static str {
    use robot::Reason;
    match reason {
        Reason::Violation => "violation",
        Reason::MarkerLost => "marker_lost",
        Reason::TimeOut => "time_out",
        Reason::Reflex => "reflex",
        Reason::Disarmed => "disarmed",
        Reason::BeyondLimits => "beyond_limits",
    }
}

/// What carries the camera.
enum Body {
    Free(FreeFlags),
    Panda(RobotFlags),
}

/// What all runs of a call have in common.
struct Setup {
    scene: ::scene::Scene,
    /// The scene as the law believes it to be.
    believed: ::scene::Scene,
    common: Common,
    body: Body,
}

impl Setup {
    fn new(scene: &Scene, robot: &str, flags: Option<&Bound<'_, PyDict>>) -> PyResult<Self> {
        let given = given(flags)?;
        let is_allowed = |name: &str| !LEFT_OUT.contains(&name);
        let (common, body): (Common, _) = match robot {
            "free" => {
                let (common, world) =
                    flags::of_keywords::<FreeFlags>(&given, is_allowed).map_err(error::value)?;
                world.check().map_err(error::keyword)?;
                (common, Body::Free(world))
            }
            "panda" => {
                let (common, robot) =
                    flags::of_keywords::<RobotFlags>(&given, is_allowed).map_err(error::value)?;
                robot.check(1).map_err(error::keyword)?;
                (common, Body::Panda(robot))
            }
            _ => {
                let message = format!("robot `{robot}`; allowed: free, panda");
                return Err(error::value(message));
            }
        };
        let mut scene = scene.scene.clone();
        scene.camera.rate_hz = common.rate.unwrap_or(scene.camera.rate_hz);
        let believed = match &body {
            Body::Free(_) => common.believed(&scene),
            Body::Panda(flags) => robot_table::believed(&scene, flags),
        };
        Ok(Self {
            scene,
            believed,
            common,
            body,
        })
    }

    /// The settings of the law.
    fn settings(&self, spec: Spec) -> Settings {
        let settings = self.common.settings(spec);
        match &self.body {
            Body::Free(_) => settings,
            Body::Panda(flags) => robot_table::law(flags, settings),
        }
    }

    /// A run from start number `index`.
    fn run<S: Steering>(
        &self,
        steering: &mut S,
        index: usize,
        start: &Pose,
    ) -> Result<Outcome, RunError<S::Error>> {
        match &self.body {
            Body::Free(world) => {
                let world = world.world(&self.common, index);
                let run = closed_loop::through(&self.scene, steering, start, &world);
                run.map(Outcome::Free).map_err(RunError::Steering)
            }
            Body::Panda(flags) => {
                let arm = ArmSettings::default();
                let cell = robot_table::cell(&self.scene, &arm, flags, &self.common, index);
                let course = Course {
                    motion: self.common.motion(),
                    follow_s: 0.0,
                    rule: None,
                };
                let run = robot::run(&self.scene, &cell, course, steering, start);
                run.map(Outcome::Panda)
            }
        }
    }
}

/// What happened.
enum Outcome {
    Free(Run),
    Panda(RobotRun),
}

impl Outcome {
    fn row<'py>(
        self,
        py: Python<'py>,
        strategy: &str,
        start: usize,
    ) -> PyResult<Bound<'py, PyDict>> {
        match self {
            Self::Free(run) => Row::of(strategy, start, run).into_pyobject(py),
            Self::Panda(run) => PandaRow::of(py, strategy, start, run),
        }
    }
}

/// What steers the camera.
enum Method<'py, 'm> {
    Ours(Box<Simulated<'m>>),
    Own(Box<OwnLaw<'py>>),
}

impl<'py, 'm> Method<'py, 'm> {
    /// A strategy by its words, or a law in Python; with its name.
    fn new(
        given: &Bound<'py, PyAny>,
        setup: &Setup,
        scene: &Scene,
        memory: Option<&'m Memory>,
    ) -> PyResult<(String, Self)> {
        let Ok(words) = given.extract::<String>() else {
            let own = OwnLaw::new(given.clone(), &setup.believed, setup.common.brake_s)?;
            return Ok((own.name()?, Self::Own(Box::new(own))));
        };
        let spec: Spec = words
            .parse()
            .map_err(|refused: String| error::value(refused))?;
        check_memory(scene, memory, spec.strategy)?;
        let memory = memory.map(|memory| &*memory.file);
        let settings = setup.settings(spec);
        let ours = Simulated::new(&setup.believed, memory, settings, ClockMode::Fixed);
        let ours = Box::new(ours.map_err(error::value)?);
        Ok((spec.to_string(), Self::Ours(ours)))
    }

    fn run(
        &mut self,
        py: Python<'py>,
        setup: &Setup,
        index: usize,
        start: &Pose,
    ) -> PyResult<Outcome> {
        match self {
            Self::Ours(ours) => py
                .detach(|| setup.run(&mut **ours, index, start))
                .map_err(|failure| refused(failure, index)),
            Self::Own(own) => setup
                .run(&mut **own, index, start)
                .map_err(|failure| refused(failure, index)),
        }
    }
}

fn refused<E: Into<PyErr>>(failure: RunError<E>, start: usize) -> PyErr {
    match failure {
        RunError::Rig(refused) => error::value(format!("starts[{start}]: {refused}")),
        RunError::Steering(raised) => raised.into(),
    }
}

/// Runs each strategy from each start for the scene's time, judged by the emulator's referee: the
/// runs of `cargo table`, to the bit. Other threads of Python go on; Ctrl-C ends it after the run
/// under way.
///
/// `starts`: poses of the object in the camera frame, tx, ty, tz (m), rx, ry, rz (rad), shape
/// (count, 6). `strategies`: words as "foresight", "knn5" or "previous:30" (with the steps ahead, 3
/// by default), or your own law: a callable `law(points, time_s)` that is given the image points
/// (px, shape (N, 2); NaN where the frame does not show one; None where no frame came) and the time
/// (s), and returns a twist (m/s and rad/s, camera frame, shape (6,)); if it has a method
/// `reset()`, each run begins with that. `robot`: "free", a camera that moves exactly as told, or
/// "panda", the emulated arm, whose frames come late; the law knows the arm that the scene has.
/// `progress(done, total)` is called after each run. `flags`: those of the command by their names,
/// as noise=0.3 or delay_ms=80; a switch is True.
///
/// Returns a dict for each run, strategy by strategy, in the order of the starts.
///
/// Raises ValueError for another shape, an unknown strategy, robot or flag, one out of its range, a
/// memory that is missing or of another scene, a start out of the arm's reach, and what your law
/// raises.
#[expect(clippy::too_many_arguments, reason = "keywords of Python")]
#[pyfunction]
#[pyo3(signature = (
    scene, starts, strategies, memory=None, *, robot="free", progress=None, **flags
))]
pub fn run<'py>(
    py: Python<'py>,
    scene: &Scene,
    starts: &Bound<'py, PyAny>,
    strategies: Vec<Bound<'py, PyAny>>,
    memory: Option<&Memory>,
    robot: &str,
    progress: Option<Bound<'py, PyAny>>,
    flags: Option<&Bound<'py, PyDict>>,
) -> PyResult<Vec<Bound<'py, PyDict>>> {
    let starts = array::rows("starts", starts, None)?.into_iter().enumerate();
    let starts = starts.map(|(k, start)| Scene::pose(&format!("starts[{k}]"), start));
    let starts: Vec<Pose> = starts.collect::<PyResult<_>>()?;
    let setup = Setup::new(scene, robot, flags)?;
    let methods = strategies.iter();
    let methods = methods.map(|it| Method::new(it, &setup, scene, memory));
    let mut methods: Vec<_> = methods.collect::<PyResult<_>>()?;
    let total = methods.len() * starts.len();
    let mut rows = Vec::with_capacity(total);
    for (name, method) in &mut methods {
        for (start, pose) in starts.iter().enumerate() {
            let outcome = method.run(py, &setup, start, pose)?;
            rows.push(outcome.row(py, name, start)?);
            py.check_signals()?;
            if let Some(progress) = &progress {
                progress.call1((rows.len(), total))?;
            }
        }
    }
    Ok(rows)
}
