//! A law in Python, in the place of ours.

use ::vpc::{Settings, Task};
use decision::{Input, Inputs};
use messages::CycleRecord;
use pyo3::prelude::*;
use scene::Scene;
use system_tests::steering::Steering;

use crate::{array, error};

/// A callable `law(points, time_s)` that returns a twist. Where it has a method `reset`, each run
/// begins with that.
pub struct OwnLaw<'py> {
    law: Bound<'py, PyAny>,
    task: Task,
    begin_ns: Option<u64>,
}

impl<'py> OwnLaw<'py> {
    /// A law for this scene, under the scene's limits; without limits of acceleration, the command
    /// goes from zero to its limits in `brake_s`, s.
    ///
    /// # Errors
    /// `ValueError`, which no scene that was read gives.
    pub fn new(law: Bound<'py, PyAny>, scene: &Scene, brake_s: f64) -> PyResult<Self> {
        let settings = Settings {
            brake_s,
            ..Settings::default()
        };
        let mut task = Task::new(scene).map_err(error::value)?;
        task.acceleration = settings.acceleration(&scene.limits);
        Ok(Self {
            law,
            task,
            begin_ns: None,
        })
    }

    /// Its name: that of the function or of the class.
    pub fn name(&self) -> PyResult<String> {
        let named = self.law.getattr("__name__");
        let name = named.or_else(|_| self.law.get_type().getattr("__name__"));
        name?.extract()
    }
}

impl Steering for OwnLaw<'_> {
    type Error = PyErr;

    fn task(&self) -> &Task {
        &self.task
    }

    fn np(&self) -> usize {
        Settings::default().np
    }

    fn begin(&mut self) -> PyResult<()> {
        self.begin_ns = None;
        match self.law.getattr_opt("reset")? {
            Some(reset) => reset.call0().map(|_| ()),
            None => Ok(()),
        }
    }

    fn answer(&mut self, inputs: &Inputs) -> PyResult<CycleRecord> {
        let py = self.law.py();
        let begin_ns = *self.begin_ns.get_or_insert(inputs.now_ns);
        let time_s = (inputs.now_ns - begin_ns) as f64 * 1e-9;
        let points = match &inputs.features {
            Input::Message(features) => {
                let shows = |k: usize| features.visible & (1 << k) != 0;
                let points = features.pairs().enumerate();
                let points: Vec<_> = points
                    .map(|(k, point)| if shows(k) { point } else { [f64::NAN; 2] })
                    .collect();
                Some(array::of_rows(py, &points)?)
            }
            _ => None,
        };
        let twist = array::twist(&self.law.call1((points, time_s))?)?;
        Ok(CycleRecord {
            twist,
            cost: f64::NAN,
            ..CycleRecord::default()
        })
    }
}
