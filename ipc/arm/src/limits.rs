//! Limits of the robots' joints, from their data sheets, and what the robot refuses by them.
//!
//! Source: Franka Emika, "Robot and interface specifications", tables of necessary conditions; for
//! the FR3 also libfranka 0.21, `joint_velocity_limits.h`. The emulator has tables of its own.

use core::f64::consts::TAU;
use core::fmt;
use core::str::FromStr;

use libm::sqrt;

use crate::kinematics::{JOINTS, Joints};

/// Period of the interface, s.
pub const PERIOD: f64 = 1e-3;

/// Room for rounding: differences of differences at 1 kHz lose about nine digits of the sixteen.
const ROUNDING: f64 = 1.0 + 1e-6;

/// Share of the joints' acceleration with which the robot stops before the end of a range.
pub const BRAKING: f64 = 0.9;

/// Time in which a joint turns its acceleration round to brake, one period included, s: it still
/// goes on then, and may still gain speed.
const TURN: f64 = 5.5e-3;

/// A robot; all have the same kinematics.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Model {
    /// Franka Emika Robot, "Panda"; version 5 of the interface.
    #[default]
    Panda,
    /// Franka Research 3; version 10 of the interface.
    Fr3,
}

impl Model {
    /// Its limits.
    pub const fn limits(self) -> &'static Limits {
        match self {
            Self::Panda => &PANDA,
            Self::Fr3 => &FR3,
        }
    }
}

/// A name of no [`Model`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("no such robot; allowed: panda, fr3")]
pub struct UnknownModel;

impl FromStr for Model {
    type Err = UnknownModel;

    fn from_str(text: &str) -> Result<Self, UnknownModel> {
        match text {
            "panda" => Ok(Self::Panda),
            "fr3" => Ok(Self::Fr3),
            _ => Err(UnknownModel),
        }
    }
}

impl fmt::Display for Model {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Panda => "panda",
            Self::Fr3 => "fr3",
        })
    }
}

/// Limits of the joints, base to flange.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits(pub [JointLimits; JOINTS]);

/// Limits of a joint.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointLimits {
    /// Least and greatest position, rad.
    pub range: [f64; 2],
    /// rad/s.
    pub velocity: f64,
    /// rad/s^2.
    pub acceleration: f64,
    /// rad/s^3.
    pub jerk: f64,
    /// How the limit of the velocity shrinks towards the ends of the range, if it does.
    taper: Option<Taper>,
}

/// At a distance d from an end a joint moves towards it by at most
/// sqrt(2 `deceleration` d) - `offset`.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Taper {
    /// The two ends, rad: a little beyond the range.
    ends: [f64; 2],
    /// rad/s.
    offset: f64,
    /// rad/s^2.
    deceleration: f64,
}

/// Jerk in all rows of the data sheet, as a multiple of the acceleration, 1/s.
const JERK: f64 = 500.0;

const fn joint(lower: f64, upper: f64, velocity: f64, acceleration: f64) -> JointLimits {
    JointLimits {
        range: [lower, upper],
        velocity,
        acceleration,
        jerk: JERK * acceleration,
        taper: None,
    }
}

/// A joint of the FR3: its range, velocity, the ends of the taper, its offset and deceleration.
const fn tapered(
    range: [f64; 2],
    velocity: f64,
    ends: [f64; 2],
    offset: f64,
    deceleration: f64,
) -> JointLimits {
    JointLimits {
        taper: Some(Taper {
            ends,
            offset,
            deceleration,
        }),
        ..joint(range[0], range[1], velocity, 10.0)
    }
}

static PANDA: Limits = Limits([
    joint(-2.8973, 2.8973, 2.175, 15.0),
    joint(-1.7628, 1.7628, 2.175, 7.5),
    joint(-2.8973, 2.8973, 2.175, 10.0),
    joint(-3.0718, -0.0698, 2.175, 12.5),
    joint(-2.8973, 2.8973, 2.61, 15.0),
    joint(-0.0175, 3.7525, 2.61, 20.0),
    joint(-2.8973, 2.8973, 2.61, 20.0),
]);

static FR3: Limits = Limits([
    tapered([-2.7437, 2.7437], 2.62, [-2.7501, 2.7501], 0.3, 6.0),
    tapered([-1.7837, 1.7837], 2.62, [-1.7918, 1.7918], 0.2, 2.585),
    tapered([-2.9007, 2.9007], 2.62, [-2.9065, 2.9065], 0.2, 3.5),
    tapered([-3.0421, -0.1518], 2.62, [-3.0481, -0.1458], 0.3, 4.0),
    tapered([-2.8065, 2.8065], 5.26, [-2.8101, 2.8101], 0.35, 17.0),
    tapered([0.5445, 4.5169], 4.18, [0.54092, 4.5205], 0.35, 5.5),
    tapered([-3.0159, 3.0159], 5.26, [-3.0196, 3.0196], 0.35, 17.0),
]);

impl JointLimits {
    /// Those of a joint that an arm does not have.
    pub const NONE: Self = Self {
        range: [f64::NEG_INFINITY, f64::INFINITY],
        velocity: f64::INFINITY,
        acceleration: f64::INFINITY,
        jerk: f64::INFINITY,
        taper: None,
    };

    /// Limits that are the same in the whole range, rad, rad/s and rad/s^2; of a joint that slides
    /// in m. The jerk is that of a Franka robot, by its acceleration.
    pub const fn new(range: [f64; 2], velocity: f64, acceleration: f64) -> Self {
        joint(range[0], range[1], velocity, acceleration)
    }

    /// Whether it turns without end: positions that are a whole turn apart are the same then.
    pub fn is_endless(&self) -> bool {
        self.range == Self::NONE.range
    }

    /// The way from one position to another, rad: the shorter one round where it turns without end.
    pub fn way(&self, from: f64, to: f64) -> f64 {
        let way = to - from;
        match self.is_endless() {
            true => way - TAU * libm::round(way / TAU),
            false => way,
        }
    }

    /// The distances from the lower and to the upper end of the range, rad; negative beyond them.
    pub fn room(&self, q: f64) -> [f64; 2] {
        [q - self.range[0], self.range[1] - q]
    }

    /// The greatest speed at a position towards the lower and towards the upper end, rad/s.
    pub fn speeds(&self, q: f64) -> [f64; 2] {
        let Some(taper) = self.taper else {
            return [self.velocity; 2];
        };
        [q - taper.ends[0], taper.ends[1] - q].map(|distance| {
            let root = sqrt(2.0 * taper.deceleration * distance.max(0.0));
            (root - taper.offset).clamp(0.0, self.velocity)
        })
    }

    /// Whether a joint may be there, with this velocity and acceleration. It must be able to stop
    /// before the ends of its range with [`BRAKING`] of its acceleration.
    fn allows(&self, q: f64, dq: f64, ddq: f64) -> bool {
        let towards = [-1.0, 1.0].map(|way| {
            let fastest = (way * dq + (way * ddq).max(0.0) * TURN).max(0.0);
            fastest * TURN + fastest * fastest / (2.0 * BRAKING * self.acceleration)
        });
        let (room, speeds) = (self.room(q), self.speeds(q));
        towards[0] <= room[0]
            && towards[1] <= room[1]
            && -dq <= speeds[0] * ROUNDING
            && dq <= speeds[1] * ROUNDING
            && ddq.abs() <= self.acceleration * ROUNDING
    }
}

impl Limits {
    /// The way from one posture to another, joint by joint: [`JointLimits::way`].
    pub fn way(&self, from: &Joints, to: &Joints) -> Joints {
        Joints::from_fn(|k, _| self.0[k].way(from[k], to[k]))
    }

    /// Whether the robot accepts these velocities for the period after `from`.
    pub fn allow(&self, from: &Setpoint, dq: &Joints) -> bool {
        let next = from.after(dq);
        self.0.iter().enumerate().all(|(k, joint)| {
            let jerk = (next.ddq[k] - from.ddq[k]) / PERIOD;
            joint.allows(next.q[k], dq[k], next.ddq[k]) && jerk.abs() <= joint.jerk * ROUNDING
        })
    }
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
    /// The state one period later, with these velocities.
    pub fn after(&self, dq: &Joints) -> Self {
        Self {
            q: self.q + dq * PERIOD,
            dq: *dq,
            ddq: (dq - self.dq) / PERIOD,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::READY;

    fn rest() -> Setpoint {
        Setpoint {
            q: Joints::from(READY),
            dq: Joints::zeros(),
            ddq: Joints::zeros(),
        }
    }

    #[test]
    fn a_step_is_judged_by_its_derivatives() {
        let mut dq = Joints::zeros();
        dq[1] = 0.9 * 3750.0 * 1e-6;
        assert!(PANDA.allow(&rest(), &dq));
        dq[1] = 1.1 * 3750.0 * 1e-6;
        assert!(!PANDA.allow(&rest(), &dq));
    }

    #[test]
    fn the_way_of_an_endless_joint_is_the_shorter_one_round() {
        let endless = JointLimits::new(JointLimits::NONE.range, 1.0, 1.0);
        assert!(endless.is_endless() && !PANDA.0[6].is_endless());
        for turns in [0.0, 1.0, -3.0] {
            let way = endless.way(3.0, -3.0 + turns * TAU);
            assert!((way - (TAU - 6.0)).abs() < 1e-12, "{way}");
        }
        let mut limits = PANDA;
        limits.0[6] = endless;
        let [from, to] = [3.0, -3.0].map(Joints::from_element);
        let way = limits.way(&from, &to);
        assert_eq!(way[5], -6.0);
        assert!((way[6] - (TAU - 6.0)).abs() < 1e-12, "{}", way[6]);
    }

    #[test]
    fn a_joint_must_be_able_to_stop_before_the_end_of_its_range() {
        let mut moving = rest();
        moving.dq[1] = 1.0;
        // Stopping from 1 rad/s at 0.9 x 7.5 rad/s^2 takes 0.074 rad.
        moving.q[1] = 1.7628 - 0.10;
        assert!(PANDA.allow(&moving, &moving.dq));
        moving.q[1] = 1.7628 - 0.05;
        assert!(!PANDA.allow(&moving, &moving.dq));
    }

    #[test]
    fn an_fr3_is_slower_towards_the_ends_of_its_ranges() {
        // At 1 rad of joint 2: sqrt(2 x 2.585 x 0.7918) - 0.2, and as fast as ever away from it.
        let joint = FR3.0[1];
        let [down, up] = joint.speeds(1.0);
        assert!((up - 1.8233).abs() < 1e-4 && down == 2.62, "{up}");
        assert_eq!(joint.speeds(-1.0), [up, 2.62]);
        assert!(!joint.allows(1.0, 1.83, 0.0) && joint.allows(1.0, -2.6, 0.0));
        // Beyond its end it may only go back.
        assert_eq!(joint.speeds(1.8)[1], 0.0);
        assert_eq!(PANDA.0[1].speeds(1.7), [2.175, 2.175]);
    }
}
