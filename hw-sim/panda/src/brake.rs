//! Stops: each joint brakes by itself, at a share of its bounds. How the real robot brakes is not
//! published: this is an assumption.

use crate::kinematics::{JOINTS, Joints};
use crate::limits::{BRAKING, JOINT, PERIOD, Setpoint};
use crate::ramp::Ramp;

/// Greatest velocity and acceleration that count as standing, rad/s and rad/s^2: less than the jerk
/// of one period makes.
const STILL: (f64, f64) = (1e-9, 1e-5);

/// The desired joints one period later on the way to a stop.
pub fn brake(from: &Setpoint) -> Setpoint {
    let mut dq = Joints::zeros();
    let mut still = true;
    for k in 0..JOINTS {
        let ramp = Ramp {
            acceleration: BRAKING * JOINT[k].acceleration,
            jerk: BRAKING * JOINT[k].jerk,
        };
        let (velocity, acceleration) = ramp.step(from.dq[k], from.ddq[k], 0.0, PERIOD);
        still &= velocity.abs() < STILL.0 && acceleration.abs() < STILL.1;
        dq[k] = velocity;
    }
    if still {
        Setpoint::at_rest(from.q)
    } else {
        from.after(&dq)
    }
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;
    use crate::limits::Exceeded;

    #[test]
    fn a_stop_from_any_allowed_motion_stays_within_the_bounds() {
        let mut random = ChaCha8Rng::seed_from_u64(2);
        let mut judged = 0;
        for _ in 0..2000 {
            let mut state = Setpoint::at_rest(Joints::zeros());
            for (k, bound) in JOINT.iter().enumerate() {
                state.q[k] = random.random_range(bound.lower..bound.upper);
                state.dq[k] = bound.velocity * random.random_range(-1.0..1.0);
                state.ddq[k] = bound.acceleration * random.random_range(-1.0..1.0);
            }
            // What the robot would not have accepted need not be stopped; nor what is about to pass
            // its top speed.
            let gained = |k: usize| state.dq[k] + 2e-3 * state.ddq[k];
            let fast = (0..JOINTS).any(|k| gained(k).abs() > JOINT[k].velocity);
            if fast || state.exceeded(&state) != Exceeded::default() {
                continue;
            }
            judged += 1;
            let mut ticks = 0;
            while !state.is_at_rest() {
                let next = brake(&state);
                let exceeded = state.exceeded(&next);
                assert!(!exceeded.velocity && !exceeded.acceleration && !exceeded.jerk);
                assert!(crate::limits::outside(&next.q).is_none(), "{}", next.q);
                state = next;
                ticks += 1;
                assert!(ticks < 500);
            }
        }
        assert!(judged > 200, "{judged}");
    }
}
