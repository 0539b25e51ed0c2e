//! What carries the desired joints out: measured positions follow, and lag.
//!
//! Each joint is a second-order system behind a velocity feed-forward. The numbers are assumptions of the size that an
//! impedance-controlled arm shows, not measurements of one.

use crate::kinematics::Joints;
use crate::limits::{PERIOD, Setpoint};

/// How well the joints follow.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ServoSettings {
    /// Natural frequency, Hz, in (0, 100].
    pub bandwidth_hz: f64,
    /// Damping ratio, positive; 1 is critical.
    pub damping: f64,
    /// Share of the desired velocity that is fed forward, 0 to 1. The lag in steady motion is
    /// 2 damping (1 - feedforward) / (2 pi bandwidth) seconds, less the period in which a set point already acts.
    pub feedforward: f64,
}

impl Default for ServoSettings {
    /// 15 Hz, critically damped, a lag of 3 ms.
    fn default() -> Self {
        Self {
            bandwidth_hz: 15.0,
            damping: 1.0,
            feedforward: 0.8,
        }
    }
}

/// The measured joints.
#[derive(Clone, Copy, Debug)]
pub struct Servo {
    settings: ServoSettings,
    /// Positions, rad.
    pub q: Joints,
    /// Velocities, rad/s.
    pub dq: Joints,
}

impl Servo {
    /// Joints at rest at `q`.
    pub fn new(settings: ServoSettings, q: Joints) -> Self {
        Self {
            settings,
            q,
            dq: Joints::zeros(),
        }
    }

    /// One period; `push` is what the surroundings add to the accelerations, rad/s^2.
    pub fn step(&mut self, desired: &Setpoint, push: &Joints) {
        let omega = std::f64::consts::TAU * self.settings.bandwidth_hz;
        let damping = 2.0 * self.settings.damping * omega;
        let ddq = (desired.q - self.q) * (omega * omega)
            + (desired.dq * self.settings.feedforward - self.dq) * damping
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
        let settings = ServoSettings::default();
        let mut servo = Servo::new(settings, Joints::zeros());
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
        let mut servo = Servo::new(ServoSettings::default(), Joints::zeros());
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
