//! From the camera's twist to what the robot is commanded in the next millisecond: a driver of
//! [`arm::Bridge`]. Nothing here waits, allocates or panics.

use arm::ik::VelocityIk;
use arm::limits::BRAKING;
use arm::reserve::{nearing, part};
use arm::{
    Bridge, Chain, Driver, Echo, Joints, Limited, Limits, Model, Mount, PERIOD, Ramp, Room,
    Setpoint, ShaperError, ShaperSettings, Twist,
};
use messages::TwistCommand;
use nalgebra::Vector3;

use crate::config::{Bounds, Config, Interface};

/// Deceleration, m/s^2, with which the end effector nears a wall of its workspace: a fifth of the
/// shaper's.
const NEARING: f64 = 0.1;
/// Share of the joints' bounds on acceleration and jerk that their ramps take.
const JOINT_SHARE: f64 = 0.8;
/// Share of the present motion below which a wall is too near for it. On the way to a wall the
/// ramps lag behind by less.
const WALL_SHARE: f64 = 0.5;
/// Distance below which two twists are the same, m/s and rad/s: states of version 10 have 32 bits.
const SAME: f64 = 1e-6;
/// Speed below which everything stands, m/s and rad/s.
const AT_REST: f64 = 1e-5;

/// What a state of the robot says that steering needs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Measured {
    /// The end effector, and its last command.
    pub end_effector: arm::Measured,
    /// The last command of the joints: q_d, dq_d, ddq_d.
    pub desired: Setpoint,
}

impl Measured {
    fn chain(&self) -> Chain {
        Chain::FRANKA.with_ee(self.end_effector.flange_from_ee)
    }
}

/// A command for one millisecond.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Output {
    /// Joint velocities, rad/s.
    Joint(Joints),
    /// Velocity of the end effector's origin along base axes, m/s and rad/s.
    Cartesian(Twist),
}

impl Output {
    /// Standing still.
    pub fn still(interface: Interface) -> Self {
        match interface {
            Interface::Joint => Self::Joint(Joints::zeros()),
            Interface::Cartesian => Self::Cartesian(Twist::zeros()),
        }
    }
}

/// Steers the robot during one motion.
#[derive(Clone, Debug)]
pub struct Steering(Bridge<Franka>);

impl Steering {
    /// A motion of the configured robot begins at rest.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn begin(config: &Config, measured: &Measured) -> Result<Self, StartError> {
        let mount = config.mount(&measured.end_effector.flange_from_ee);
        Self::new(
            mount,
            config.bounds,
            config.interface,
            config.model,
            measured,
        )
    }

    /// A motion begins at rest.
    ///
    /// # Errors
    /// The robot is outside its workspace, or a joint within the margin: names which, its position
    /// and the allowed range.
    pub fn new(
        mount: Mount,
        bounds: Bounds,
        interface: Interface,
        model: Model,
        measured: &Measured,
    ) -> Result<Self, StartError> {
        let limits = model.limits();
        check(&bounds, limits, measured)?;
        let ik = VelocityIk::new(measured.chain(), limits, &measured.desired.q);
        let driver = Franka {
            bounds,
            limits,
            measured: *measured,
            shaped: Echo::default(),
            before: Twist::zeros(),
            ik,
            elbow: 0.0,
            output: Output::still(interface),
        };
        Ok(Self(Bridge::new(driver, mount, ShaperSettings::default())?))
    }

    /// What limited the last step.
    pub fn limited(&self) -> Limited {
        self.0.limited()
    }

    /// The answer to a state of the robot at this instant, ns.
    pub fn step(&mut self, command: &TwistCommand, measured: &Measured, now_ns: u64) -> Output {
        let Self(bridge) = self;
        bridge.driver.measured = *measured;
        let (caps, until_ns) = (bridge.driver.bounds.caps, command.in_force_until_ns());
        bridge.obey(&command.in_force(now_ns), until_ns, &caps);
        bridge.turn_elbow(command.elbow_in_force(now_ns));
        bridge.step(now_ns);
        bridge.driver.output
    }

    /// Brings the robot to rest, whatever is commanded.
    pub fn brake(&mut self, measured: &Measured, now_ns: u64) -> Output {
        self.step(&TwistCommand::default(), measured, now_ns)
    }

    /// Whether the robot was last commanded to stand.
    pub fn is_at_rest(&self, measured: &Measured) -> bool {
        match self.0.driver.output {
            Output::Cartesian(_) => measured.end_effector.echo.twist.amax() < AT_REST,
            Output::Joint(_) => measured.desired.dq.amax() < AT_REST,
        }
    }
}

/// The robot during one motion.
#[derive(Clone, Debug)]
struct Franka {
    bounds: Bounds,
    limits: &'static Limits,
    /// Its newest state.
    measured: Measured,
    /// The last command, shaped.
    shaped: Echo,
    /// The twist before that.
    before: Twist,
    ik: VelocityIk,
    /// The velocity of the elbow that is commanded, rad/s.
    elbow: f64,
    /// The answer to the newest state; of the same kind in all of the motion.
    output: Output,
}

impl Driver for Franka {
    fn measured(&self) -> arm::Measured {
        arm::Measured {
            echo: self.commanded(),
            ..self.measured.end_effector
        }
    }

    fn room(&self, twist: &Twist) -> Room {
        let (chain, q) = (self.measured.chain(), &self.measured.desired.q);
        let (reserve, shaper) = (&self.bounds.reserve, ShaperSettings::default());
        Room {
            workspace: self.walls(twist),
            ..reserve.room(&chain, self.limits, &shaper, q, twist)
        }
    }

    fn turn_elbow(&mut self, elbow: f64) {
        self.elbow = elbow;
    }

    fn command(&mut self, twist: &Twist) {
        let acceleration = (twist - self.commanded().twist) / PERIOD;
        self.before = self.shaped.twist;
        self.shaped = Echo {
            twist: *twist,
            acceleration,
        };
        self.output = match self.output {
            Output::Cartesian(_) => Output::Cartesian(*twist),
            Output::Joint(_) => Output::Joint(self.joints(twist)),
        };
    }
}

impl Franka {
    /// The last command. The robot's echo tells when one was lost; otherwise our own record is
    /// better: an echo may be a state late, or lack the acceleration. Where it says what came
    /// before, the last command may also be lost after one without acceleration; the mistake is
    /// then the ramps' jerk twice, for one state. In a motion of joints the robot echoes joints
    /// alone.
    fn commanded(&self) -> Echo {
        let echo = self.measured.end_effector.echo;
        let is = |twist: &Twist| (echo.twist - twist).amax() < SAME;
        let is_ours = matches!(self.output, Output::Joint(_));
        match is_ours || is(&self.shaped.twist) || is(&self.before) {
            true => self.shaped,
            false => echo,
        }
    }

    /// How much of this motion the walls of the workspace allow, 0 to 1.
    fn walls(&self, twist: &Twist) -> f64 {
        let at = &self.measured.end_effector.base_from_ee.translation.vector;
        let walls = &self.bounds.workspace;
        let share = |k: usize| {
            let room = match twist[k] > 0.0 {
                true => walls.upper[k] - at[k],
                false => at[k] - walls.lower[k],
            };
            part(twist[k], nearing(room, NEARING))
        };
        (0..3).map(share).fold(1.0, f64::min)
    }

    /// Joint velocities along the shaped motion, each on a ramp of its own within the robot's
    /// bounds.
    fn joints(&mut self, twist: &Twist) -> Joints {
        let desired = self.measured.desired;
        // An arm that stands moves no elbow, either, unless it is told to.
        let is_moving = twist.amax() >= AT_REST || self.elbow != 0.0;
        let elbow = is_moving.then_some(self.elbow);
        let wanted = self.ik.step(&desired, twist, elbow);
        // With the elbow's part.
        let wanted = wanted * self.bounds.reserve.share(self.limits, &desired.q, &wanted);
        let towards = |target: &Joints| {
            Joints::from_fn(|k, _| {
                let joint = &self.limits.0[k];
                let ramp = Ramp {
                    acceleration: JOINT_SHARE * joint.acceleration,
                    jerk: JOINT_SHARE * joint.jerk,
                };
                let (dq, ddq) = (desired.dq[k], desired.ddq[k]);
                ramp.step(dq, ddq, target[k], PERIOD).0
            })
        };
        let next = towards(&wanted);
        // It brakes instead of what the robot would refuse, and where joints do not move the end
        // effector as told: near a singularity, with a wall ahead.
        let jacobian = self.measured.chain().jacobian(&desired.q);
        let is_clear = self.walls(&(jacobian * next)) > WALL_SHARE;
        if is_clear && self.limits.allow(&desired, &next) {
            return next;
        }
        let braking = towards(&Joints::zeros());
        // The ramp goes on from there.
        self.shaped = Echo {
            twist: jacobian * braking,
            acceleration: Twist::zeros(),
        };
        braking
    }
}

const _: () = assert!(JOINT_SHARE < BRAKING);

/// Why the bridge does not begin a motion.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum StartError {
    /// The end effector is outside the workspace.
    #[error(
        "the end effector is at {axis} = {value:.3} m; allowed: {lower} to {upper}: guide the robot into it, or change [workspace]"
    )]
    Workspace {
        /// x, y or z.
        axis: char,
        /// Its coordinate, m.
        value: f64,
        /// Least coordinate, m.
        lower: f64,
        /// Greatest coordinate, m.
        upper: f64,
    },
    /// A joint is outside its range less the margin.
    #[error(
        "joint {joint} = {value:.3} rad; allowed with joint_margin: {lower:.3} to {upper:.3}: guide the robot there"
    )]
    Joint {
        /// From 1.
        joint: usize,
        /// Its position, rad.
        value: f64,
        /// Least position, rad.
        lower: f64,
        /// Greatest position, rad.
        upper: f64,
    },
    /// A setting of the shaper is not a positive number.
    #[error(transparent)]
    Shaper(#[from] ShaperError),
}

fn check(bounds: &Bounds, limits: &Limits, measured: &Measured) -> Result<(), StartError> {
    let at: &Vector3<f64> = &measured.end_effector.base_from_ee.translation.vector;
    let walls = &bounds.workspace;
    for (k, axis) in ['x', 'y', 'z'].into_iter().enumerate() {
        let (value, lower, upper) = (at[k], walls.lower[k], walls.upper[k]);
        if !(lower..=upper).contains(&value) {
            return Err(StartError::Workspace {
                axis,
                value,
                lower,
                upper,
            });
        }
    }
    for (k, joint) in limits.0.iter().enumerate() {
        let margin = bounds.reserve.margin;
        let (lower, upper) = (joint.range[0] + margin, joint.range[1] - margin);
        let value = measured.desired.q[k];
        if !(lower..=upper).contains(&value) {
            return Err(StartError::Joint {
                joint: k + 1,
                value,
                lower,
                upper,
            });
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests;
