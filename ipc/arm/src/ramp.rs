//! The fastest way from one velocity to another under bounds on acceleration and jerk.
//!
//! Source: J. Han, "From PID to Active Disturbance Rejection Control", IEEE Trans. Ind. Electron.
//! 56(3), 2009, the discrete time-optimal law of a double integrator. It ends at the target without
//! chatter; it overshoots by less than a fifth of what one period's jerk makes, unless the
//! acceleration at the beginning forces more.

use libm::sqrt;

/// The bounds of a ramp.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ramp {
    /// Greatest acceleration, m/s^2 or rad/s^2, positive.
    pub acceleration: f64,
    /// Greatest jerk, m/s^3 or rad/s^3, positive.
    pub jerk: f64,
}

impl Ramp {
    /// Velocity and acceleration after the next period of `dt` seconds on the way to `target`.
    ///
    /// The acceleration is the difference quotient of velocities, as the robot computes it, and
    /// changes by no more than the jerk allows even where it is beyond its bound at the beginning.
    pub fn step(&self, velocity: f64, acceleration: f64, target: f64, dt: f64) -> (f64, f64) {
        let (error, step) = (velocity - target, self.jerk * dt * dt);
        // By this much the velocity changes while the acceleration is brought to zero.
        let change = match error.abs() > step {
            true => {
                let root = sqrt(step * (step + 8.0 * error.abs()));
                0.5 * error.signum() * (root - step)
            }
            false => error,
        };
        let most = self.jerk * dt;
        let jerk = -most * ((dt * acceleration + change) / step).clamp(-1.0, 1.0);
        let wanted = (acceleration + jerk).clamp(-self.acceleration, self.acceleration);
        let next = acceleration + (wanted - acceleration).clamp(-most, most);
        (velocity + next * dt, next)
    }
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;

    const DT: f64 = 1e-3;
    const RAMP: Ramp = Ramp {
        acceleration: 1.2,
        jerk: 150.0,
    };

    #[test]
    fn random_targets_are_followed_within_the_bounds() {
        let mut random = ChaCha8Rng::seed_from_u64(1);
        let (mut v, mut a, mut target) = (0.0, 0.0, 0.0);
        for tick in 0..100_000 {
            if tick % 33 == 0 {
                target = random.random_range(-0.05..0.05);
            }
            let (next, acceleration) = RAMP.step(v, a, target, DT);
            assert!(acceleration.abs() <= RAMP.acceleration * (1.0 + 1e-12));
            assert!((acceleration - a).abs() <= RAMP.jerk * DT * (1.0 + 1e-9));
            assert!(((next - v) / DT - acceleration).abs() < 1e-9);
            (v, a) = (next, acceleration);
        }
    }

    #[test]
    fn a_ramp_takes_its_time_and_hardly_overshoots() {
        // 0.5 m/s at 1.2 m/s^2, the acceleration built up and taken down in 8 ms each.
        let (mut v, mut a) = (0.0f64, 0.0f64);
        let mut ticks = 0;
        while (0.5 - v).abs() > 1e-12 {
            (v, a) = RAMP.step(v, a, 0.5, DT);
            ticks += 1;
            assert!(v < 0.5 + 0.2 * RAMP.jerk * DT * DT && ticks < 1000);
        }
        let shortest: f64 = 0.5 / 1.2 + 1.2 / 150.0;
        assert!(ticks as f64 * DT < shortest + 4.0 * DT);
        for _ in 0..100 {
            (v, a) = RAMP.step(v, a, 0.5, DT);
        }
        assert!((v - 0.5).abs() < 1e-12 && a.abs() < 1e-9);
    }

    #[test]
    fn up_and_down_are_mirror_images() {
        let (mut v, mut a, mut w, mut b) = (0.0, 0.0, 0.0, 0.0);
        for _ in 0..100 {
            (v, a) = RAMP.step(v, a, 0.04, DT);
            (w, b) = RAMP.step(w, b, -0.04, DT);
            assert_eq!((v, a), (-w, -b));
        }
    }
}
