//! The robot behind the vendor's interface: what its states say, in our types.

use std::ops::Deref;
use std::sync::atomic::{AtomicU64, Ordering};

use arm::{Chain, Echo, JOINTS, Joints, Limited, Model, Mount, Pose, Setpoint, Twist};
use franka::{
    ActiveMotionGenerator, CartesianVelocities, FciVersion, FrankaError, FrankaResult,
    JointVelocities, MoveControllerMode, RealtimeConfig, RobotMode as Mode, RobotOptions,
    RobotState as Told, VersionPolicy,
};
use ipc::now_ns;
use messages::{RobotFaults, RobotMode, RobotState};
use nalgebra::{Matrix3, Matrix4, Rotation3, Translation3};

use crate::config::{Config, Interface};
use crate::datagrams;
use crate::steering::{Measured, Output};

/// How far the number of a state may be ahead, ms: what is further is not the robot's.
const FAR_MS: u64 = 10_000;
/// Longest wait for a state with a new number: by then the library's own time-out of 1 s has
/// passed, unless something else comes.
const LONGEST_WAIT_NS: u64 = 2_000_000_000;

/// Since when a state is waited for, CLOCK_MONOTONIC, ns; 0: none is.
static WAITS_SINCE_NS: AtomicU64 = AtomicU64::new(0);
/// A number that was refused; 0: none was.
static REFUSED: AtomicU64 = AtomicU64::new(0);

/// Why nothing can come of the library any more, if so. It takes the state with the greatest
/// number, and waits for a greater one as long as datagrams come: after a forged number, for ever,
/// even where its motion is dropped.
pub fn hangs() -> Option<String> {
    let refused = REFUSED.load(Ordering::Relaxed);
    if refused > 0 {
        return Some(format!(
            "a state with the number {refused} is not the robot's"
        ));
    }
    let since = WAITS_SINCE_NS.load(Ordering::Relaxed);
    let is_long = since > 0 && now_ns().saturating_sub(since) > LONGEST_WAIT_NS;
    is_long.then(|| "datagrams come from the robot, and no new state".to_owned())
}

/// A robot. It accepts states from the robot's address only, and ends at an implausible number.
pub struct Robot {
    robot: franka::Robot,
    /// The last number; 0: none.
    last_ms: AtomicU64,
}

impl Deref for Robot {
    type Target = franka::Robot;

    fn deref(&self) -> &franka::Robot {
        &self.robot
    }
}

impl Robot {
    /// Waits for the next state, while no motion runs.
    ///
    /// # Errors
    /// The robot is gone, or the state is not its.
    pub fn read_once(&self) -> FrankaResult<Told> {
        self.awaited(|| self.robot.read_once())
    }

    fn awaited(&self, read: impl FnOnce() -> FrankaResult<Told>) -> FrankaResult<Told> {
        WAITS_SINCE_NS.store(now_ns(), Ordering::Relaxed);
        let state = read();
        WAITS_SINCE_NS.store(0, Ordering::Relaxed);
        let state = state?;
        let number = state.time.as_millis();
        let last = self.last_ms.load(Ordering::Relaxed);
        if last > 0 && number.saturating_sub(last) > FAR_MS {
            REFUSED.store(number, Ordering::Relaxed);
            let why = format!("a state with the number {number} came after {last}");
            return Err(FrankaError::Protocol(why));
        }
        self.last_ms.store(number, Ordering::Relaxed);
        Ok(state)
    }
}

/// Connects with the robot's version of the interface: a Panda's is 5, an FR3's 10.
///
/// # Errors
/// The robot does not answer, has another client, or speaks another version.
pub fn connect(config: &Config) -> FrankaResult<Robot> {
    let version = match config.model {
        Model::Panda => FciVersion::V5,
        Model::Fr3 => FciVersion::V10,
    };
    let options = RobotOptions::new(RealtimeConfig::Ignore);
    let options = options.with_version(VersionPolicy::Exact(version));
    // It takes the highest real-time priority for the thread that connects: one that ends here.
    let robot = std::thread::scope(|scope| {
        let connecting = scope.spawn(|| franka::Robot::with_options(&config.robot, options));
        connecting.join().unwrap_or_else(|_| {
            let why = "the client library panicked".to_owned();
            Err(FrankaError::Network(why))
        })
    })?;
    datagrams::of_robot_alone(&config.robot).map_err(|why| {
        FrankaError::Network(format!("no socket for the robot's datagrams alone: {why}"))
    })?;
    Ok(Robot {
        robot,
        last_ms: AtomicU64::new(0),
    })
}

/// A transformation, column by column. Real robots tell rotations that were rounded at their desk;
/// the columns are 1e-5 short. This takes the nearest rotation, to second order (a Newton-Schulz
/// step).
pub fn pose(columns: &[f64; 16]) -> Pose {
    let matrix = Matrix4::from_column_slice(columns);
    let rotation = matrix.fixed_view::<3, 3>(0, 0).into_owned();
    let translation = matrix.fixed_view::<3, 1>(0, 3).into_owned();
    Pose::from_parts(
        Translation3::from(translation),
        Rotation3::from_matrix_unchecked(
            rotation * (Matrix3::from_diagonal_element(1.5) - 0.5 * rotation.tr_mul(&rotation)),
        ),
    )
}

/// What steering needs.
pub fn measured(state: &Told) -> Measured {
    Measured {
        end_effector: arm::Measured {
            base_from_ee: pose(&state.O_T_EE),
            flange_from_ee: pose(&state.F_T_EE),
            echo: Echo {
                twist: Twist::from(state.O_dP_EE_c),
                acceleration: Twist::from(state.O_ddP_EE_c),
            },
        },
        desired: Setpoint {
            q: Joints::from(state.q_d),
            dq: Joints::from(state.dq_d),
            ddq: Joints::from(state.ddq_d),
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
    let chain = Chain::FRANKA.with_ee(flange_from_ee);
    let jacobian = chain.jacobian(&Joints::from(state.q_d));
    let twist = jacobian * Joints::from(state.dq_d);
    let camera = mount.to_camera(&base_from_ee.rotation, &flange_from_ee, &twist);
    told.twist = camera.into();
    told.joints = JOINTS as u32;
    (told.q, told.dq) = (state.q, state.dq);
    told.commands_in_time = state.control_command_success_rate;
    told
}

/// A motion under way.
pub struct Motion<'a> {
    robot: &'a Robot,
    generator: Generator<'a>,
}

enum Generator<'a> {
    Joint(ActiveMotionGenerator<'a, JointVelocities>),
    Cartesian(ActiveMotionGenerator<'a, CartesianVelocities>),
}

impl<'a> Motion<'a> {
    /// Begins one; the robot's own impedance controller tracks it.
    ///
    /// # Errors
    /// The robot refuses, or is gone.
    pub fn begin(robot: &'a Robot, interface: Interface) -> FrankaResult<Self> {
        let tracked = MoveControllerMode::JointImpedance;
        let generator = match interface {
            Interface::Joint => Generator::Joint(robot.start_joint_velocity_control(tracked)?),
            Interface::Cartesian => {
                Generator::Cartesian(robot.start_cartesian_velocity_control(tracked)?)
            }
        };
        Ok(Self { robot, generator })
    }

    /// Waits for the next state.
    ///
    /// # Errors
    /// The robot ended the motion, or is gone.
    pub fn state(&mut self) -> FrankaResult<Told> {
        self.robot.awaited(|| {
            let (state, _) = match &mut self.generator {
                Generator::Joint(motion) => motion.read_once()?,
                Generator::Cartesian(motion) => motion.read_once()?,
            };
            Ok(state)
        })
    }

    /// Answers the last state; the last answer of a motion ends it.
    ///
    /// # Errors
    /// The robot ended the motion, or is gone.
    pub fn answer(&mut self, output: &Output, is_last: bool) -> FrankaResult<()> {
        match (&mut self.generator, output) {
            (Generator::Joint(motion), Output::Joint(dq)) => {
                let mut command = JointVelocities::new((*dq).into());
                command.motion_finished = is_last;
                motion.write_once(&command, None)
            }
            (Generator::Cartesian(motion), Output::Cartesian(twist)) => {
                let mut command = CartesianVelocities::new((*twist).into());
                command.motion_finished = is_last;
                motion.write_once(&command, None)
            }
            // Steering was made for the same interface.
            _ => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_rounded_rotation_is_told_as_the_nearest_one() {
        let half = (1e4 * std::f64::consts::FRAC_1_SQRT_2).round() / 1e4;
        let told = [
            half, -half, 0.0, 0.0, half, half, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.1034, 1.0,
        ];
        let pose = pose(&told);
        let turn = pose.rotation.matrix();
        assert!((turn.tr_mul(turn) - Matrix3::identity()).amax() < 1e-9);
        let about_z = Rotation3::from_euler_angles(0.0, 0.0, -std::f64::consts::FRAC_PI_4);
        assert!((turn - about_z.matrix()).amax() < 1e-9);
        assert_eq!(pose.translation.z, 0.1034);
    }
}
