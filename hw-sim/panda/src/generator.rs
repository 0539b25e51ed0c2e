//! Commands in, desired joints out, each step checked against the tables.

use nalgebra::{Rotation3, Translation3, UnitQuaternion, Vector3};

use crate::errors::{Errors, Flag};
use crate::ik::VelocityIk;
use crate::interface::{Motion, MotionKind};
use crate::kinematics::{Chain, Joints, Pose, Twist, split};
use crate::limits::{Limits, PERIOD, Setpoint};

/// What a Cartesian command itself exceeds: velocity, acceleration, jerk.
const COMMANDED: [Flag; 3] = [
    Flag::CartesianMotionGeneratorVelocityLimitsViolation,
    Flag::CartesianMotionGeneratorAccelerationDiscontinuity,
    Flag::CartesianMotionGeneratorAccelerationDiscontinuity,
];
/// What the joints exceed under it: velocity, acceleration, jerk, position.
const OF_CARTESIAN: [Flag; 4] = [
    Flag::CartesianMotionGeneratorJointVelocityLimitsViolation,
    Flag::CartesianMotionGeneratorJointAccelerationDiscontinuity,
    Flag::CartesianMotionGeneratorJointAccelerationDiscontinuity,
    Flag::CartesianMotionGeneratorJointPositionLimitsViolation,
];
/// What a joint command exceeds: velocity, acceleration, jerk, position.
const OF_JOINT: [Flag; 4] = [
    Flag::JointMotionGeneratorVelocityLimitsViolation,
    Flag::JointMotionGeneratorAccelerationDiscontinuity,
    Flag::JointMotionGeneratorAccelerationDiscontinuity,
    Flag::JointMotionGeneratorPositionLimitsViolation,
];

/// The pose after a body moved at `twist` (its origin, base axes) for `dt` seconds, the linear and
/// the angular velocity constant along base axes.
pub(crate) fn moved(pose: &Pose, twist: &Twist, dt: f64) -> Pose {
    let (linear, angular) = split(twist);
    Pose::from_parts(
        Translation3::from(pose.translation.vector + linear * dt),
        Rotation3::new(angular * dt) * pose.rotation,
    )
}

/// A motion under way.
#[derive(Clone, Copy, Debug)]
#[expect(
    clippy::large_enum_variant,
    reason = "a robot holds one, and the large one is the rule"
)]
pub enum Generator {
    /// Of Cartesian velocities.
    Cartesian(CartesianGenerator),
    /// Of joint velocities.
    Joint(JointGenerator),
}

impl Generator {
    /// A motion begins at rest at `q`.
    pub fn new(kind: MotionKind, chain: Chain, limits: &'static Limits, q: &Joints) -> Self {
        match kind {
            MotionKind::Cartesian => Self::Cartesian(CartesianGenerator::new(chain, limits, q)),
            MotionKind::Joint => Self::Joint(JointGenerator {
                limits,
                velocity: Joints::zeros(),
                acceleration: Joints::zeros(),
            }),
        }
    }

    /// What the robot assumes for a command that did not come: constant acceleration.
    pub fn extrapolation(&self) -> Motion {
        match self {
            Self::Cartesian(g) => Motion::Cartesian(g.twist + g.acceleration * PERIOD),
            Self::Joint(g) => Motion::Joint(g.velocity + g.acceleration * PERIOD),
        }
    }

    /// The desired joints after a period of this motion, and what is wrong with them. With errors
    /// the step must not be taken, and the generator is of no further use. A motion of another kind
    /// is the extrapolation. `elbow` is where joint 3 is to be in a Cartesian one, rad.
    pub fn advance(
        &mut self,
        motion: &Motion,
        elbow: Option<f64>,
        from: &Setpoint,
    ) -> (Setpoint, Errors) {
        if let (Self::Cartesian(g), Some(elbow)) = (&mut *self, elbow) {
            g.ik.turn_elbow(elbow);
        }
        match (&mut *self, motion) {
            (Self::Cartesian(g), Motion::Cartesian(twist)) => g.advance(twist, from),
            (Self::Joint(g), Motion::Joint(dq)) => g.advance(dq, from),
            _ => {
                let motion = self.extrapolation();
                self.advance(&motion, None, from)
            }
        }
    }
}

/// Cartesian velocities through inverse kinematics.
#[derive(Clone, Copy, Debug)]
pub struct CartesianGenerator {
    limits: &'static Limits,
    ik: VelocityIk,
    /// The integral of commands, as far as the joints can do them: where the end effector's origin
    /// is to be, m, and its orientation, which is held as a quaternion because its length is cheaply
    /// kept.
    position: Vector3<f64>,
    orientation: UnitQuaternion<f64>,
    twist: Twist,
    acceleration: Twist,
}

impl CartesianGenerator {
    fn new(chain: Chain, limits: &'static Limits, q: &Joints) -> Self {
        let pose = chain.pose(q);
        Self {
            limits,
            ik: VelocityIk::new(chain, limits, q),
            position: pose.translation.vector,
            orientation: UnitQuaternion::from_rotation_matrix(&pose.rotation),
            twist: Twist::zeros(),
            acceleration: Twist::zeros(),
        }
    }

    /// The last commanded velocity, or its extrapolation; base axes.
    pub fn twist(&self) -> &Twist {
        &self.twist
    }

    /// The difference quotient of the commanded velocity, m/s^2 and rad/s^2.
    pub fn acceleration(&self) -> &Twist {
        &self.acceleration
    }

    /// The integral of the commands.
    pub fn pose(&self) -> Pose {
        Pose::from_parts(
            Translation3::from(self.position),
            self.orientation.to_rotation_matrix(),
        )
    }

    fn advance(&mut self, twist: &Twist, from: &Setpoint) -> (Setpoint, Errors) {
        let acceleration = (twist - self.twist) / PERIOD;
        let jerk = (acceleration - self.acceleration) / PERIOD;
        let commanded = self.limits.cartesian(twist, &acceleration, &jerk);
        let middle = moved(&self.pose(), twist, 0.5 * PERIOD);
        let desired = from.after(&self.ik.step(from, twist, &middle));
        let joints = self.limits.joints(from, &desired);

        match self.ik.pose_of_few(&desired.q) {
            // No joints could follow the integral for long.
            Some(pose) => {
                self.position = pose.translation.vector;
                self.orientation = UnitQuaternion::from_rotation_matrix(&pose.rotation);
            }
            None => {
                let (linear, angular) = split(twist);
                self.position += linear * PERIOD;
                self.orientation = UnitQuaternion::new(angular * PERIOD) * self.orientation;
                self.orientation.renormalize_fast();
            }
        }
        (self.twist, self.acceleration) = (*twist, acceleration);
        let commanded = COMMANDED.into_iter().zip(commanded.each());
        let joints = OF_CARTESIAN.into_iter().zip(joints.each());
        (desired, Errors::raised(commanded.chain(joints)))
    }
}

/// Joint velocities as they are.
#[derive(Clone, Copy, Debug)]
pub struct JointGenerator {
    limits: &'static Limits,
    velocity: Joints,
    acceleration: Joints,
}

impl JointGenerator {
    fn advance(&mut self, dq: &Joints, from: &Setpoint) -> (Setpoint, Errors) {
        let desired = from.after(dq);
        let exceeded = self.limits.joints(from, &desired).each();
        (self.velocity, self.acceleration) = (*dq, desired.ddq);
        (desired, Errors::raised(OF_JOINT.into_iter().zip(exceeded)))
    }
}
