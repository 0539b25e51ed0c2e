//! The robot's state in every millisecond: the modelled fields of the real one.

use crate::errors::Errors;
use crate::kinematics::{Joints, Pose, Twist};
use crate::mode::Mode;

/// The robot at one instant. Names as in `franka::RobotState`, in lower case: `o_t_ee_d` is
/// O_T_EE_d.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct State {
    /// Number that a command must carry to answer this state.
    pub id: u64,
    /// Since the robot's start, ms; grows by one a step.
    pub time: u64,
    /// Measured joint positions, rad.
    pub q: Joints,
    /// Desired joint positions, rad.
    pub q_d: Joints,
    /// Measured joint velocities, rad/s.
    pub dq: Joints,
    /// Desired joint velocities, rad/s.
    pub dq_d: Joints,
    /// Desired joint accelerations, rad/s^2.
    pub ddq_d: Joints,
    /// Measured end effector in the base.
    pub o_t_ee: Pose,
    /// End effector of the desired joints in the base.
    pub o_t_ee_d: Pose,
    /// The integral of the commanded velocities; `o_t_ee_d` if no Cartesian motion runs.
    pub o_t_ee_c: Pose,
    /// F_T_EE, the end effector in the flange: F_T_NE NE_T_EE.
    pub f_t_ee: Pose,
    /// F_T_NE, as it is set at the desk.
    pub f_t_ne: Pose,
    /// NE_T_EE, as a client has set it.
    pub ne_t_ee: Pose,
    /// Velocity of the end effector's origin along base axes, of the desired joints.
    pub o_dp_ee_d: Twist,
    /// The last commanded velocity, or its extrapolation; zero if no Cartesian motion runs.
    pub o_dp_ee_c: Twist,
    /// Its difference quotient, m/s^2 and rad/s^2.
    pub o_ddp_ee_c: Twist,
    /// Mode.
    pub robot_mode: Mode,
    /// Errors that stand.
    pub current_errors: Errors,
    /// Errors that ended the last motion.
    pub last_motion_errors: Errors,
    /// Share of the last 100 commands that came in time, 0 to 1; 0 if no motion runs.
    pub control_command_success_rate: f64,
}

impl State {
    /// O_T_F, the measured flange in the base.
    pub fn flange(&self) -> Pose {
        self.o_t_ee * self.f_t_ee.inverse()
    }
}
