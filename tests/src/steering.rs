//! What steers the camera in a run.

use std::convert::Infallible;

use decision::Inputs;
use messages::CycleRecord;
use vpc::Task;

use crate::simulated::Simulated;

/// Rounding that a command may have beyond the limits, as a share of them.
const ROUNDING: f64 = 1e-9;

/// What steers the camera.
pub trait Steering {
    /// Why it cannot answer.
    type Error;

    /// The task, as it believes it to be.
    fn task(&self) -> &Task;

    /// Periods for which the cost of a command is counted.
    fn np(&self) -> usize;

    /// Begins a run.
    ///
    /// # Errors
    /// The run cannot begin.
    fn begin(&mut self) -> Result<(), Self::Error>;

    /// The command that answers what a cycle receives.
    ///
    /// # Errors
    /// No command can be given.
    fn answer(&mut self, inputs: &Inputs) -> Result<CycleRecord, Self::Error>;

    /// Whether a command that follows another one is within the limits of velocity and
    /// acceleration.
    fn is_within_limits(&self, twist: &[f64; 6], before: &[f64; 6]) -> bool {
        let task = self.task();
        let pairs = twist.iter().zip(before);
        let mut each = pairs.zip(task.limits.iter().zip(task.acceleration));
        each.all(|((v, before), (limit, acceleration))| {
            // A NaN is not within.
            let is_within = |x: f64, most: f64| x.abs() <= most * (1.0 + ROUNDING);
            is_within(*v, *limit) && is_within(v - before, acceleration * task.period)
        })
    }
}

impl Steering for Simulated<'_> {
    type Error = Infallible;

    fn task(&self) -> &Task {
        self.law().task()
    }

    fn np(&self) -> usize {
        self.law().settings().np
    }

    fn begin(&mut self) -> Result<(), Infallible> {
        self.restart();
        Ok(())
    }

    fn answer(&mut self, inputs: &Inputs) -> Result<CycleRecord, Infallible> {
        let record = self.decide(inputs);
        self.think();
        Ok(record)
    }
}
