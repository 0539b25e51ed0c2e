//! A robot and a client that answers every state in time.

use arm::Echo;
use panda::limits::{PERIOD, Setpoint};
use panda::{Command, Joints, Mode, Motion, MotionKind, READY, Robot, RobotSettings, State, Twist};

/// A robot at the ready position.
pub fn ready() -> Robot {
    at(READY)
}

/// A robot at these positions.
pub fn at(q: [f64; 7]) -> Robot {
    Robot::new(RobotSettings::default(), Joints::from(q)).expect("positions in range")
}

/// The ready position with another position of the joint with this number, from 1.
pub fn ready_but(joint: usize, position: f64) -> Robot {
    let mut q = READY;
    q[joint - 1] = position;
    at(q)
}

/// A robot that a Cartesian motion was started on.
pub fn moving(mut robot: Robot) -> Robot {
    robot.start(MotionKind::Cartesian).expect("idle");
    robot
}

/// Answers the present state with a Cartesian velocity.
pub fn answer(robot: &mut Robot, twist: Twist) -> State {
    let command = Command {
        id: robot.state().id,
        motion: Motion::Cartesian(twist),
        elbow: None,
        finished: false,
    };
    *robot.step(&[command])
}

/// Speeds up along an axis at an even acceleration (m/s^2 or rad/s^2), built up and never taken
/// back.
pub fn speed_up(robot: &mut Robot, axis: usize, acceleration: f64, to: f64) {
    let mut current = robot.state().o_ddp_ee_c[axis];
    while robot.state().robot_mode == Mode::Move && robot.state().o_dp_ee_c[axis].abs() < to {
        current += (acceleration - current).clamp(-0.1, 0.1);
        let mut twist = robot.state().o_dp_ee_c;
        twist[axis] += current * PERIOD;
        answer(robot, twist);
    }
}

/// Steps without commands until the desired joints stand, each step within the joints' bounds, and
/// gives the number of steps.
pub fn watch_stop(robot: &mut Robot) -> usize {
    let mut before = setpoint(robot.state());
    for steps in 0..1000 {
        if before.dq == Joints::zeros() {
            return steps;
        }
        let state = *robot.step(&[]);
        let after = setpoint(&state);
        for k in 0..7 {
            let bound = &robot.limits().joints[k];
            let jerk = (after.ddq[k] - before.ddq[k]) / PERIOD;
            assert!(
                after.ddq[k].abs() <= bound.acceleration * 1.001,
                "joint {k}"
            );
            assert!(jerk.abs() <= bound.jerk * 1.001, "joint {k}");
        }
        before = after;
    }
    panic!("it does not stop");
}

/// The last command by the robot's account.
pub fn echo(state: &State) -> Echo {
    Echo {
        twist: state.o_dp_ee_c,
        acceleration: state.o_ddp_ee_c,
    }
}

fn setpoint(state: &State) -> Setpoint {
    Setpoint {
        q: state.q_d,
        dq: state.dq_d,
        ddq: state.ddq_d,
    }
}
