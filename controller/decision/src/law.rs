//! What to command after a step of the law: a last check of its twist, and whether the camera has
//! arrived.

use memory_blob::Memory;
use messages::{Hold, TwistState};
use scene::Scene;
use vpc::{Status, Step, Strategy};

use crate::decision::Decision;

/// A twist with all components below this share of their limits is near zero: ten times the
/// changes by which a camera with a noise of 0.3 px regulates.
const AT_REST: f64 = 0.05;
/// A camera that has arrived leaves the goal when the error is this multiple of the threshold of
/// convergence.
const LEAVES: f64 = 2.0;
/// Rounding that a command may have beyond the limits, as a share of them.
const ROUNDING: f64 = 1e-9;

/// What a scene says about the law's twist.
#[derive(Clone, Copy, Debug)]
pub struct Bounds {
    /// Largest magnitude of each component, m/s and rad/s.
    limits: [f64; 6],
    /// Error below which the camera is at the goal, px.
    convergence_px: f64,
}

impl Bounds {
    /// Those of a scene.
    pub fn of(scene: &Scene) -> Self {
        Self {
            limits: scene.limits.velocity(),
            convergence_px: scene.success.convergence_px,
        }
    }

    /// The command after this step of the law against a pattern with this twist. `had_arrived` is
    /// whether the last one was [`TwistState::Arrived`].
    pub fn decide(&self, step: &Step, own: &[f64; 6], had_arrived: bool) -> Decision {
        if step.status == Status::NumericalFailure {
            return Decision::hold(Hold::Solver);
        }
        if !self.is_within(&step.twist, 1.0 + ROUNDING) {
            return Decision::hold(Hold::BadTwist);
        }
        if step.stands {
            return Decision::hold(Hold::NoWay);
        }
        let has_arrived = self.has_arrived(step, own, had_arrived);
        Decision {
            twist: step.twist,
            // At the goal the whole arm comes to rest.
            elbow: if has_arrived { 0.0 } else { step.elbow },
            state: match has_arrived {
                true => TwistState::Arrived,
                false => TwistState::Moving,
            },
            hold: None,
        }
    }

    /// Whether the camera has arrived: it is at the goal and all but at rest against the pattern;
    /// and from then on until it is clearly away.
    fn has_arrived(&self, step: &Step, own: &[f64; 6], had_arrived: bool) -> bool {
        let relative = core::array::from_fn(|k| step.twist[k] - own[k]);
        match had_arrived {
            true => step.error_px < LEAVES * self.convergence_px,
            false => step.error_px < self.convergence_px && self.is_within(&relative, AT_REST),
        }
    }

    /// Whether no component is beyond this share of its limit; a NaN is. This last check of a
    /// command is independent of the law.
    fn is_within(&self, twist: &[f64; 6], share: f64) -> bool {
        let mut pairs = twist.iter().zip(self.limits);
        pairs.all(|(v, limit)| v.abs() <= limit * share)
    }
}

/// Whether a memory, or none, has what a strategy asks of it.
pub fn has_memory(memory: Option<&Memory>, strategy: Strategy) -> bool {
    match memory {
        Some(memory) => strategy != Strategy::Gpr || memory.gpr().is_some(),
        None => !strategy.needs_memory(),
    }
}

#[cfg(test)]
mod tests {
    use vpc::{Law, Measurement, Settings};

    use super::*;

    #[test]
    fn near_the_goal_it_has_arrived_only_at_rest() {
        let scene = Scene::parse(scene::PAPER_SIM, "sim").unwrap();
        let mut law = Law::new(&scene, Settings::default(), |len| vec![0.0; len]).unwrap();
        let goal = law.task().goal.clone();
        let points: Vec<_> = goal.iter().map(|p| [p[0] + 1.0, p[1]]).collect();
        let mut step = law.step(&Measurement::from_points(&points), None).unwrap();
        assert!(step.error_px < 2.0);
        step.twist = [0.0, 0.0, 0.1 * scene.limits.linear, 0.0, 0.0, 0.0];
        let bounds = Bounds::of(&scene);
        let still = [0.0; 6];
        assert!(!bounds.has_arrived(&step, &still, false));
        assert!(bounds.has_arrived(&step, &still, true));
        // With the pattern.
        assert!(bounds.has_arrived(&step, &step.twist, false));
    }

    #[test]
    fn a_command_beyond_the_limits_or_not_finite_is_not_within() {
        let limits = Scene::parse(scene::PAPER_SIM, "sim").unwrap().limits;
        let bounds = Bounds {
            limits: limits.velocity(),
            convergence_px: 0.0,
        };
        let linear = |v| bounds.is_within(&[v, 0.0, 0.0, 0.0, 0.0, 0.0], 1.0);
        assert!(linear(limits.linear) && linear(-limits.linear));
        assert!(!linear(limits.linear * 1.01) && !linear(f64::NAN) && !linear(f64::INFINITY));
        let turning = [0.0, 0.0, 0.0, 0.0, 0.0, -1.01 * limits.angular];
        assert!(!bounds.is_within(&turning, 1.0));
    }
}
