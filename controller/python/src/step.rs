//! What one cycle decided.

use std::fmt::Display;

use messages::{CycleRecord, Hold, RecallCode, SolverStatus, TwistState};
use numpy::{PyArray1, PyArray2};
use pyo3::prelude::*;
use system_tests::run;

use crate::array;

/// What one cycle decided.
#[pyclass(frozen, module = "vpc")]
pub struct Step {
    twist: [f64; 6],
    way_point: Option<Vec<[f64; 2]>>,
    /// Velocity of the arm's elbow, rad/s; 0 where none was told of, or it is held.
    #[pyo3(get)]
    elbow: f64,
    /// "moving", "arrived", "holding", "braking" or "disarmed".
    #[pyo3(get)]
    state: String,
    /// Why the law's twist was not commanded; None if it was.
    #[pyo3(get)]
    hold: Option<String>,
    /// How the solver ended: "idle", "converged", "iteration limit", "stalled", "infeasible" or
    /// "numerical failure".
    #[pyo3(get)]
    status: String,
    /// What the memory answered: "not asked", "followed", "out of range" or "replaced by the
    /// nearest neighbour's".
    #[pyo3(get)]
    recalled: String,
    /// Iterations of the solver.
    #[pyo3(get)]
    iterations: u32,
    /// The paper's running cost l(v) of the command, against the goal; over Np it is that of a run.
    #[pyo3(get)]
    cost: f64,
    /// Worst violation predicted over the window, px.
    #[pyo3(get)]
    violation_px: f64,
    /// Least clearance of a point from an occlusion, px.
    #[pyo3(get)]
    clearance_px: f64,
    /// Largest component of the distance from the goal, px.
    #[pyo3(get)]
    error_px: f64,
}

impl Step {
    /// The step of a cycle's record.
    pub fn of(record: &CycleRecord) -> Self {
        Self {
            twist: record.twist,
            way_point: run::way_point(record),
            elbow: record.elbow,
            state: word(TwistState::from_code(record.state)),
            hold: Hold::from_code(record.hold).map(|hold| hold.to_string()),
            status: word(SolverStatus::from_code(record.status)),
            recalled: word(RecallCode::from_code(record.recalled)),
            iterations: record.iterations,
            cost: record.cost,
            violation_px: record.violation_px,
            clearance_px: record.clearance_px,
            error_px: record.error_px,
        }
    }
}

/// The word of a code.
pub fn word(code: Option<impl Display>) -> String {
    code.map_or_else(String::new, |code| code.to_string())
}

#[pymethods]
impl Step {
    /// The command: camera twist, linear m/s, angular rad/s, camera frame, shape (6,).
    #[getter]
    fn twist<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        array::of_vector(py, &self.twist)
    }

    /// Image points that the law tracks instead of the goal, px, shape (N, 2); None: the goal.
    #[getter]
    fn way_point<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyArray2<f64>>>> {
        let points = self.way_point.as_ref();
        points.map(|points| array::of_rows(py, points)).transpose()
    }

    fn __repr__(&self) -> String {
        let Self {
            twist, state, hold, ..
        } = self;
        match hold {
            Some(hold) => format!("Step({twist:?}, {state:?}, hold={hold:?})"),
            None => format!("Step({twist:?}, {state:?})"),
        }
    }
}
