//! What foresight expects.

use ::vpc::Law;
use ::vpc::foresight::Outcome;
use decision::contract;
use messages::{CycleRecord, ForesightCode};
use numpy::PyArray3;
use pyo3::prelude::*;

use crate::array;
use crate::step::word;

/// What foresight expects of the future that it follows.
#[pyclass(frozen, module = "vpc")]
pub struct Foreseen {
    /// "arrives", "nears" (it stalls or the horizon ends) or "unknown".
    #[pyo3(get)]
    outcome: &'static str,
    /// Sum of l(v) / Np over the periods until the arrival; None if it does not arrive.
    #[pyo3(get)]
    cost: Option<f64>,
    /// Time until the arrival in steps of the prediction; None if it does not arrive.
    #[pyo3(get)]
    steps: Option<f64>,
    /// Least distance from the goal (largest component) of a future that only nears it, px.
    #[pyo3(get)]
    error_px: Option<f64>,
    /// The guide that it follows: "goal", "refined way" and others; "off" for other strategies.
    #[pyo3(get)]
    guide: String,
    /// Steps from one place of the path to the next.
    #[pyo3(get)]
    every: u32,
    /// Candidates tried after the last step.
    #[pyo3(get)]
    tried: u32,
    /// Steps simulated after the last step.
    #[pyo3(get)]
    simulated: u32,
    points: usize,
    path: Vec<Vec<[f64; 2]>>,
}

impl Foreseen {
    /// What this law expects.
    pub fn of(law: &Law<Vec<f64>>) -> Self {
        let foresight = law.foreseen();
        let mut record = CycleRecord::default();
        if law.settings().strategy == ::vpc::Strategy::Foresight {
            contract::record_foresight(foresight, law.task().ts, &mut record);
        }
        let (outcome, cost, steps, error_px) = match foresight.outcome {
            Outcome::Arrives { cost, steps } => ("arrives", Some(cost), Some(steps), None),
            Outcome::Nears { error_px } => ("nears", None, None, Some(error_px)),
            Outcome::Unknown => ("unknown", None, None, None),
        };
        let path = &foresight.path;
        let points = path.points as usize;
        let places = path.places.iter().take(path.count as usize).map(|place| {
            let pixels = place.iter().take(points);
            pixels.map(|pixel| pixel.map(f64::from)).collect()
        });
        Self {
            outcome,
            cost,
            steps,
            error_px,
            guide: word(ForesightCode::from_code(record.foresight)),
            every: path.every,
            tried: foresight.tried,
            simulated: foresight.simulated,
            points,
            path: places.collect(),
        }
    }
}

#[pymethods]
impl Foreseen {
    /// Image points of the expected path at K places, K at most 8, px, shape (K, N, 2).
    #[getter]
    fn path<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray3<f64>>> {
        array::of_path(py, &self.path, self.points)
    }

    fn __repr__(&self) -> String {
        let Self {
            outcome,
            cost,
            steps,
            ..
        } = self;
        let number = |x: &Option<f64>| x.map_or("None".to_owned(), |x| x.to_string());
        let (cost, steps) = (number(cost), number(steps));
        format!("Foreseen({outcome:?}, cost={cost}, steps={steps})")
    }
}
