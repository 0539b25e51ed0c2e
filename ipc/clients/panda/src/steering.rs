//! From the camera's twist to what the robot is commanded in the next millisecond. Nothing here
//! waits, allocates or panics.
//!
//! What is beyond a limit slows the camera down along its way, by one share for all axes: it never
//! turns it elsewhere.

use messages::TwistCommand;
use nalgebra::Vector3;
use panda::ik::{VelocityIk, joint_velocities};
use panda::limits::{BRAKING, Exceeded, PERIOD, Setpoint};
use panda::ramp::Ramp;
use panda::reserve::{nearing, part};
use panda::{
    Chain, Echo, Joints, Limits, Model, Mount, Pose, Reserve, Shaper, ShaperSettings, Twist,
    singularity,
};

use crate::config::{Bounds, Interface};

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
    /// O_T_EE, the end effector in the base.
    pub base_from_ee: Pose,
    /// F_T_EE, the end effector in the flange.
    pub flange_from_ee: Pose,
    /// What the joints were last commanded: q_d, dq_d, ddq_d.
    pub desired: Setpoint,
    /// What the end effector was last commanded: O_dP_EE_c, O_ddP_EE_c.
    pub echo: Echo,
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

/// What limited the last millisecond.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Limited {
    /// The command was longer than the caps allow, or not finite.
    pub is_cut: bool,
    /// A wall of the workspace is near.
    pub by_workspace: bool,
    /// A joint is near the margin of its range, or would be too fast, or a singularity is near.
    pub by_joint: bool,
    /// No command is in force: the robot is to stand.
    pub is_stale: bool,
}

/// Steers the robot during one motion.
#[derive(Clone, Copy, Debug)]
pub struct Steering {
    mount: Mount,
    bounds: Bounds,
    limits: &'static Limits,
    interface: Interface,
    shaper: Shaper,
    /// What the shaper was at.
    shaped: Echo,
    /// The twist before that.
    before: Twist,
    ik: VelocityIk,
    limited: Limited,
}

impl Steering {
    /// A motion begins at rest.
    ///
    /// # Errors
    /// The robot is outside its workspace, or a joint within the margin: names which, where it is
    /// and what is allowed.
    pub fn new(
        mount: Mount,
        bounds: Bounds,
        interface: Interface,
        model: Model,
        measured: &Measured,
    ) -> Result<Self, StartError> {
        let limits = model.limits();
        check(&bounds, limits, measured)?;
        let chain = Chain::new(measured.flange_from_ee);
        // Its defaults are positive numbers.
        let shaper = Shaper::new(ShaperSettings::default()).map_err(|_| StartError::Shaper)?;
        Ok(Self {
            mount,
            bounds,
            limits,
            interface,
            shaper,
            shaped: Echo {
                twist: Twist::zeros(),
                acceleration: Twist::zeros(),
            },
            before: Twist::zeros(),
            ik: VelocityIk::new(chain, limits, &measured.desired.q),
            limited: Limited::default(),
        })
    }

    /// What limited the last step.
    pub fn limited(&self) -> Limited {
        self.limited
    }

    /// What answers a state of the robot at this instant, ns.
    pub fn step(&mut self, command: &TwistCommand, measured: &Measured, now_ns: u64) -> Output {
        let camera = Twist::from(command.in_force(now_ns));
        let cut = self.bounds.cut(&camera);
        self.limited = Limited {
            is_cut: cut != camera,
            is_stale: now_ns >= command.in_force_until_ns(),
            ..Limited::default()
        };
        // The base axes turn under the camera: transported anew in each millisecond.
        let rotation = &measured.base_from_ee.rotation;
        let wanted = self.mount.to_base(rotation, &measured.flange_from_ee, &cut);
        let share = self.share(&wanted, measured);
        self.shaper
            .aim(&(wanted * share), command.in_force_until_ns());
        match self.interface {
            Interface::Cartesian => {
                let from = self.commanded(&measured.echo);
                Output::Cartesian(self.shape(&from, now_ns))
            }
            Interface::Joint => Output::Joint(self.joints(measured, now_ns)),
        }
    }

    /// What the robot was last commanded. Its echo tells when a command was lost; otherwise our own
    /// record is better: an echo may be a state late, or lack the acceleration. Where it says what
    /// came before, the last command may also be lost after one without acceleration; the mistake
    /// is then the ramps' jerk twice, for one state.
    fn commanded(&self, echo: &Echo) -> Echo {
        let is = |twist: &Twist| (echo.twist - twist).amax() < SAME;
        match is(&self.shaped.twist) || is(&self.before) {
            true => self.shaped,
            false => *echo,
        }
    }

    /// A step of the shaper from there.
    fn shape(&mut self, from: &Echo, now_ns: u64) -> Twist {
        let twist = self.shaper.step(from, now_ns);
        self.before = self.shaped.twist;
        self.shaped = Echo {
            twist,
            acceleration: (twist - from.twist) / PERIOD,
        };
        twist
    }

    /// What brings the robot to rest, whatever is commanded.
    pub fn brake(&mut self, measured: &Measured, now_ns: u64) -> Output {
        let nothing = TwistCommand::default();
        self.step(&nothing, measured, now_ns)
    }

    /// Whether the robot was last commanded to stand.
    pub fn is_at_rest(&self, measured: &Measured) -> bool {
        match self.interface {
            Interface::Cartesian => measured.echo.twist.amax() < AT_REST,
            Interface::Joint => measured.desired.dq.amax() < AT_REST,
        }
    }

    /// How much of this motion the workspace and the joints allow, 0 to 1.
    fn share(&mut self, wanted: &Twist, measured: &Measured) -> f64 {
        let share = self.room(wanted, measured);
        self.limited.by_workspace = share < 1.0;
        let q = &measured.desired.q;
        let chain = Chain::new(measured.flange_from_ee);
        let dq = joint_velocities(&chain, q, wanted);
        let clear = singularity::share(&chain, self.limits, self.shaper.settings(), q, &dq);
        let joints = self.reserve().share(self.limits, q, &dq).min(clear);
        self.limited.by_joint = joints < 1.0;
        share.min(joints)
    }

    fn reserve(&self) -> Reserve {
        Reserve {
            margin: self.bounds.joint_margin,
            speed: self.bounds.joint_speed,
        }
    }

    /// How much of this motion the workspace allows, 0 to 1.
    fn room(&self, twist: &Twist, measured: &Measured) -> f64 {
        let at = &measured.base_from_ee.translation.vector;
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
    fn joints(&mut self, measured: &Measured, now_ns: u64) -> Joints {
        let desired = &measured.desired;
        // The robot echoes joints here.
        let shaped = self.shaped;
        let twist = self.shape(&shaped, now_ns);
        // Who stands moves no elbow, either.
        let is_standing = twist.amax() < AT_REST;
        let wanted = self.ik.follow(desired, &twist, !is_standing);
        // With the elbow's part.
        let wanted = wanted * self.reserve().share(self.limits, &desired.q, &wanted);
        let towards = |target: &Joints| {
            Joints::from_fn(|k, _| {
                let bound = &self.limits.joints[k];
                let ramp = Ramp {
                    acceleration: JOINT_SHARE * bound.acceleration,
                    jerk: JOINT_SHARE * bound.jerk,
                };
                let (dq, ddq) = (desired.dq[k], desired.ddq[k]);
                ramp.step(dq, ddq, target[k], PERIOD).0
            })
        };
        let next = towards(&wanted);
        // It brakes instead of what the robot would refuse, and where joints do not move the end
        // effector as told: near a singularity, with a wall ahead.
        let exceeded = self.limits.joints(desired, &desired.after(&next));
        let chain = Chain::new(measured.flange_from_ee);
        let jacobian = chain.posture(&desired.q).jacobian;
        let is_clear = self.room(&(jacobian * next), measured) > WALL_SHARE;
        if exceeded == Exceeded::default() && is_clear {
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
        "the end effector is at {axis} = {value:.3} m; workspace: {lower} to {upper}: guide the robot into it, or change [workspace]"
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
        "joint {joint} is at {value:.3} rad; allowed with joint_margin: {lower:.3} to {upper:.3}: guide the robot there"
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
    #[error("shaper: a bound is not a positive number")]
    Shaper,
}

fn check(bounds: &Bounds, limits: &Limits, measured: &Measured) -> Result<(), StartError> {
    let at: &Vector3<f64> = &measured.base_from_ee.translation.vector;
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
    for (k, bound) in limits.joints.iter().enumerate() {
        let margin = bounds.joint_margin;
        let (lower, upper) = (bound.lower + margin, bound.upper - margin);
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
