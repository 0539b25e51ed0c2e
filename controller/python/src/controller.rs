//! The controller: the decision step of the daemon, in the caller's time.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use ::vpc::{Settings, Strategy};
use decision::Input;
use memory_blob::MemoryFile;
use messages::{ClockMode, DesiredTwist, Features, RobotMode, RobotState};
use pyo3::prelude::*;
use pyo3::types::{PyBool, PyDict, PyFloat, PyString};
use scene::MAX_JOINTS;
use self_cell::self_cell;
use system_tests::simulated::Simulated;
use toml::Value;
use toml_schema::{Document, FileError};

use crate::foreseen::Foreseen;
use crate::memory::Memory;
use crate::scene::Scene;
use crate::step::Step;
use crate::{array, error};

self_cell!(
    /// The daemon's decision with the memory that it borrows.
    struct Daemon {
        owner: Option<Arc<MemoryFile>>,
        #[not_covariant]
        dependent: Simulated,
    }
);

/// The daemon, and the frames that it has received.
struct Running {
    daemon: Daemon,
    frames: u64,
    /// The last command.
    twist: [f64; 6],
}

/// The decision of `vpcd` in a time of your own: image points in, camera twist out. It is armed,
/// and begins with the first call of `step`. Threads may share it: each call waits for the one
/// before.
///
/// Where the scene has an arm, `step` needs its joints, and the law keeps to its limits.
///
/// `settings` are the keys of table `[law]` in the configuration of `vpcd`, with their meanings,
/// ranges and messages, and `blind_s` and `brake_s` of its table `[safety]`. Defaults are those of
/// `vpcd`, but for `brake_s`, 0.
///
/// Raises ValueError if a setting is unknown or out of range, if the memory is of another scene, or
/// if the strategy needs a memory and there is none.
#[pyclass(frozen, module = "vpc")]
pub struct Controller {
    running: Mutex<Running>,
    points: usize,
    /// Of the scene's arm; 0 without.
    joints: usize,
}

/// Longest time in a run, s: more has no exact nanoseconds.
const LONGEST_S: f64 = 4e6;

impl Controller {
    fn running(&self) -> MutexGuard<'_, Running> {
        // What a panic left is a state as any other: `reset` begins anew.
        self.running.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Positions of the joints, as a message has them.
    fn joints(&self, joints: &Bound<'_, PyAny>) -> PyResult<[f64; MAX_JOINTS]> {
        if self.joints == 0 {
            let allowed = "None, for the scene names no arm (Scene.with_arm)";
            return Err(error::value(format!(
                "joints are given; allowed: {allowed}"
            )));
        }
        let given = array::list("joints", joints, self.joints)?;
        if !given.iter().all(|q| q.is_finite()) {
            let message = format!("joints = {given:?}; allowed: finite numbers");
            return Err(error::value(message));
        }
        let mut q = [0.0; MAX_JOINTS];
        q[..self.joints].copy_from_slice(&given);
        Ok(q)
    }
}

/// A time after the begin of the run, ns.
fn nanoseconds(name: &str, time_s: f64) -> PyResult<u64> {
    if !(0.0..=LONGEST_S).contains(&time_s) {
        let message = format!("{name} = {time_s}; allowed: 0 to {LONGEST_S} s");
        return Err(error::value(message));
    }
    Ok((time_s * 1e9).round() as u64)
}

/// A setting as a configuration file has it.
fn toml_of(value: &Bound<'_, PyAny>) -> PyResult<Value> {
    if value.is_instance_of::<PyBool>() {
        Ok(Value::Boolean(value.extract()?))
    } else if value.is_instance_of::<PyString>() {
        Ok(Value::String(value.extract()?))
    } else if value.is_instance_of::<PyFloat>() {
        Ok(Value::Float(value.extract()?))
    } else if let Ok(number) = value.extract::<i64>() {
        Ok(Value::Integer(number))
    } else {
        Ok(Value::Float(value.extract()?))
    }
}

/// The settings of the law; those of safety are checked with them.
fn settings_of(strategy: &str, given: Option<&Bound<'_, PyDict>>) -> PyResult<Settings> {
    let mut document = Document::parse("", "settings").map_err(error::file)?;
    document.set("strategy", "strategy", Some(strategy));
    let (mut blind_s, mut brake_s) = (None, None);
    for (key, value) in given.into_iter().flatten() {
        let key: String = key.extract()?;
        match &*key {
            "blind_s" => blind_s = Some(value.extract()?),
            "brake_s" => brake_s = Some(value.extract()?),
            _ => document.set(&key, &key, Some(toml_of(&value)?)),
        }
    }
    let settings: Settings = document.check().map_err(|refused| match refused {
        FileError::Value { refusal, .. } => error::value(refusal),
        FileError::Syntax { message, .. } => error::value(message),
        other => error::file(other),
    })?;
    let settings = Settings {
        blind_s: blind_s.unwrap_or(settings.blind_s),
        brake_s: brake_s.unwrap_or(settings.brake_s),
        ..settings
    };
    settings.check().map_err(error::value)?;
    Ok(settings)
}

/// Refuses a memory of another scene, and none where the strategy needs one.
///
/// # Errors
/// `ValueError`.
pub fn check_memory(scene: &Scene, memory: Option<&Memory>, strategy: Strategy) -> PyResult<()> {
    match memory {
        Some(memory) => memory.belongs_to(scene),
        None if strategy.needs_memory() => {
            let allowed = "a memory of motion for the strategies knn and gpr";
            Err(error::value(format!(
                "memory is missing; allowed: {allowed}"
            )))
        }
        None => Ok(()),
    }
}

#[pymethods]
impl Controller {
    #[new]
    #[pyo3(signature = (scene, memory=None, strategy="foresight", **settings))]
    fn new(
        scene: &Scene,
        memory: Option<&Memory>,
        strategy: &str,
        settings: Option<&Bound<'_, PyDict>>,
    ) -> PyResult<Self> {
        let settings = settings_of(strategy, settings)?;
        check_memory(scene, memory, settings.strategy)?;
        let daemon = Daemon::try_new(memory.map(|memory| memory.file.clone()), |memory| {
            Simulated::new(&scene.scene, memory.as_deref(), settings, ClockMode::Fixed)
        });
        Ok(Self {
            running: Mutex::new(Running {
                daemon: daemon.map_err(error::value)?,
                frames: 0,
                twist: [0.0; 6],
            }),
            points: scene.scene.pattern.len(),
            joints: scene.joints(),
        })
    }

    /// Decides one cycle.
    ///
    /// `points`: image points (u right, v down) in the order of the pattern, px, shape (N, 2); None
    /// where no frame came. `time_s`: when the command takes effect, s after the begin of the run,
    /// never less than before. `visible`: N flags, which points the frame shows; the others may
    /// have any value. `exposed_s`: when the frame was exposed; None: at `time_s`. `wanted`: with
    /// the strategy "follow", the twist that is wanted (m/s and rad/s, camera frame, shape (6,));
    /// None: the camera brakes. `joints`: positions of the joints of the scene's arm, base to
    /// camera, at `time_s`, rad (m where one slides), shape (J,); None: where the scene has an arm,
    /// the camera holds.
    ///
    /// Nothing is raised where the points cannot be trusted: the step then has a `hold`, and its
    /// twist is zero or a brake. Raises ValueError for another shape, a time out of range, and
    /// joints that are not finite or of no arm.
    #[pyo3(signature = (
        points, time_s, visible=None, exposed_s=None, wanted=None, joints=None
    ))]
    #[expect(clippy::too_many_arguments, reason = "keywords, in Python")]
    fn step(
        &self,
        py: Python<'_>,
        points: Option<&Bound<'_, PyAny>>,
        time_s: f64,
        visible: Option<Vec<bool>>,
        exposed_s: Option<f64>,
        wanted: Option<&Bound<'_, PyAny>>,
        joints: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Step> {
        let joints = joints.map(|joints| self.joints(joints)).transpose()?;
        let wanted = wanted.map(array::twist).transpose()?;
        let now_ns = nanoseconds("time_s", time_s)?;
        let exposed_ns = exposed_s.map_or(Ok(now_ns), |s| nanoseconds("exposed_s", s))?;
        let points = points.map(|points| array::rows("points", points, Some(self.points)));
        let frame = points.transpose()?;
        let mut frame = frame.map(|points| Features::new(&points, exposed_ns));
        if let (Some(frame), Some(visible)) = (&mut frame, visible) {
            if visible.len() != self.points {
                let (found, allowed) = (visible.len(), self.points);
                let message = format!("visible: {found} flags; allowed: {allowed}");
                return Err(error::value(message));
            }
            let bits = visible.iter().enumerate();
            frame.visible = bits.map(|(k, is_seen)| u32::from(*is_seen) << k).sum();
        }
        let record = py.detach(|| {
            let running = &mut *self.running();
            if let Some(frame) = &mut frame {
                running.frames += 1;
                frame.stamp.sequence = running.frames;
            }
            let robot = joints.map(|q| RobotState {
                mode: RobotMode::Moving.code(),
                joints: self.joints as u32,
                q,
                // It is taken to do as it was told.
                twist: running.twist,
                ..RobotState::default()
            });
            let mut inputs = Simulated::heard(frame, robot, now_ns);
            if let Some(twist) = wanted {
                // For this step alone.
                let mut desired = DesiredTwist::until(twist, inputs.now_ns + 1);
                desired.stamp.published_ns = inputs.now_ns;
                inputs.desired = Input::Message(desired);
            }
            let daemon = &mut running.daemon;
            let record = daemon.with_dependent_mut(|_, daemon| daemon.decide(&inputs));
            running.twist = record.twist;
            record
        });
        Ok(Step::of(&record))
    }

    /// Tells that the camera obeys another twist than that of the last step (m/s and rad/s, camera
    /// frame, shape (6,)), from `time_s` on. Without this call it obeys the step's from its time
    /// on. Raises ValueError for another shape, a number that is not finite, or a time out of
    /// range.
    fn sent(&self, py: Python<'_>, twist: &Bound<'_, PyAny>, time_s: f64) -> PyResult<()> {
        let (twist, at_ns) = (array::twist(twist)?, nanoseconds("time_s", time_s)?);
        py.detach(|| {
            let daemon = &mut self.running().daemon;
            daemon.with_dependent_mut(|_, daemon| daemon.sent(&twist, at_ns));
        });
        Ok(())
    }

    /// Thinks ahead, between two steps: foresight simulates futures, others do nothing. The work is
    /// bounded; call it once after each step.
    fn think(&self, py: Python<'_>) {
        py.detach(|| {
            let daemon = &mut self.running().daemon;
            daemon.with_dependent_mut(|_, daemon| daemon.think());
        });
    }

    /// Begins a new run: everything of the last one is forgotten, and its times.
    fn reset(&self, py: Python<'_>) {
        py.detach(|| {
            let running = &mut *self.running();
            (running.frames, running.twist) = (0, [0.0; 6]);
            let daemon = &mut running.daemon;
            daemon.with_dependent_mut(|_, daemon| daemon.restart());
        });
    }

    /// What foresight expects.
    #[getter]
    fn foreseen(&self, py: Python<'_>) -> Foreseen {
        py.detach(|| {
            let daemon = &self.running().daemon;
            daemon.with_dependent(|_, daemon| Foreseen::of(daemon.law()))
        })
    }

    /// The strategy, as "foresight" or "knn5".
    #[getter]
    fn strategy(&self, py: Python<'_>) -> String {
        py.detach(|| {
            let daemon = &self.running().daemon;
            daemon.with_dependent(|_, daemon| daemon.law().settings().strategy.to_string())
        })
    }

    fn __repr__(&self, py: Python<'_>) -> String {
        format!("Controller({:?})", self.strategy(py))
    }
}
