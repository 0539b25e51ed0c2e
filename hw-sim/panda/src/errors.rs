//! Why the robot stops itself, under the real robot's names.
//!
//! Source of the names: libfranka, `franka::Errors`. On a velocity interface too much acceleration
//! and too much jerk are one error, an `acceleration_discontinuity`. The list holds what this
//! emulator can raise: what comes from torques and contacts (`joint_reflex`, `cartesian_reflex`,
//! `tau_j_range_violation` ...), from pose and elbow commands and from Franka's own planners is not
//! modelled.

use std::fmt;

macro_rules! flags {
    ($($(#[$doc:meta])* $flag:ident => $name:literal,)*) => {
        /// A reason to stop.
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        #[repr(u8)]
        pub enum Flag {
            $($(#[$doc])* $flag,)*
        }

        impl Flag {
            /// All of them.
            pub const ALL: &[Self] = &[$(Self::$flag,)*];

            /// The real robot's name.
            pub const fn name(self) -> &'static str {
                match self {
                    $(Self::$flag => $name,)*
                }
            }
        }
    };
}

flags! {
    /// A measured joint position is outside its range.
    JointPositionLimitsViolation => "joint_position_limits_violation",
    /// The measured end effector is outside the virtual walls.
    CartesianPositionLimitsViolation => "cartesian_position_limits_violation",
    /// A measured joint velocity is above its bound.
    JointVelocityViolation => "joint_velocity_violation",
    /// The measured translation of the end effector is faster than allowed.
    CartesianVelocityViolation => "cartesian_velocity_violation",
    /// A joint command would leave the range of a joint.
    JointMotionGeneratorPositionLimitsViolation
        => "joint_motion_generator_position_limits_violation",
    /// A joint command is faster than allowed.
    JointMotionGeneratorVelocityLimitsViolation
        => "joint_motion_generator_velocity_limits_violation",
    /// Joint commands accelerate or jerk more than allowed.
    JointMotionGeneratorAccelerationDiscontinuity
        => "joint_motion_generator_acceleration_discontinuity",
    /// A Cartesian command is faster than allowed.
    CartesianMotionGeneratorVelocityLimitsViolation
        => "cartesian_motion_generator_velocity_limits_violation",
    /// Cartesian commands accelerate or jerk more than allowed.
    CartesianMotionGeneratorAccelerationDiscontinuity
        => "cartesian_motion_generator_acceleration_discontinuity",
    /// After inverse kinematics a Cartesian command would leave the range of a joint.
    CartesianMotionGeneratorJointPositionLimitsViolation
        => "cartesian_motion_generator_joint_position_limits_violation",
    /// After inverse kinematics a joint is faster than allowed.
    CartesianMotionGeneratorJointVelocityLimitsViolation
        => "cartesian_motion_generator_joint_velocity_limits_violation",
    /// After inverse kinematics a joint accelerates or jerks more than allowed.
    CartesianMotionGeneratorJointAccelerationDiscontinuity
        => "cartesian_motion_generator_joint_acceleration_discontinuity",
    /// Too many commands in a row did not come in time.
    CommunicationConstraintsViolation => "communication_constraints_violation",
}

impl Flag {
    /// Returns whether a position, measured or commanded, is outside its range.
    pub const fn is_position_limit(self) -> bool {
        matches!(
            self,
            Self::JointPositionLimitsViolation
                | Self::CartesianPositionLimitsViolation
                | Self::JointMotionGeneratorPositionLimitsViolation
                | Self::CartesianMotionGeneratorJointPositionLimitsViolation
        )
    }
}

/// A set of [`Flag`]s.
#[derive(Clone, Copy, Default, PartialEq, Eq)]
pub struct Errors(u32);

impl Errors {
    /// None.
    pub const NONE: Self = Self(0);

    /// Whether it is empty.
    pub const fn is_empty(self) -> bool {
        self.0 == 0
    }

    /// Whether this flag is in it.
    pub const fn contains(self, flag: Flag) -> bool {
        self.0 & Self::bit(flag) != 0
    }

    /// The flags that are raised.
    pub fn raised(flags: impl IntoIterator<Item = (Flag, bool)>) -> Self {
        let raised = flags.into_iter().filter(|(_, is_raised)| *is_raised);
        raised.fold(Self::NONE, |errors, (flag, _)| errors.union(flag.into()))
    }

    /// All flags of both.
    #[must_use]
    pub const fn union(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }

    /// The flags in it, in the order of [`Flag::ALL`].
    pub fn flags(self) -> impl Iterator<Item = Flag> {
        Flag::ALL
            .iter()
            .copied()
            .filter(move |&flag| self.contains(flag))
    }

    const fn bit(flag: Flag) -> u32 {
        1 << flag as u8
    }
}

impl From<Flag> for Errors {
    fn from(flag: Flag) -> Self {
        Self(Self::bit(flag))
    }
}

impl fmt::Debug for Errors {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Display::fmt(self, f)
    }
}

impl fmt::Display for Errors {
    /// As libfranka writes it: `["name", "name"]`, `[]` where there are none.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("[")?;
        for (k, flag) in self.flags().enumerate() {
            let comma = if k > 0 { ", " } else { "" };
            write!(f, "{comma}\"{}\"", flag.name())?;
        }
        f.write_str("]")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_set_prints_the_names_in_it() {
        assert_eq!(Errors::NONE.to_string(), "[]");
        let both = Errors::raised([
            (Flag::CommunicationConstraintsViolation, true),
            (Flag::JointVelocityViolation, true),
            (Flag::CartesianVelocityViolation, false),
        ]);
        let expected = r#"["joint_velocity_violation", "communication_constraints_violation"]"#;
        assert_eq!(both.to_string(), expected);
    }

    #[test]
    fn every_flag_has_a_bit_and_a_name_of_its_own() {
        for (k, &a) in Flag::ALL.iter().enumerate() {
            assert_eq!(Errors::from(a).flags().collect::<Vec<_>>(), [a]);
            assert!(Flag::ALL[..k].iter().all(|b| b.name() != a.name()));
        }
    }
}
