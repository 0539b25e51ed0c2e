//! Recall: when to ask the memory, and what it says.

use crate::settings::Strategy;
use crate::task::Task;
use crate::{DOF, MAX_POINTS, Points, Twist, constraint, limit};

/// What the memory infers for some features: y = (v, way point).
#[derive(Clone, Debug, PartialEq)]
pub struct Recall {
    /// Warm start, inside the velocity limits.
    pub twist: Twist,
    /// Way point, px.
    pub way_point: Points,
}

/// Decides whether features are close to an occlusion, with hysteresis: close below `on` px, and then until every
/// feature is `off` px away, so that the law does not fall back on the goal at the edge of the zone.
#[derive(Clone, Copy, Debug)]
pub struct Trigger {
    on: f64,
    off: f64,
    close: bool,
}

impl Trigger {
    /// A trigger that closes below `on` px and opens above `release` times as much.
    pub fn new(on: f64, release: f64) -> Self {
        Self {
            on,
            off: on * release,
            close: false,
        }
    }

    /// Opens the trigger.
    pub fn reset(&mut self) {
        self.close = false;
    }

    /// Whether features are close.
    pub fn is_close(&self) -> bool {
        self.close
    }

    /// Goes on from another trigger's [`Trigger::is_close`].
    pub fn set_close(&mut self, close: bool) {
        self.close = close;
    }

    /// Takes the clearance of the nearest feature (px) and tells whether the memory is asked.
    pub fn update(&mut self, clearance: f64) -> bool {
        self.close = clearance < if self.close { self.off } else { self.on };
        self.close
    }
}

/// Least clearance of any feature from any occlusion, px.
pub fn clearance(task: &Task, points: &[[f64; 2]]) -> f64 {
    points
        .iter()
        .map(|&pixel| constraint::least_clearance(task, pixel))
        .fold(f64::INFINITY, f64::min)
}

/// A memory of motion: infers y = (v, way point) from x = (s, area, angle), raw units, without the heap.
///
/// The daemon asks a memory-mapped file, the builder the memory that it is growing.
pub trait MotionMemory {
    /// Writes the inferred output; `false` where the memory has no answer for this strategy and input.
    fn infer(&self, strategy: Strategy, input: &[f64], output: &mut [f64]) -> bool;
}

impl MotionMemory for memory_blob::Memory<'_> {
    fn infer(&self, strategy: Strategy, input: &[f64], output: &mut [f64]) -> bool {
        match strategy {
            Strategy::Knn { k } => self
                .samples()
                .is_some_and(|samples| samples.nearest(input, k, output).is_ok()),
            Strategy::Gpr => self
                .gpr()
                .is_some_and(|gpr| gpr.mean(input, output).is_ok()),
            Strategy::Previous | Strategy::Ibvs => false,
        }
    }
}

/// Asks the memory. `None` where it has no answer, or one that is not finite.
pub fn query(
    task: &Task,
    strategy: Strategy,
    memory: &dyn MotionMemory,
    points: &Points,
) -> Option<Recall> {
    let mut output = [0.0; DOF + 2 * MAX_POINTS];
    let output = output.get_mut(..DOF + 2 * points.len())?;
    let answered = memory.infer(strategy, &task.recall_input(points), output);
    answered
        .then(|| Recall::from_output(task, output))
        .flatten()
}

impl Recall {
    /// Splits an output y = (v, way point), clamps the twist to the limits and the way point to the image.
    pub fn from_output(task: &Task, output: &[f64]) -> Option<Self> {
        let (twist, way_point) = output.split_at_checked(DOF)?;
        if !output.iter().all(|y| y.is_finite()) {
            return None;
        }
        let twist: Twist = twist.try_into().ok()?;
        let (width, height) = (task.camera.width, task.camera.height);
        let way_point = way_point
            .chunks_exact(2)
            .map(|p| [p[0].clamp(0.0, width), p[1].clamp(0.0, height)])
            .collect();
        Some(Self {
            twist: limit::clamp(&twist, &task.limits),
            way_point,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_trigger_has_hysteresis() {
        let mut trigger = Trigger::new(20.0, 2.0);
        let seen: Vec<bool> = [30.0, 19.0, 30.0, 39.0, 41.0, 30.0]
            .map(|c| trigger.update(c))
            .into();
        assert_eq!(seen, [false, true, true, true, false, false]);
    }
}
