//! What a robot is made of, and what cannot be one.

use nalgebra::Vector3;
use thiserror::Error;

use crate::kinematics::{Joints, Pose};
use crate::limits::{JOINT, outside};
use crate::servo::ServoSettings;

/// A box that the end effector's origin must not leave.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Walls {
    /// Least coordinates in the base, m.
    pub lower: Vector3<f64>,
    /// Greatest coordinates in the base, m.
    pub upper: Vector3<f64>,
}

impl Walls {
    /// Whether a point of the base frame, m, is inside.
    pub fn contain(&self, point: &Vector3<f64>) -> bool {
        (0..3).all(|k| (self.lower[k]..=self.upper[k]).contains(&point[k]))
    }
}

/// What a robot is made of.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RobotSettings {
    /// F_T_EE, the end effector in the flange; the flange itself by default.
    pub flange_from_ee: Pose,
    /// How well the joints follow.
    pub servo: ServoSettings,
    /// Virtual walls; none by default.
    pub walls: Option<Walls>,
    /// How long automatic error recovery takes after the robot has come to rest, ms.
    pub recovery_ms: u64,
}

impl Default for RobotSettings {
    fn default() -> Self {
        Self {
            flange_from_ee: Pose::identity(),
            servo: ServoSettings::default(),
            walls: None,
            recovery_ms: 500,
        }
    }
}

/// Why a robot cannot be.
#[derive(Clone, Copy, Debug, Error, PartialEq)]
pub enum RobotError {
    /// A joint outside its range.
    #[error("joint {joint} is at {value} rad, allowed is {lower} to {upper}")]
    JointOutside {
        /// Number of the joint, from 1.
        joint: usize,
        /// Its position, rad.
        value: f64,
        /// Least position, rad.
        lower: f64,
        /// Greatest position, rad.
        upper: f64,
    },
    /// A setting of the servo outside its range.
    #[error("servo: {key} is {value}, allowed is {allowed}")]
    Servo {
        /// The setting.
        key: &'static str,
        /// Its value.
        value: f64,
        /// What is allowed.
        allowed: &'static str,
    },
}

impl RobotSettings {
    /// Whether a robot at `q` can be made of them.
    pub(crate) fn check(&self, q: &Joints) -> Result<(), RobotError> {
        if let Some(k) = outside(q) {
            return Err(RobotError::JointOutside {
                joint: k + 1,
                value: q[k],
                lower: JOINT[k].lower,
                upper: JOINT[k].upper,
            });
        }
        check_servo(&self.servo)
    }
}

fn check_servo(servo: &ServoSettings) -> Result<(), RobotError> {
    let rows = [
        (
            "bandwidth_hz",
            servo.bandwidth_hz,
            servo.bandwidth_hz > 0.0 && servo.bandwidth_hz <= 100.0,
            "above 0, up to 100 Hz",
        ),
        (
            "damping",
            servo.damping,
            servo.damping > 0.0 && servo.damping <= 3.0,
            "above 0, up to 3",
        ),
        (
            "feedforward",
            servo.feedforward,
            (0.0..=1.0).contains(&servo.feedforward),
            "0 to 1",
        ),
    ];
    for (key, value, good, allowed) in rows {
        if !good {
            return Err(RobotError::Servo {
                key,
                value,
                allowed,
            });
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn positions_and_settings_out_of_range_are_refused_by_name() {
        let mut q = Joints::from(crate::READY);
        let good = RobotSettings::default();
        assert_eq!(good.check(&q), Ok(()));
        for (key, value) in [
            ("bandwidth_hz", 0.0),
            ("damping", f64::NAN),
            ("feedforward", 1.1),
        ] {
            let mut settings = good;
            match key {
                "bandwidth_hz" => settings.servo.bandwidth_hz = value,
                "damping" => settings.servo.damping = value,
                _ => settings.servo.feedforward = value,
            }
            let error = settings.check(&q).unwrap_err().to_string();
            assert!(error.contains(key), "{error}");
        }
        q[3] = 0.0;
        let error = good.check(&q).unwrap_err().to_string();
        assert_eq!(error, "joint 4 is at 0 rad, allowed is -3.0718 to -0.0698");
        q[3] = f64::NAN;
        assert!(good.check(&q).is_err());
    }
}
