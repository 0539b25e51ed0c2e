//! Stops: each joint brakes by itself, at a share of its bounds. How the real robot brakes is not
//! published: this is an assumption.

use crate::kinematics::{JOINTS, Joints};
use crate::limits::{BRAKING, Limits, PERIOD, Setpoint};

/// Greatest velocity and acceleration that count as standing, rad/s and rad/s^2: less than the jerk
/// of one period makes.
const STILL: (f64, f64) = (1e-9, 1e-5);

/// The desired joints one period later on the way to a stop.
pub fn brake(from: &Setpoint, limits: &Limits) -> Setpoint {
    let mut dq = Joints::zeros();
    let mut still = true;
    for k in 0..JOINTS {
        let bounds = [limits.joints[k].acceleration, limits.joints[k].jerk].map(|b| BRAKING * b);
        let (velocity, acceleration) = approach(0.0, (from.dq[k], from.ddq[k]), bounds);
        still &= velocity.abs() < STILL.0 && acceleration.abs() < STILL.1;
        dq[k] = velocity;
    }
    if still {
        Setpoint::at_rest(from.q)
    } else {
        from.after(&dq)
    }
}

/// Velocity and acceleration a period later, on the fastest way to a velocity within bounds on
/// acceleration and jerk. Source: J. Han, "From PID to Active Disturbance Rejection Control", IEEE
/// Trans. Ind. Electron. 56(3), 2009, the discrete time-optimal law of a double integrator.
pub(crate) fn approach(
    target: f64,
    (velocity, acceleration): (f64, f64),
    [most, jerk]: [f64; 2],
) -> (f64, f64) {
    let (missing, quantum) = (velocity - target, jerk * PERIOD * PERIOD);
    let curve = if missing.abs() > quantum {
        let root = (quantum * (quantum + 8.0 * missing.abs())).sqrt();
        missing.signum() * (root - quantum) / 2.0
    } else {
        missing
    };
    let full = ((PERIOD * acceleration + curve) / quantum).clamp(-1.0, 1.0);
    let wanted = (acceleration - full * jerk * PERIOD).clamp(-most, most);
    let change = (wanted - acceleration).clamp(-jerk * PERIOD, jerk * PERIOD);
    let next = acceleration + change;
    (velocity + next * PERIOD, next)
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;
    use crate::limits::{Exceeded, Model};

    #[test]
    fn a_stop_from_any_allowed_motion_stays_within_the_bounds() {
        let mut random = ChaCha8Rng::seed_from_u64(2);
        let mut judged = [0; 2];
        for round in 0..4000 {
            let model = [Model::Panda, Model::Fr3][round % 2];
            let limits = model.limits();
            let mut state = Setpoint::at_rest(Joints::zeros());
            for (k, bound) in limits.joints.iter().enumerate() {
                state.q[k] = random.random_range(bound.lower..bound.upper);
                state.dq[k] = bound.velocity * random.random_range(-1.0..1.0);
                state.ddq[k] = bound.acceleration * random.random_range(-1.0..1.0);
            }
            // What the robot would not have accepted need not be stopped; nor what is about to pass
            // its top speed.
            let gained = |k: usize| state.dq[k] + 2e-3 * state.ddq[k];
            let is_fast = |k: usize| limits.joints[k].is_too_fast(state.q[k], gained(k));
            if (0..JOINTS).any(is_fast) || limits.joints(&state, &state) != Exceeded::default() {
                continue;
            }
            judged[round % 2] += 1;
            let mut ticks = 0;
            while !state.is_at_rest() {
                let next = brake(&state, limits);
                let exceeded = limits.joints(&state, &next);
                assert!(!exceeded.acceleration && !exceeded.jerk);
                // An FR3 may lose less in a period than its bound does towards the end.
                assert!(!exceeded.velocity || model == Model::Fr3);
                assert!(limits.outside(&next.q).is_none(), "{}", next.q);
                state = next;
                ticks += 1;
                assert!(ticks < 700);
            }
        }
        assert!(judged.iter().all(|&count| count > 200), "{judged:?}");
    }
}
