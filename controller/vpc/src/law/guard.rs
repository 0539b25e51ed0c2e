//! The law as a guardian: another program wants a twist, and the camera gets the nearest one that
//! keeps the points in sight and the limits, and from which it can stop.
//!
//! The constraints are those of every other cycle. The cost is (v - v_d)' R (v - v_d), with v_d
//! the wanted twist; no goal counts, and nothing is foreseen.

use crate::command::{Policy, Present};
use crate::law::{Law, Step};
use crate::measurement::{Measurement, Refusal};
use crate::prediction::repeated;
use crate::problem::Status;
use crate::{DOF, Twist, features, recall};

/// Clearance that is kept beside that of other cycles, px. What the last check allows, and what a
/// way misses while the camera slows down, are together below it.
const SPARE_PX: f64 = 0.5;

impl<W: AsRef<[f64]> + AsMut<[f64]>> Law<W> {
    /// One cycle: measured features and a wanted camera twist (camera frame, m/s and rad/s) in, the
    /// nearest allowed one out. A wanted twist that is allowed passes to the last bit. `None`, and
    /// one that is not finite, brakes. Never allocates; its work is bounded.
    ///
    /// # Errors
    /// [`Refusal`] if the features cannot be trusted: send the zero twist.
    pub fn guard(
        &mut self,
        measurement: &Measurement,
        wanted: Option<&Twist>,
    ) -> Result<Step, Refusal> {
        (self.root, self.has_thought) = (None, false);
        let (initial, _) = self.see(measurement)?;
        let mut step = Step {
            clearance_px: recall::clearance(&self.task, &initial),
            error_px: features::largest_error(&initial.points, &self.task.goal),
            ..Step::default()
        };
        let period = self.task.period;
        let dampers = self.task.dampers(initial.q.as_ref(), period, None);
        let dampers = dampers.as_ref();
        let is_finite = |twist: &&Twist| twist.iter().all(|v| v.is_finite());
        let wanted = wanted.filter(is_finite).unwrap_or(&[0.0; DOF]);
        let present = Present {
            initial: &initial,
            standing: &self.state.standing,
            interval: period,
            warm: &self.state.previous,
            extra_px: self.back_off_px(&initial) + SPARE_PX,
            dampers,
            wanted: None,
        };
        let policy = Policy {
            task: &self.task,
            settings: &self.settings,
        };
        match self.share.solver(&self.settings, self.workspace.as_mut()) {
            Some(mut solver) => step.twist = policy.nearest(&mut solver, &present, wanted),
            None => step.status = Status::NumericalFailure,
        }
        self.state.previous = repeated(&step.twist);
        self.finish(&initial, dampers, &mut step);
        Ok(step)
    }
}
