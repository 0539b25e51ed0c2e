//! The robot behind the vendor's interface: what its states say, in our types.

use franka::{
    ActiveMotionGenerator, CartesianVelocities, FciVersion, FrankaResult, JointVelocities,
    MoveControllerMode, RealtimeConfig, RobotMode as Mode, RobotOptions, RobotState as Told,
    VersionPolicy,
};
use ipc::{RobotFaults, RobotMode, RobotState};
use nalgebra::{Matrix4, Rotation3, Translation3};
use panda::limits::Setpoint;
use panda::{Chain, Echo, Errors, Flag, JOINTS, Joints, Model, Mount, Pose, Twist};

use crate::config::{Config, Interface};
use crate::steering::{Limited, Measured, Output};

/// Connects with the robot's version of the interface: a Panda's is 5, an FR3's 10.
///
/// # Errors
/// The robot does not answer, has another client, or speaks another version.
pub fn connect(config: &Config) -> FrankaResult<franka::Robot> {
    let version = match config.model {
        Model::Panda => FciVersion::V5,
        Model::Fr3 => FciVersion::V10,
    };
    let options = RobotOptions::new(RealtimeConfig::Ignore);
    let options = options.with_version(VersionPolicy::Exact(version));
    // It takes the highest real-time priority for the thread that connects: one that ends here.
    std::thread::scope(|scope| {
        let connecting = scope.spawn(|| franka::Robot::with_options(&config.robot, options));
        connecting.join().unwrap_or_else(|_| {
            let why = "the client library panicked".to_owned();
            Err(franka::FrankaError::Network(why))
        })
    })
}

/// A transformation, column by column.
pub fn pose(columns: &[f64; 16]) -> Pose {
    let matrix = Matrix4::from_column_slice(columns);
    let rotation = matrix.fixed_view::<3, 3>(0, 0).into_owned();
    let translation = matrix.fixed_view::<3, 1>(0, 3).into_owned();
    Pose::from_parts(
        Translation3::from(translation),
        Rotation3::from_matrix_unchecked(rotation),
    )
}

/// What steering needs.
pub fn measured(state: &Told) -> Measured {
    Measured {
        base_from_ee: pose(&state.O_T_EE),
        flange_from_ee: pose(&state.F_T_EE),
        desired: Setpoint {
            q: Joints::from(state.q_d),
            dq: Joints::from(state.dq_d),
            ddq: Joints::from(state.ddq_d),
        },
        echo: Echo {
            twist: Twist::from(state.O_dP_EE_c),
            acceleration: Twist::from(state.O_ddP_EE_c),
        },
    }
}

/// What a robot is about, beyond its state.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Doing {
    /// A motion runs, with these limits.
    Moves(Limited),
    /// None runs yet.
    Waits,
    /// None can begin.
    Refused,
}

/// The state for `vpc/robot`.
pub fn told(state: &Told, mount: &Mount, doing: Doing, data_ns: u64) -> RobotState {
    let mut told = RobotState::free_camera([0.0; 3], [0.0; 3], data_ns);
    let mode = match (state.robot_mode, doing) {
        (Mode::Move, Doing::Moves(limited)) if limited.is_stale => RobotMode::Stale,
        (Mode::Move, Doing::Moves(_)) => RobotMode::Moving,
        (Mode::Idle, Doing::Waits) | (Mode::Move, _) => RobotMode::Idle,
        _ => RobotMode::Fault,
    };
    told.mode = mode.code();
    let limited = match doing {
        Doing::Moves(limited) => limited,
        _ => Limited::default(),
    };
    let is_limited = limited.is_cut || limited.by_workspace || limited.by_joint;
    for (fault, is_raised) in [
        (RobotFaults::REFLEX, state.robot_mode == Mode::Reflex),
        (RobotFaults::STALE_COMMAND, mode == RobotMode::Stale),
        (RobotFaults::COMMAND_LIMITED, is_limited),
        (RobotFaults::JOINT_LIMIT, limited.by_joint),
    ] {
        told.faults |= if is_raised { fault.0 } else { 0 };
    }
    let (base_from_ee, flange_from_ee) = (pose(&state.O_T_EE), pose(&state.F_T_EE));
    // What is carried out: by the desired joints, on either interface.
    let chain = Chain::new(flange_from_ee);
    let jacobian = chain.posture(&Joints::from(state.q_d)).jacobian;
    let twist = jacobian * Joints::from(state.dq_d);
    let camera = mount.to_camera(&base_from_ee.rotation, &flange_from_ee, &twist);
    told.twist = camera.into();
    told.joints = JOINTS as u32;
    (told.q, told.dq) = (state.q, state.dq);
    told.room = [
        f64::from(mode_number(state.robot_mode)),
        f64::from(bits(&state.current_errors)),
        f64::from(bits(&state.last_motion_errors)),
        state.control_command_success_rate,
        0.0,
        0.0,
        0.0,
        0.0,
    ];
    told
}

/// As `CONTRACT.md` lists them; 0 for what it does not list.
fn mode_number(mode: Mode) -> u32 {
    match mode {
        Mode::Idle => 1,
        Mode::Move => 2,
        Mode::Reflex => 3,
        Mode::UserStopped => 4,
        Mode::AutomaticErrorRecovery => 5,
        Mode::Other | Mode::Guiding => 0,
    }
}

/// The errors that the contract has bits for; the log names all.
fn bits(errors: &franka::Errors) -> u32 {
    let flags = Flag::ALL.iter();
    Errors::raised(flags.map(|flag| (*flag, errors.get(flag.name())))).bits()
}

/// A motion under way.
pub enum Motion<'a> {
    /// Of joint velocities.
    Joint(ActiveMotionGenerator<'a, JointVelocities>),
    /// Of velocities of the end effector.
    Cartesian(ActiveMotionGenerator<'a, CartesianVelocities>),
}

impl<'a> Motion<'a> {
    /// Begins one; the robot's own impedance controller tracks it.
    ///
    /// # Errors
    /// The robot refuses, or is gone.
    pub fn begin(robot: &'a franka::Robot, interface: Interface) -> FrankaResult<Self> {
        let tracked = MoveControllerMode::JointImpedance;
        Ok(match interface {
            Interface::Joint => Self::Joint(robot.start_joint_velocity_control(tracked)?),
            Interface::Cartesian => {
                Self::Cartesian(robot.start_cartesian_velocity_control(tracked)?)
            }
        })
    }

    /// Waits for the next state.
    ///
    /// # Errors
    /// The robot ended the motion, or is gone.
    pub fn state(&mut self) -> FrankaResult<Told> {
        let (state, _) = match self {
            Self::Joint(motion) => motion.read_once()?,
            Self::Cartesian(motion) => motion.read_once()?,
        };
        Ok(state)
    }

    /// Answers the last state; the last answer of a motion ends it.
    ///
    /// # Errors
    /// The robot ended the motion, or is gone.
    pub fn answer(&mut self, output: &Output, is_last: bool) -> FrankaResult<()> {
        match (self, output) {
            (Self::Joint(motion), Output::Joint(dq)) => {
                let mut command = JointVelocities::new((*dq).into());
                command.motion_finished = is_last;
                motion.write_once(&command, None)
            }
            (Self::Cartesian(motion), Output::Cartesian(twist)) => {
                let mut command = CartesianVelocities::new((*twist).into());
                command.motion_finished = is_last;
                motion.write_once(&command, None)
            }
            // Steering was made for the same interface.
            _ => Ok(()),
        }
    }
}
