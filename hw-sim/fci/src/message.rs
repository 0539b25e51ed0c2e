//! What robot and client say to each other, whatever the version.

use crate::errors;

/// A homogeneous transformation, column by column.
pub type Transform = [f64; 16];

/// No turn and no translation.
pub const IDENTITY: Transform = {
    let mut identity = [0.0; 16];
    let mut k = 0;
    while k < 4 {
        identity[5 * k] = 1.0;
        k += 1;
    }
    identity
};

/// What a client asks for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(missing_docs)]
pub enum Kind {
    Connect,
    Move,
    StopMove,
    GetCartesianLimit,
    SetCollisionBehavior,
    SetJointImpedance,
    SetCartesianImpedance,
    SetGuidingMode,
    /// The stiffness frame in the end effector.
    SetEeToK,
    /// The end effector in the nominal one.
    SetNeToEe,
    SetLoad,
    SetFilters,
    AutomaticErrorRecovery,
    LoadModelLibrary,
    GetRobotModel,
}

/// A request with its arguments.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Request {
    /// Begin a motion.
    Move {
        /// What tracks it.
        controller: Controller,
        /// What it is made of.
        generator: Generator,
    },
    /// End the motion.
    StopMove,
    /// EE_T_K.
    SetEeToK(Transform),
    /// NE_T_EE.
    SetNeToEe(Transform),
    /// The load.
    SetLoad(Load),
    /// Clear the errors.
    AutomaticErrorRecovery,
    /// A setting of a kind that moves nothing here: its numbers are finite.
    Setting(Kind),
    /// Something that is asked of the robot, and is not known here.
    Query(Kind),
    /// Arguments that are not finite, or name nothing.
    Invalid(Kind),
}

/// What tracks a motion.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(u8)]
#[allow(missing_docs)]
pub enum Controller {
    JointImpedance,
    CartesianImpedance,
    /// Torques of the client.
    External,
    #[default]
    Other,
}

/// What a motion is made of.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(u8)]
#[allow(missing_docs)]
pub enum Generator {
    #[default]
    Idle,
    JointPosition,
    JointVelocity,
    CartesianPosition,
    CartesianVelocity,
    /// Torques alone; version 10.
    None,
}

/// A load in the hand.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Load {
    /// kg.
    pub mass: f64,
    /// Center of mass in the flange frame, m.
    pub center: [f64; 3],
    /// Inertia, column by column, kg m^2.
    pub inertia: [f64; 9],
}

/// How a request ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(missing_docs)]
pub enum Answer {
    Success,
    IncompatibleLibraryVersion,
    /// More comes when the motion ends.
    MotionStarted,
    /// Somebody stopped it.
    Preempted,
    PreemptedDueToActivatedSafetyFunctions,
    RejectedDueToActivatedSafetyFunctions,
    NotPossibleRejected,
    StartAtSingularPoseRejected,
    InvalidArgumentRejected,
    ManualErrorRecoveryRequiredRejected,
    ReflexAborted,
    EmergencyAborted,
    InputErrorAborted,
    Aborted,
    Error,
}

/// A command of a client, in a datagram.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Command {
    /// Number of the state that it answers.
    pub message_id: u64,
    /// Joint velocities, rad/s.
    pub dq_c: [f64; 7],
    /// End effector's velocity along base axes, m/s and rad/s.
    pub o_dp_ee_c: [f64; 6],
    /// Position of joint 3, the elbow, rad, where one is commanded.
    pub elbow_c: Option<f64>,
    /// Whether it is the last one of its motion.
    pub is_last: bool,
}

/// The robot's mode.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(u8)]
#[allow(missing_docs)]
pub enum Mode {
    #[default]
    Other,
    Idle,
    Move,
    Guiding,
    Reflex,
    UserStopped,
    AutomaticErrorRecovery,
}

/// The robot's state, under the vendor's names in lower case: O_T_EE_d is `o_t_ee_d`. What is not
/// here is sent as zeros: torques, contacts, the end effector's mass.
#[derive(Clone, Copy, Debug, PartialEq)]
#[allow(missing_docs)]
pub struct State {
    /// Number of the message; also the robot's time, ms.
    pub message_id: u64,
    pub o_t_ee: Transform,
    pub o_t_ee_d: Transform,
    pub o_t_ee_c: Transform,
    pub f_t_ee: Transform,
    pub ee_t_k: Transform,
    pub f_t_ne: Transform,
    pub ne_t_ee: Transform,
    pub load: Load,
    /// Position of joint 3, rad, and the sign of joint 4.
    pub elbow: [f64; 2],
    pub elbow_d: [f64; 2],
    pub q: [f64; 7],
    pub q_d: [f64; 7],
    pub dq: [f64; 7],
    pub dq_d: [f64; 7],
    pub ddq_d: [f64; 7],
    pub o_dp_ee_d: [f64; 6],
    pub o_dp_ee_c: [f64; 6],
    pub o_ddp_ee_c: [f64; 6],
    pub generator: Generator,
    pub controller: Controller,
    /// In the order of [`errors::NAMES`].
    pub errors: [bool; errors::COUNT],
    /// Those that ended the last motion.
    pub reflex_reason: [bool; errors::COUNT],
    pub mode: Mode,
    /// 0 to 1.
    pub control_command_success_rate: f64,
}

impl Default for State {
    fn default() -> Self {
        Self {
            message_id: 0,
            o_t_ee: IDENTITY,
            o_t_ee_d: IDENTITY,
            o_t_ee_c: IDENTITY,
            f_t_ee: IDENTITY,
            ee_t_k: IDENTITY,
            f_t_ne: IDENTITY,
            ne_t_ee: IDENTITY,
            load: Load::default(),
            elbow: [0.0; 2],
            elbow_d: [0.0; 2],
            q: [0.0; 7],
            q_d: [0.0; 7],
            dq: [0.0; 7],
            dq_d: [0.0; 7],
            ddq_d: [0.0; 7],
            o_dp_ee_d: [0.0; 6],
            o_dp_ee_c: [0.0; 6],
            o_ddp_ee_c: [0.0; 6],
            generator: Generator::Idle,
            controller: Controller::Other,
            errors: [false; errors::COUNT],
            reflex_reason: [false; errors::COUNT],
            mode: Mode::Other,
            control_command_success_rate: 0.0,
        }
    }
}
