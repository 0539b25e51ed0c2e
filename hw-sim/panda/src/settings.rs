//! Settings of a robot.

use std::f64::consts::FRAC_PI_4;

use nalgebra::{Rotation3, Translation3, Vector3};
use thiserror::Error;

use crate::kinematics::{Joints, Pose};
use crate::limits::{Limits, Model};

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

/// Settings of a robot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RobotSettings {
    /// Which robot; a Panda by default.
    pub model: Model,
    /// F_T_NE, the nominal end effector in the flange, as it is set at the desk; the flange itself
    /// by default.
    pub flange_from_ne: Pose,
    /// NE_T_EE, the end effector in the nominal one, as a client sets it (`setEE`); the nominal one
    /// itself by default.
    pub ne_from_ee: Pose,
    /// Virtual walls; none by default.
    pub walls: Option<Walls>,
    /// How long automatic error recovery takes after the robot has come to rest, ms. The default of
    /// 500 is an assumption.
    pub recovery_ms: u64,
}

impl Default for RobotSettings {
    fn default() -> Self {
        Self {
            model: Model::default(),
            flange_from_ne: Pose::identity(),
            ne_from_ee: Pose::identity(),
            walls: None,
            recovery_ms: 500,
        }
    }
}

impl RobotSettings {
    /// A robot whose desk knows of the Franka Hand: turned by -45 deg, and with its fingertips
    /// 103.4 mm from the flange.
    ///
    /// Source: libfranka, `RobotState::F_T_NE` with the hand.
    pub fn with_hand() -> Self {
        Self {
            flange_from_ne: Pose::from_parts(
                Translation3::new(0.0, 0.0, 0.1034),
                Rotation3::from_axis_angle(&Vector3::z_axis(), -FRAC_PI_4),
            ),
            ..Self::default()
        }
    }

    /// F_T_EE, the end effector in the flange.
    pub fn flange_from_ee(&self) -> Pose {
        self.flange_from_ne * self.ne_from_ee
    }
}

/// A joint is outside its range.
#[derive(Clone, Copy, Debug, Error, PartialEq)]
#[error("joint {joint} = {value} rad; allowed: {lower} to {upper}")]
pub struct RobotError {
    /// Number of the joint, from 1.
    pub joint: usize,
    /// Its position, rad.
    pub value: f64,
    /// Least position, rad.
    pub lower: f64,
    /// Greatest position, rad.
    pub upper: f64,
}

/// Refuses positions outside the joints' ranges.
pub(crate) fn check(q: &Joints, limits: &Limits) -> Result<(), RobotError> {
    limits.outside(q).map_or(Ok(()), |k| {
        Err(RobotError {
            joint: k + 1,
            value: q[k],
            lower: limits.joints[k].lower,
            upper: limits.joints[k].upper,
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn positions_out_of_range_are_refused_by_name() {
        let mut q = Joints::from(crate::READY);
        assert_eq!(check(&q, Model::Panda.limits()), Ok(()));
        q[3] = 0.0;
        let error = check(&q, Model::Panda.limits()).unwrap_err().to_string();
        assert_eq!(error, "joint 4 = 0 rad; allowed: -3.0718 to -0.0698");
        q[3] = f64::NAN;
        assert!(check(&q, Model::Panda.limits()).is_err());
    }
}
