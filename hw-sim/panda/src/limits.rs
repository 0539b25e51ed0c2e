//! Limits of the robot: the tables of the data sheet.
//!
//! Source: Franka Emika, "Robot and interface specifications", tables of necessary conditions.
//! Cartesian bounds are on the Euclidean length of the linear and of the angular part, joint bounds
//! on each joint.

use nalgebra::Vector3;

use crate::kinematics::{JOINTS, Joints, Twist, split};

/// Period of the interface, s.
pub const PERIOD: f64 = 1e-3;

/// Room for rounding: differences of differences at 1 kHz lose about nine digits of the sixteen.
const ROUNDING: f64 = 1.0 + 1e-6;

/// Bounds on a velocity and its first two derivatives.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bounds {
    /// m/s or rad/s.
    pub velocity: f64,
    /// m/s^2 or rad/s^2.
    pub acceleration: f64,
    /// m/s^3 or rad/s^3.
    pub jerk: f64,
}

/// Bounds of a joint.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointBounds {
    /// Least position, rad.
    pub lower: f64,
    /// Greatest position, rad.
    pub upper: f64,
    /// rad/s.
    pub velocity: f64,
    /// rad/s^2.
    pub acceleration: f64,
    /// rad/s^3.
    pub jerk: f64,
}

/// Of the end effector's origin.
pub const TRANSLATION: Bounds = bounds(1.7, 13.0, 6500.0);
/// Of the end effector's turn.
pub const ROTATION: Bounds = bounds(2.5, 25.0, 12500.0);
/// Of the joints, base to flange.
pub const JOINT: [JointBounds; JOINTS] = [
    joint(-2.8973, 2.8973, 2.175, 15.0, 7500.0),
    joint(-1.7628, 1.7628, 2.175, 7.5, 3750.0),
    joint(-2.8973, 2.8973, 2.175, 10.0, 5000.0),
    joint(-3.0718, -0.0698, 2.175, 12.5, 6250.0),
    joint(-2.8973, 2.8973, 2.61, 15.0, 7500.0),
    joint(-0.0175, 3.7525, 2.61, 20.0, 10000.0),
    joint(-2.8973, 2.8973, 2.61, 20.0, 10000.0),
];

const fn bounds(velocity: f64, acceleration: f64, jerk: f64) -> Bounds {
    Bounds {
        velocity,
        acceleration,
        jerk,
    }
}

const fn joint(lower: f64, upper: f64, velocity: f64, acceleration: f64, jerk: f64) -> JointBounds {
    JointBounds {
        lower,
        upper,
        velocity,
        acceleration,
        jerk,
    }
}

/// Which kinds of bounds were exceeded.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Exceeded {
    /// Position, or a joint could not stop in time for it.
    pub position: bool,
    /// Velocity.
    pub velocity: bool,
    /// Acceleration.
    pub acceleration: bool,
    /// Jerk.
    pub jerk: bool,
}

impl Exceeded {
    /// Velocity, acceleration, jerk, position.
    pub const fn each(self) -> [bool; 4] {
        [self.velocity, self.acceleration, self.jerk, self.position]
    }
}

/// Checks a Cartesian velocity and its derivatives.
pub fn cartesian(twist: &Twist, acceleration: &Twist, jerk: &Twist) -> Exceeded {
    let over = |x: &Twist, linear: f64, angular: f64| {
        let (l, a) = split(x);
        beyond(&l, linear) || beyond(&a, angular)
    };
    let (t, r) = (TRANSLATION, ROTATION);
    Exceeded {
        position: false,
        velocity: over(twist, t.velocity, r.velocity),
        acceleration: over(acceleration, t.acceleration, r.acceleration),
        jerk: over(jerk, t.jerk, r.jerk),
    }
}

fn beyond(x: &Vector3<f64>, bound: f64) -> bool {
    x.norm() > bound * ROUNDING
}

/// The first joint outside its range, by number from 0; `None` if all are inside.
pub fn outside(q: &Joints) -> Option<usize> {
    (0..JOINTS).find(|&k| !(JOINT[k].lower..=JOINT[k].upper).contains(&q[k]))
}

/// A desired state of the joints.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Setpoint {
    /// Positions, rad.
    pub q: Joints,
    /// Velocities, rad/s.
    pub dq: Joints,
    /// Accelerations, rad/s^2.
    pub ddq: Joints,
}

impl Setpoint {
    /// Standing still at `q`.
    pub fn at_rest(q: Joints) -> Self {
        Self {
            q,
            dq: Joints::zeros(),
            ddq: Joints::zeros(),
        }
    }

    /// Whether it stands still.
    pub fn is_at_rest(&self) -> bool {
        self.dq == Joints::zeros() && self.ddq == Joints::zeros()
    }

    /// The state one period later, with these velocities.
    pub fn after(&self, dq: &Joints) -> Self {
        Self {
            q: self.q + dq * PERIOD,
            dq: *dq,
            ddq: (dq - self.dq) / PERIOD,
        }
    }

    /// What the step from `self` to `next`, a period later, exceeds. A position counts as exceeded
    /// as soon as the joint, braking at [`BRAKING`] of its bounds, could no longer stop in front of
    /// it.
    pub fn exceeded(&self, next: &Self) -> Exceeded {
        let jerk = (next.ddq - self.ddq) / PERIOD;
        let any = |over: &dyn Fn(usize, &JointBounds) -> bool| {
            JOINT.iter().enumerate().any(|(k, bound)| over(k, bound))
        };
        Exceeded {
            position: any(&|k, b| {
                let ahead = stopping(next.dq[k], next.ddq[k], b);
                let behind = stopping(-next.dq[k], -next.ddq[k], b);
                next.q[k] + ahead > b.upper || next.q[k] - behind < b.lower
            }),
            velocity: any(&|k, b| next.dq[k].abs() > b.velocity * ROUNDING),
            acceleration: any(&|k, b| next.ddq[k].abs() > b.acceleration * ROUNDING),
            jerk: any(&|k, b| jerk[k].abs() > b.jerk * ROUNDING),
        }
    }
}

/// Share of the joints' acceleration and jerk that stops take.
pub const BRAKING: f64 = 0.9;

/// How far a joint still travels in the positive direction while it brakes, rad; an upper bound.
///
/// Turning the acceleration round from one bound to the other takes 2 a/j = 4 ms at most, 4.4 ms at
/// [`BRAKING`]; one period passes before. In that time the joint goes on at its speed and may still
/// gain some.
fn stopping(velocity: f64, acceleration: f64, bound: &JointBounds) -> f64 {
    const TURN: f64 = 5.5e-3;
    let fastest = (velocity + acceleration.max(0.0) * TURN).max(0.0);
    fastest * TURN + fastest * fastest / (2.0 * BRAKING * bound.acceleration)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cartesian_bounds_are_on_lengths_not_on_components() {
        let zero = Twist::zeros();
        let inside = Twist::new(1.2, 0.0, 1.2, 0.0, 0.0, 2.49);
        assert_eq!(cartesian(&inside, &zero, &zero), Exceeded::default());
        let outside = Twist::new(1.3, 0.0, 1.3, 0.0, 0.0, 0.0);
        assert!(cartesian(&outside, &zero, &zero).velocity);
        let turn = Twist::new(0.0, 0.0, 0.0, 20.0, 20.0, 0.0);
        assert!(cartesian(&zero, &turn, &zero).acceleration);
    }

    #[test]
    fn a_step_is_judged_by_its_derivatives() {
        let rest = Setpoint::at_rest(Joints::from(crate::READY));
        let mut dq = Joints::zeros();
        dq[1] = 0.9 * 3750.0 * 1e-6;
        assert_eq!(rest.exceeded(&rest.after(&dq)), Exceeded::default());
        dq[1] = 1.1 * 3750.0 * 1e-6;
        let exceeded = rest.exceeded(&rest.after(&dq));
        assert!(exceeded.jerk && !exceeded.acceleration);
        dq[1] = 1.1 * 7.5 * 1e-3;
        let exceeded = rest.exceeded(&rest.after(&dq));
        assert!(exceeded.jerk && exceeded.acceleration && !exceeded.velocity);
    }

    #[test]
    fn a_joint_that_can_no_longer_stop_in_front_of_its_limit_is_outside() {
        let mut moving = Setpoint::at_rest(Joints::from(crate::READY));
        moving.dq[1] = 1.0;
        // Stopping from 1 rad/s at 0.9 x 7.5 rad/s^2 takes 0.074 rad.
        moving.q[1] = 1.7628 - 0.10;
        assert!(!moving.exceeded(&moving).position);
        moving.q[1] = 1.7628 - 0.05;
        assert!(moving.exceeded(&moving).position);
    }
}
