//! The robot that carries the camera.

use ipc::RobotPorts;
use messages::{Message, RobotState, TwistCommand};

use crate::boundary::{self, Fault, Handle};
use crate::domain::Domain;
use crate::status::Status;

/// Receives twists, publishes the robot's state.
pub type Robot = Handle<RobotPorts>;

/// Opens the robot's ports, beside any camera's. VPC_STATUS_TAKEN while another robot is at work.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vpc_robot_open(domain: *mut Domain, out: *mut *mut Robot) -> Status {
    boundary::enter(|| {
        // SAFETY: the header asks for a handle.
        let domain = unsafe { boundary::handle(domain, "domain") }?;
        let robot = RobotPorts::open(domain)?;
        // SAFETY: the header asks for a place.
        unsafe { boundary::give(out, robot) }
    })
}

/// Closes the robot's ports. NULL does nothing.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vpc_robot_close(robot: *mut Robot) -> Status {
    // SAFETY: the header asks for a handle that is not used again.
    boundary::enter(|| unsafe { boundary::close(robot, "robot") })
}

/// The newest command since the last call; VPC_STATUS_NOTHING if there is none. What it lets a
/// robot do, and for how long, vpc_twist_in_force says.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vpc_robot_twist(robot: *mut Robot, out: *mut TwistCommand) -> Status {
    boundary::enter(|| {
        // SAFETY: the header asks for a handle.
        let robot = unsafe { boundary::handle(robot, "robot") }?;
        let twist = robot.twist.latest()?;
        let twist =
            twist.ok_or_else(|| Fault::new(Status::Nothing, "vpc/twist: no command came"))?;
        // SAFETY: the header asks for a place.
        unsafe { boundary::put(out, "out", twist.message) }
    })
}

/// The dead man of every robot in real time: into `twist` (6 numbers, m/s and rad/s, camera frame)
/// goes what the newest command lets it do at this instant (CLOCK_MONOTONIC, ns): zero once it is
/// no longer valid, is older than 100 ms whatever it claims, is from the future or of lockstep, is
/// not finite, or is NULL because none came yet. Call it in every cycle of the robot.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vpc_twist_in_force(
    newest: *const TwistCommand,
    now_ns: u64,
    twist: *mut [f64; 6],
) -> Status {
    boundary::enter(|| {
        let in_force = match newest.is_null() {
            true => [0.0; 6],
            // SAFETY: the header asks for NULL or a command.
            false => unsafe { boundary::get(newest, "newest") }?.in_force(now_ns),
        };
        // SAFETY: the header asks for a place.
        unsafe { boundary::put(twist, "twist", in_force) }
    })
}

/// Publishes the robot's state; sequence and time of publication are filled in, the rest is as
/// given.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vpc_robot_publish(robot: *mut Robot, state: *const RobotState) -> Status {
    boundary::enter(|| {
        // SAFETY: the header asks for a handle.
        let robot = unsafe { boundary::handle(robot, "robot") }?;
        // SAFETY: the header asks for a state.
        let mut state = unsafe { boundary::get(state, "state") }?;
        state.stamp.sequence = 1;
        state.check()?;
        robot.robot.publish(&state)?;
        Ok(())
    })
}
