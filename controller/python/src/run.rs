//! Runs from the same starts, as `cargo table` makes them.

use ::scene::Pose;
use hw_sim::sensor::Flaws;
use messages::ClockMode;
use pyo3::prelude::*;
use system_tests::run::{self as closed_loop, Reason, Run, World};
use system_tests::simulated::Simulated;
use system_tests::spec::Spec;

use crate::controller::check_memory;
use crate::law::OwnLaw;
use crate::memory::Memory;
use crate::scene::Scene;
use crate::{array, error};

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

/// As the table's JSON has it.
fn word(reason: Reason) -> &'static str {
    match reason {
        Reason::Violation => "violation",
        Reason::NotConverged => "not_converged",
        Reason::LostSight => "lost_sight",
        Reason::Disarmed => "disarmed",
        Reason::BeyondLimits => "beyond_limits",
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
        scene: &Scene,
        memory: Option<&'m Memory>,
    ) -> PyResult<(String, Self)> {
        let Ok(words) = given.extract::<String>() else {
            let own = OwnLaw::new(given.clone(), scene)?;
            return Ok((own.name()?, Self::Own(Box::new(own))));
        };
        let spec: Spec = words
            .parse()
            .map_err(|refused: String| error::value(refused))?;
        check_memory(scene, memory, spec.strategy)?;
        let memory = memory.map(|memory| &*memory.file);
        let ours = Simulated::new(&scene.scene, memory, spec.settings(), ClockMode::Fixed);
        let ours = Box::new(ours.map_err(error::value)?);
        Ok((spec.to_string(), Self::Ours(ours)))
    }

    fn run(&mut self, py: Python<'py>, scene: &::scene::Scene, start: &Pose) -> PyResult<Run> {
        match self {
            Self::Ours(ours) => Ok(py.detach(|| closed_loop::run(scene, ours, start))),
            Self::Own(own) => {
                closed_loop::through(scene, &mut **own, start, &World::from(Flaws::default()))
            }
        }
    }
}

/// Runs each strategy from each start with the exact camera, for the scene's time, judged by the
/// emulator's referee: the runs of `cargo table`, to the bit. Other threads of Python go on; Ctrl-C
/// ends it after the run under way.
///
/// `starts`: poses of the object in the camera frame, tx, ty, tz (m), rx, ry, rz (rad), shape
/// (count, 6). `strategies`: words as "foresight", "knn5" or "previous:30" (with the steps ahead, 3
/// by default), or your own law: a callable `law(points, time_s)` that is given the image points
/// (px, shape (N, 2)) and the time (s), and returns a twist (m/s and rad/s, camera frame, shape
/// (6,)); if it has a method `reset()`, each run begins with that. `progress(done, total)` is
/// called after each run.
///
/// Returns a dict for each run, strategy by strategy, in the order of the starts.
///
/// Raises ValueError for another shape, an unknown strategy, a memory that is missing or of another
/// scene, and what your law raises.
#[pyfunction]
#[pyo3(signature = (scene, starts, strategies, memory=None, *, progress=None))]
pub fn run<'py>(
    py: Python<'py>,
    scene: &Scene,
    starts: &Bound<'py, PyAny>,
    strategies: Vec<Bound<'py, PyAny>>,
    memory: Option<&Memory>,
    progress: Option<Bound<'py, PyAny>>,
) -> PyResult<Vec<Row>> {
    let starts = array::rows("starts", starts, None)?.into_iter().enumerate();
    let starts = starts.map(|(k, start)| Scene::pose(&format!("starts[{k}]"), start));
    let starts: Vec<Pose> = starts.collect::<PyResult<_>>()?;
    let methods = strategies.iter().map(|it| Method::new(it, scene, memory));
    let mut methods: Vec<_> = methods.collect::<PyResult<_>>()?;
    let total = methods.len() * starts.len();
    let mut rows = Vec::with_capacity(total);
    for (name, method) in &mut methods {
        for (start, pose) in starts.iter().enumerate() {
            rows.push(Row::of(name, start, method.run(py, &scene.scene, pose)?));
            py.check_signals()?;
            if let Some(progress) = &progress {
                progress.call1((rows.len(), total))?;
            }
        }
    }
    Ok(rows)
}
