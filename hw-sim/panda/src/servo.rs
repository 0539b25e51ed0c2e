//! Measured joints: they follow the desired ones with a lag.
//!
//! Each joint is a second-order system behind a velocity feed-forward. The numbers are assumptions
//! of a plausible size for an impedance-controlled arm, not measurements.

use crate::kinematics::Joints;
use crate::limits::{PERIOD, Setpoint};

/// Natural frequency, Hz.
const BANDWIDTH_HZ: f64 = 15.0;
/// Damping ratio; 1 is critical.
const DAMPING: f64 = 1.0;
/// Share of the desired velocity that is fed forward. The lag in steady motion is 2 damping (1 -
/// feedforward) / (2 pi bandwidth) seconds, 3 ms here after the period in which a set point already
/// acts is taken off.
const FEEDFORWARD: f64 = 0.8;

/// The measured joints.
#[derive(Clone, Copy, Debug)]
pub struct Servo {
    /// Positions, rad.
    pub q: Joints,
    /// Velocities, rad/s.
    pub dq: Joints,
}

impl Servo {
    /// Joints at rest at `q`.
    pub fn new(q: Joints) -> Self {
        Self {
            q,
            dq: Joints::zeros(),
        }
    }

    /// One period; `push` is what the surroundings add to the accelerations, rad/s^2.
    pub fn step(&mut self, desired: &Setpoint, push: &Joints) {
        let omega = std::f64::consts::TAU * BANDWIDTH_HZ;
        let damping = 2.0 * DAMPING * omega;
        let ddq = (desired.q - self.q) * (omega * omega)
            + (desired.dq * FEEDFORWARD - self.dq) * damping
            + push;
        self.dq += ddq * PERIOD;
        self.q += self.dq * PERIOD;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steady_motion_is_followed_with_the_lag_of_the_settings() {
        let mut servo = Servo::new(Joints::zeros());
        let mut desired = Setpoint::at_rest(Joints::zeros());
        desired.dq = Joints::repeat(0.3);
        for _ in 0..1000 {
            desired.q += desired.dq * PERIOD;
            servo.step(&desired, &Joints::zeros());
        }
        let lag = (desired.q - servo.q)[0] / 0.3;
        let expected = 2.0 * 0.2 / (std::f64::consts::TAU * 15.0) - PERIOD;
        assert!((lag - expected).abs() < 1e-6, "{lag} {expected}");
    }

    #[test]
    fn a_push_moves_a_joint_and_it_comes_back() {
        let mut servo = Servo::new(Joints::zeros());
        let desired = Setpoint::at_rest(Joints::zeros());
        let mut push = Joints::zeros();
        push[3] = 10.0;
        for _ in 0..100 {
            servo.step(&desired, &push);
        }
        assert!(servo.q[3] > 5e-4 && servo.q[2] == 0.0);
        for _ in 0..500 {
            servo.step(&desired, &Joints::zeros());
        }
        assert!(servo.q.norm() < 1e-9);
    }
}
