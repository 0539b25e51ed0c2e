//! Limits of the robots: the tables of their data sheets.
//!
//! Source: Franka Emika, "Robot and interface specifications", tables of necessary conditions; for
//! the FR3 also the URDF of libfranka 0.21 (`position_based_velocity_limits`). Cartesian bounds are
//! on the Euclidean length of the linear and of the angular part, joint bounds on each joint.

use std::fmt;

use nalgebra::Vector3;

use crate::kinematics::{Chain, FRANKA, Frames, JOINTS, Joints, Pose, Twist, split};

/// Period of the interface, s.
pub const PERIOD: f64 = 1e-3;

/// Room for rounding: differences of differences at 1 kHz lose about nine digits of the sixteen.
const ROUNDING: f64 = 1.0 + 1e-6;

/// A robot.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Model {
    /// Franka Emika Robot, "Panda"; version 5 of the interface.
    #[default]
    Panda,
    /// Franka Research 3, with the kinematics of a Panda; version 10 of the interface.
    Fr3,
    /// Another arm, without limits of its end effector.
    Other(&'static Described),
}

/// An arm that a file describes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Described {
    /// Its joints.
    pub frames: Frames,
    /// Its limits.
    pub limits: Limits,
}

impl Model {
    /// Its limits.
    pub const fn limits(self) -> &'static Limits {
        match self {
            Self::Panda => &PANDA,
            Self::Fr3 => &FR3,
            Self::Other(it) => &it.limits,
        }
    }

    /// Its joints.
    pub const fn frames(self) -> &'static Frames {
        match self {
            Self::Panda | Self::Fr3 => &FRANKA,
            Self::Other(it) => &it.frames,
        }
    }

    /// Its chain to this end effector in its flange (F_T_EE).
    pub const fn chain(self, flange_from_ee: Pose) -> Chain {
        Chain::of(self.frames(), flange_from_ee)
    }
}

impl fmt::Display for Model {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Panda => "panda",
            Self::Fr3 => "fr3",
            Self::Other(_) => "urdf",
        })
    }
}

/// Limits of a robot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    /// Of the end effector's origin.
    pub translation: Bounds,
    /// Of the end effector's turn.
    pub rotation: Bounds,
    /// Of the joints, base to flange.
    pub joints: [JointBounds; JOINTS],
}

impl Limits {
    /// Those of an arm of which only the joints' are known: range, velocity and acceleration, rad
    /// or m. A joint may turn its acceleration round within a period.
    pub fn of_joints(joints: impl Iterator<Item = ([f64; 2], f64, f64)>) -> Self {
        // Joints that the arm does not have stand at zero.
        let mut all = [joint(-TURNLESS, TURNLESS, 1.0, 1.0, 1e3); JOINTS];
        for (to, ([lower, upper], velocity, acceleration)) in all.iter_mut().zip(joints) {
            let (lower, upper) = (lower.max(-TURNLESS), upper.min(TURNLESS));
            let jerk = 2.0 * acceleration / PERIOD;
            *to = joint(lower, upper, velocity, acceleration, jerk);
        }
        let none = bounds(f64::INFINITY, f64::INFINITY, f64::INFINITY);
        Self {
            translation: none,
            rotation: none,
            joints: all,
        }
    }
}

/// The end of a range that has none, rad.
const TURNLESS: f64 = 1e4;

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
    /// How the velocity's bound shrinks towards the ends of the range, if it does.
    pub taper: Option<Taper>,
}

/// A velocity towards an end of a joint's range is at most
/// sqrt(2 `deceleration` d) - `offset`, with the distance d to that end.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Taper {
    /// The lower end, rad; a little beyond the least position.
    pub lower: f64,
    /// The upper end, rad.
    pub upper: f64,
    /// rad/s.
    pub offset: f64,
    /// rad/s^2.
    pub deceleration: f64,
}

static PANDA: Limits = Limits {
    translation: bounds(1.7, 13.0, 6500.0),
    rotation: bounds(2.5, 25.0, 12500.0),
    joints: [
        joint(-2.8973, 2.8973, 2.175, 15.0, 7500.0),
        joint(-1.7628, 1.7628, 2.175, 7.5, 3750.0),
        joint(-2.8973, 2.8973, 2.175, 10.0, 5000.0),
        joint(-3.0718, -0.0698, 2.175, 12.5, 6250.0),
        joint(-2.8973, 2.8973, 2.61, 15.0, 7500.0),
        joint(-0.0175, 3.7525, 2.61, 20.0, 10000.0),
        joint(-2.8973, 2.8973, 2.61, 20.0, 10000.0),
    ],
};

static FR3: Limits = Limits {
    translation: bounds(3.0, 9.0, 4500.0),
    rotation: bounds(2.5, 17.0, 8500.0),
    joints: [
        joint(-2.7437, 2.7437, 2.62, 10.0, 5000.0).tapered(-2.7501, 2.7501, 0.30, 6.0),
        joint(-1.7837, 1.7837, 2.62, 10.0, 5000.0).tapered(-1.7918, 1.7918, 0.20, 2.585),
        joint(-2.9007, 2.9007, 2.62, 10.0, 5000.0).tapered(-2.9065, 2.9065, 0.20, 3.5),
        joint(-3.0421, -0.1518, 2.62, 10.0, 5000.0).tapered(-3.0481, -0.1458, 0.30, 4.0),
        joint(-2.8065, 2.8065, 5.26, 10.0, 5000.0).tapered(-2.8101, 2.8101, 0.35, 17.0),
        joint(0.5445, 4.5169, 4.18, 10.0, 5000.0).tapered(0.54092, 4.5205, 0.35, 5.5),
        joint(-3.0159, 3.0159, 5.26, 10.0, 5000.0).tapered(-3.0196, 3.0196, 0.35, 17.0),
    ],
};

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
        taper: None,
    }
}

impl JointBounds {
    const fn tapered(self, lower: f64, upper: f64, offset: f64, deceleration: f64) -> Self {
        let taper = Taper {
            lower,
            upper,
            offset,
            deceleration,
        };
        Self {
            taper: Some(taper),
            ..self
        }
    }

    /// The least and the greatest velocity at a position, rad/s.
    pub fn velocities(&self, q: f64) -> (f64, f64) {
        let Some(taper) = self.taper else {
            return (-self.velocity, self.velocity);
        };
        let towards = |distance: f64| {
            let root = (2.0 * taper.deceleration * distance.max(0.0)).sqrt();
            (root - taper.offset).clamp(0.0, self.velocity)
        };
        (-towards(q - taper.lower), towards(taper.upper - q))
    }

    /// Whether it is faster than allowed there.
    pub fn is_too_fast(&self, q: f64, dq: f64) -> bool {
        let (least, most) = self.velocities(q);
        dq < least * ROUNDING || dq > most * ROUNDING
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

impl Limits {
    /// What a Cartesian velocity and its derivatives exceed.
    pub fn cartesian(&self, twist: &Twist, acceleration: &Twist, jerk: &Twist) -> Exceeded {
        let over = |x: &Twist, linear: f64, angular: f64| {
            let (l, a) = split(x);
            beyond(&l, linear) || beyond(&a, angular)
        };
        let (t, r) = (&self.translation, &self.rotation);
        Exceeded {
            position: false,
            velocity: over(twist, t.velocity, r.velocity),
            acceleration: over(acceleration, t.acceleration, r.acceleration),
            jerk: over(jerk, t.jerk, r.jerk),
        }
    }

    /// What the step of the joints from one setpoint to the next, a period later, exceeds. A
    /// position counts as exceeded as soon as the joint, braking at [`BRAKING`] of its bounds,
    /// could no longer stop in front of it.
    pub fn joints(&self, from: &Setpoint, next: &Setpoint) -> Exceeded {
        let jerk = (next.ddq - from.ddq) / PERIOD;
        let any = |over: &dyn Fn(usize, &JointBounds) -> bool| {
            let mut joints = self.joints.iter().enumerate();
            joints.any(|(k, bound)| over(k, bound))
        };
        Exceeded {
            position: any(&|k, b| {
                let ahead = stopping(next.dq[k], next.ddq[k], b);
                let behind = stopping(-next.dq[k], -next.ddq[k], b);
                next.q[k] + ahead > b.upper || next.q[k] - behind < b.lower
            }),
            velocity: any(&|k, b| b.is_too_fast(next.q[k], next.dq[k])),
            acceleration: any(&|k, b| next.ddq[k].abs() > b.acceleration * ROUNDING),
            jerk: any(&|k, b| jerk[k].abs() > b.jerk * ROUNDING),
        }
    }

    /// The first joint outside its range, by number from 0; `None` if all are inside.
    pub fn outside(&self, q: &Joints) -> Option<usize> {
        let is_inside = |k: usize| (self.joints[k].lower..=self.joints[k].upper).contains(&q[k]);
        (0..JOINTS).find(|&k| !is_inside(k))
    }
}

fn beyond(x: &Vector3<f64>, bound: f64) -> bool {
    x.norm() > bound * ROUNDING
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
        assert_eq!(PANDA.cartesian(&inside, &zero, &zero), Exceeded::default());
        let outside = Twist::new(1.3, 0.0, 1.3, 0.0, 0.0, 0.0);
        assert!(PANDA.cartesian(&outside, &zero, &zero).velocity);
        let turn = Twist::new(0.0, 0.0, 0.0, 20.0, 20.0, 0.0);
        assert!(PANDA.cartesian(&zero, &turn, &zero).acceleration);
    }

    #[test]
    fn a_step_is_judged_by_its_derivatives() {
        let rest = Setpoint::at_rest(Joints::from(crate::READY));
        let mut dq = Joints::zeros();
        dq[1] = 0.9 * 3750.0 * 1e-6;
        assert_eq!(PANDA.joints(&rest, &rest.after(&dq)), Exceeded::default());
        dq[1] = 1.1 * 3750.0 * 1e-6;
        let exceeded = PANDA.joints(&rest, &rest.after(&dq));
        assert!(exceeded.jerk && !exceeded.acceleration);
        dq[1] = 1.1 * 7.5 * 1e-3;
        let exceeded = PANDA.joints(&rest, &rest.after(&dq));
        assert!(exceeded.jerk && exceeded.acceleration && !exceeded.velocity);
    }

    #[test]
    fn a_joint_that_cannot_stop_before_its_limit_is_outside() {
        let mut moving = Setpoint::at_rest(Joints::from(crate::READY));
        moving.dq[1] = 1.0;
        // Stopping from 1 rad/s at 0.9 x 7.5 rad/s^2 takes 0.074 rad.
        moving.q[1] = 1.7628 - 0.10;
        assert!(!PANDA.joints(&moving, &moving).position);
        moving.q[1] = 1.7628 - 0.05;
        assert!(PANDA.joints(&moving, &moving).position);
    }

    #[test]
    fn an_fr3_is_slower_towards_the_ends_of_its_ranges() {
        // At 2 rad of joint 2: sqrt(2 x 2.585 x 0.7918) - 0.2, and as fast as ever away from it.
        let joint = FR3.joints[1];
        let (least, most) = joint.velocities(1.0);
        assert!((most - 1.8233).abs() < 1e-4 && least == -2.62, "{most}");
        assert_eq!(joint.velocities(-1.0), (-most, 2.62));
        assert!(joint.is_too_fast(1.0, 1.83) && !joint.is_too_fast(1.0, -2.6));
        // Beyond its end it may only go back.
        assert_eq!(joint.velocities(1.8).1, 0.0);
        assert_eq!(PANDA.joints[1].velocities(1.7), (-2.175, 2.175));
    }
}
