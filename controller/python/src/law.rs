//! A law in Python, in the place of ours.

use ::vpc::{Settings, Task};
use decision::{Input, Inputs};
use messages::CycleRecord;
use pyo3::prelude::*;
use system_tests::steering::Steering;

use crate::array;
use crate::scene::Scene;

/// A callable `law(points, time_s)` that returns a twist. Where it has a method `reset`, each run
/// begins with that.
pub struct OwnLaw<'py> {
    law: Bound<'py, PyAny>,
    task: Task,
    begin_ns: Option<u64>,
}

impl<'py> OwnLaw<'py> {
    /// A law for this scene, under the scene's limits.
    ///
    /// # Errors
    /// `ValueError`, which no scene that was read gives.
    pub fn new(law: Bound<'py, PyAny>, scene: &Scene) -> PyResult<Self> {
        let mut task = scene.task()?;
        task.acceleration = Settings::default().acceleration(&scene.scene.limits);
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
                let points: Vec<_> = features.pairs().collect();
                Some(array::of_rows(py, &points)?)
            }
            _ => None,
        };
        let twist = array::twist(&self.law.call1((points, time_s))?)?;
        Ok(CycleRecord {
            twist,
            ..CycleRecord::default()
        })
    }
}
