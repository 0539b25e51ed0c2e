//! The emulated arm with its camera and its referee.

use std::sync::{Mutex, MutexGuard, PoisonError};

use decision::Input;
use hw_sim::End;
use hw_sim::cell::Cell;
use hw_sim::pose;
use hw_sim::robot::arm::ArmSettings;
use hw_sim::robot::inspector::ArmReport;
use messages::{CycleRecord, Features, TwistState};
use numpy::{PyArray1, PyArray2};
use pyo3::exceptions::PyRuntimeError;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use system_tests::flags::{self, RobotFlags};
use system_tests::robot::{Course, Trial};
use system_tests::robot_table;

use crate::flags::given;
use crate::scene::{self, Scene};
use crate::{array, error};

/// The flags that tell of arm and camera; the others tell of the law.
const FLAGS: [&str; 11] = [
    "noise",
    "drop",
    "depth_error",
    "motion",
    "seed",
    "delay_ms",
    "jitter_ms",
    "focal_error",
    "hand_eye_cm",
    "hand_eye_deg",
    "unshaped",
];

/// An emulated Franka Panda that carries the camera, its bridge from 30 Hz to 1 kHz, and the
/// referees of points and robot: the arm of `cargo table -- --robot panda`, in simulated time. At
/// the goal it releases the object and backs away; only then has it arrived.
///
/// `start`: pose of the object in the camera frame, tx, ty, tz (m), rx, ry, rz (rad), shape (6,).
/// `flags`: what the command's flags --noise, --drop, --depth-error, --motion, --seed, --delay-ms,
/// --jitter-ms, --focal-error, --hand-eye-cm, --hand-eye-deg and --unshaped are, with their
/// defaults: frames come 110 ms late. Start k of a table has the seed `seed` + k.
///
/// Raises ValueError for another shape, a start out of reach, or a flag that is unknown or out of
/// its range.
#[pyclass(frozen, module = "vpc")]
pub struct Panda {
    watched: Mutex<Watched>,
}

struct Watched {
    trial: Trial<'static>,
    frame: Option<Features>,
    /// When it was exposed, ns after the start.
    exposed_ns: u64,
}

impl Watched {
    /// Goes on to the next decision, or to the end.
    fn go_on(&mut self) -> PyResult<()> {
        let inputs = self.trial.receive().map_err(error::value)?;
        let now_ns = self.trial.rig().now_ns();
        self.frame = inputs.and_then(|inputs| match inputs.features {
            Input::Message(frame) => {
                // The controller's time begins elsewhere.
                let late_ns = inputs.now_ns - frame.stamp.data_ns;
                self.exposed_ns = now_ns - late_ns;
                Some(frame)
            }
            _ => None,
        });
        Ok(())
    }

    /// How it ended.
    fn end(&mut self) -> Option<&End> {
        self.trial.rig().progress().end.as_ref()
    }
}

impl Panda {
    fn watched(&self) -> MutexGuard<'_, Watched> {
        self.watched.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// What the robot's referee counted, as a dict; the stub tells of each key.
#[derive(IntoPyObject)]
pub struct Report {
    reflexes: u64,
    limit_violations: u64,
    discontinuities: u64,
    errors: Vec<String>,
    joint_velocity: f64,
    joint_acceleration: f64,
    joint_jerk: f64,
    joint_room: f64,
    steered_ms: u64,
    slowed_ms: u64,
}

impl From<&ArmReport> for Report {
    fn from(report: &ArmReport) -> Self {
        Self {
            reflexes: report.reflexes,
            limit_violations: report.limit_violations,
            discontinuities: report.discontinuities,
            errors: report.errors.iter().map(ToString::to_string).collect(),
            joint_velocity: report.joint_velocity,
            joint_acceleration: report.joint_acceleration,
            joint_jerk: report.joint_jerk,
            joint_room: report.joint_room,
            steered_ms: report.steered_ms,
            slowed_ms: report.slowed_ms,
        }
    }
}

#[pymethods]
impl Panda {
    #[new]
    #[pyo3(signature = (scene, start, **flags))]
    fn new(
        py: Python<'_>,
        scene: &Scene,
        start: &Bound<'_, PyAny>,
        flags: Option<&Bound<'_, PyDict>>,
    ) -> PyResult<Self> {
        let start = Scene::pose("start", array::vector("start", start)?)?;
        let is_allowed = |name: &str| FLAGS.contains(&name);
        let (common, robot) =
            flags::of_keywords::<RobotFlags>(&given(flags)?, is_allowed).map_err(error::value)?;
        robot.check(1).map_err(error::keyword)?;
        let arm = ArmSettings::default();
        let cell = robot_table::cell(&scene.scene, &arm, &robot, &common, 0);
        let course = Course {
            motion: common.motion(),
            follow_s: 0.0,
            rule: None,
        };
        // The cost is the law's, which is not here.
        let watched = py.detach(|| {
            let trial = Trial::new(&scene.scene, &cell, course, &start, 1);
            let trial = trial.map_err(|refused| error::value(format!("start: {refused}")))?;
            let mut watched = Watched {
                trial,
                frame: None,
                exposed_ns: 0,
            };
            watched.go_on()?;
            PyResult::Ok(watched)
        });
        Ok(Self {
            watched: Mutex::new(watched?),
        })
    }

    /// Image points of the newest frame that came since the last command, px, shape (N, 2); what it
    /// does not show has any value. None where no frame came.
    #[getter]
    fn points<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyArray2<f64>>>> {
        let frame = self.watched().frame;
        let points = frame.map(|frame| frame.pairs().collect::<Vec<_>>());
        points.map(|points| array::of_rows(py, &points)).transpose()
    }

    /// Which points that frame shows, N flags; None where no frame came.
    #[getter]
    fn visible(&self) -> Option<Vec<bool>> {
        let frame = self.watched().frame?;
        let shows = |k: u32| frame.visible & (1 << k) != 0;
        Some((0..frame.count).map(shows).collect())
    }

    /// When that frame was exposed, s; None where no frame came.
    #[getter]
    fn exposed_s(&self) -> Option<f64> {
        let watched = self.watched();
        watched.frame.map(|_| watched.exposed_ns as f64 * 1e-9)
    }

    /// True image points at the newest exposure, px, shape (N, 2).
    #[getter]
    fn true_points<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        array::of_rows(py, self.watched().trial.features())
    }

    /// True pose of the object in the camera frame, m and rad, shape (6,).
    #[getter]
    fn pose<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        let object = self.watched().trial.rig().object();
        array::of_vector(py, &scene::numbers(&pose::to_scene(&object)))
    }

    /// Twist that the camera carries out: linear m/s, angular rad/s, camera frame, shape (6,).
    #[getter]
    fn twist<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        array::of_vector(py, &self.watched().trial.rig().state().twist)
    }

    /// Measured positions of the joints, base to flange, rad, shape (7,).
    #[getter]
    fn joints<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        array::of_vector(py, &self.watched().trial.rig().record().q)
    }

    /// Obeys a twist (linear m/s, angular rad/s, camera frame, shape (6,)) and a velocity of the
    /// elbow (rad/s) until the next decision is due, a period later, or the run ends. As the bridge
    /// does, it cuts what is beyond the limits. Raises ValueError for another shape or a number
    /// that is not finite, and RuntimeError if the run has ended.
    #[pyo3(name = "move", signature = (twist, elbow=0.0))]
    fn go(&self, py: Python<'_>, twist: &Bound<'_, PyAny>, elbow: f64) -> PyResult<()> {
        let twist = array::twist(twist)?;
        if !elbow.is_finite() {
            let message = format!("elbow = {elbow}; allowed: a finite number of rad/s");
            return Err(error::value(message));
        }
        let record = CycleRecord {
            twist,
            elbow,
            state: TwistState::Moving.code(),
            cost: f64::NAN,
            ..CycleRecord::default()
        };
        py.detach(|| {
            let mut watched = self.watched();
            if watched.end().is_some() {
                return Err(PyRuntimeError::new_err("the run has ended"));
            }
            watched.trial.obey(&record, true);
            watched.go_on()
        })
    }

    /// The referee's verdict: "arrived" (the object was released at the goal, and the robot backed
    /// away), "violation" (a point was too deep in an occlusion, outside the image or behind the
    /// camera), "reflex" (the robot stopped itself), "time_out", or None while the run goes on.
    #[getter]
    fn referee(&self) -> Option<&'static str> {
        self.watched().end().map(|end| match end {
            End::Arrived => "arrived",
            End::Violation(_) | End::LostSight => "violation",
            End::Reflex => "reflex",
            End::TimeOut => "time_out",
        })
    }

    /// The violation in words; None without one.
    #[getter]
    fn violation(&self) -> Option<String> {
        match self.watched().end()? {
            End::Violation(violation) => Some(violation.to_string()),
            End::LostSight => Some("a point is behind the camera".to_owned()),
            _ => None,
        }
    }

    /// Least distance of a point from an occlusion or the image's border at any instant so far, px;
    /// negative inside.
    #[getter]
    fn least_clearance_px(&self) -> f64 {
        let mut watched = self.watched();
        let referee = &watched.trial.rig().progress().referee;
        referee.least_clearance().min(referee.least_between())
    }

    /// What the robot does: "waiting", "approach", "settling", "releasing", "retreating" or "done".
    /// From "releasing" on it moves by itself.
    #[getter]
    fn phase(&self) -> &'static str {
        self.watched().trial.rig().phase().name()
    }

    /// What the robot's referee counted so far; the stub tells of each key.
    #[getter]
    fn report(&self) -> Report {
        self.watched().trial.rig().report().into()
    }

    /// Time since the start, s.
    #[getter]
    fn time_s(&self) -> f64 {
        self.watched().trial.rig().now_ns() as f64 * 1e-9
    }
}
