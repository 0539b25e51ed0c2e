//! The exact camera with its referee.

use std::sync::{Mutex, MutexGuard, PoisonError};

use hw_sim::camera::outlines;
use hw_sim::referee::INSTANTS;
use hw_sim::{End, Referee, pose};
use numpy::{PyArray1, PyArray2};
use pyo3::prelude::*;

use crate::scene::{self, Scene};
use crate::{array, error};

/// A camera that moves exactly as told, as in the paper's simulations, and the referee that judges
/// what it sees: the emulator's mathematics, not the law's.
///
/// `start`: pose of the object in the camera frame, tx, ty, tz (m), rx, ry, rz (rad), shape (6,);
/// ValueError for another shape, or an object behind the camera.
#[pyclass(frozen, module = "vpc")]
pub struct FreeCamera {
    judged: Mutex<Judged>,
    scene: ::scene::Scene,
}

struct Judged {
    camera: hw_sim::FreeCamera,
    referee: Referee,
    time_s: f64,
    has_arrived: bool,
    fault: Option<String>,
}

impl Judged {
    /// Judges what a frame shows now, or the instant between two frames.
    fn look(&mut self, scene: &::scene::Scene, is_frame: bool) {
        self.referee
            .measure_edges(outlines(scene, &self.camera.pose));
        let end = match self.camera.features() {
            Ok(points) if is_frame => self.referee.judge(&points),
            Ok(points) => self.referee.judge_between(&points),
            Err(hidden) => {
                self.fault.get_or_insert(hidden.to_string());
                return;
            }
        };
        match end {
            Some(End::Violation(violation)) => {
                self.fault.get_or_insert(violation.to_string());
            }
            Some(End::Arrived) => self.has_arrived = true,
            _ => (),
        }
    }

    /// Moves for `seconds`, before the eyes of the referee.
    fn go(&mut self, scene: &::scene::Scene, twist: &[f64; 6], seconds: f64) {
        for instant in 1..=INSTANTS {
            self.camera.advance(twist, seconds / f64::from(INSTANTS));
            self.look(scene, instant == INSTANTS);
        }
        self.time_s += seconds;
    }
}

impl FreeCamera {
    fn judged(&self) -> MutexGuard<'_, Judged> {
        self.judged.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[pymethods]
impl FreeCamera {
    #[new]
    fn new(scene: &Scene, start: &Bound<'_, PyAny>) -> PyResult<Self> {
        let start = Scene::pose("start", array::vector("start", start)?)?;
        let mut judged = Judged {
            camera: hw_sim::FreeCamera::new(&scene.scene, &start),
            referee: Referee::new(&scene.scene),
            time_s: 0.0,
            has_arrived: false,
            fault: None,
        };
        judged.look(&scene.scene, true);
        Ok(Self {
            judged: Mutex::new(judged),
            scene: scene.scene.clone(),
        })
    }

    /// True image points of the pattern (u right, v down), px, shape (N, 2). Raises ValueError
    /// where one is behind the camera.
    #[getter]
    fn points<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let points = self.judged().camera.features();
        array::of_rows(py, &points.map_err(error::value)?)
    }

    /// Pose of the object in the camera frame, m and rad, shape (6,).
    #[getter]
    fn pose<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        let pose = pose::to_scene(&self.judged().camera.pose);
        array::of_vector(py, &scene::numbers(&pose))
    }

    /// Moves the camera with a constant twist (linear m/s, angular rad/s, camera frame, shape (6,))
    /// for some `seconds`, a period of the scene's camera by default. The referee looks at twelve
    /// instants, the last one that of the next frame. Raises ValueError for another shape, a number
    /// that is not finite, or `seconds` that are not 0 to 1.
    #[pyo3(name = "move", signature = (twist, seconds=None))]
    fn go(&self, twist: &Bound<'_, PyAny>, seconds: Option<f64>) -> PyResult<()> {
        let twist = array::twist(twist)?;
        let seconds = seconds.unwrap_or(self.scene.sampling_time());
        if !(0.0..=1.0).contains(&seconds) {
            let message = format!("seconds = {seconds}; allowed: 0 to 1 s");
            return Err(error::value(message));
        }
        self.judged().go(&self.scene, &twist, seconds);
        Ok(())
    }

    /// The referee's verdict so far: "arrived" (a frame was within the scene's threshold),
    /// "violation" (a point was too deep in an occlusion, outside the image or behind the camera,
    /// also after an arrival), or None.
    #[getter]
    fn referee(&self) -> Option<&'static str> {
        let judged = self.judged();
        let arrived = judged.has_arrived.then_some("arrived");
        judged.fault.as_ref().map(|_| "violation").or(arrived)
    }

    /// The first violation in words; None without one.
    #[getter]
    fn violation(&self) -> Option<String> {
        self.judged().fault.clone()
    }

    /// Least distance of a point from an occlusion or the image's border at any instant so far, px;
    /// negative inside.
    #[getter]
    fn least_clearance_px(&self) -> f64 {
        let judged = self.judged();
        let referee = &judged.referee;
        referee.least_clearance().min(referee.least_between())
    }

    /// Time that the camera has moved, s.
    #[getter]
    fn time_s(&self) -> f64 {
        self.judged().time_s
    }
}
