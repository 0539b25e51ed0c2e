"""Clients of other teams, for an FR3: franky-control plans its motions itself, aiofranka has a model of its own.

    others.py ADDRESS CASE

The last line is one JSON object; the test judges it. Exceptions stand in it by their message; null is none.
"""

import sys

import numpy as np
from judge import judge

# Both bring a libfranka in pybind11: one process takes only one of them.
IS_MODEL = sys.argv[2] == "model"
if IS_MODEL:
    from aiofranka.robot import RobotInterface
else:
    import franky

SECONDS = 0.8
# m/s and rad/s, of the end effector along its own z and of the last joint.
SPEED, TURN = 0.04, 0.1


def attempt(action):
    try:
        action()
    except Exception as error:
        return str(error)
    return None


def connect(address):
    if IS_MODEL:
        return RobotInterface(address)
    robot = franky.Robot(address, realtime_config=franky.RealtimeConfig.Ignore)
    robot.relative_dynamics_factor = 0.05
    return robot


def moved(robot, motion, stop, place):
    """How a motion and the stop after it ended, and how far it came."""
    begin = place()
    error = attempt(lambda: robot.move(motion)) or attempt(lambda: robot.move(stop))
    return {"error": error, "way": place() - begin, "has_errors": robot.has_errors}


def waves(robot):
    duration = franky.Duration(round(1e3 * SECONDS))
    upwards = franky.CartesianVelocityMotion(franky.Twist([0.0, 0.0, SPEED], [0.0, 0.0, 0.0]), duration=duration)
    turning = franky.JointVelocityMotion([0.0] * 6 + [TURN], duration=duration)
    height = lambda: float(np.array(robot.state.O_T_EE.matrix)[2, 3])
    return {
        "cartesian": moved(robot, upwards, franky.CartesianVelocityStopMotion(), height),
        "joint": moved(robot, turning, franky.JointVelocityStopMotion(), lambda: float(robot.state.q[6])),
        "position": attempt(lambda: robot.move(franky.JointMotion(list(robot.state.q)))),
    }


def model(robot):
    """The flange by aiofranka's MuJoCo model, beside that of the robot's state."""
    state, found = robot.robot.read_once(), robot.state
    told = np.array(state.O_T_EE).reshape(4, 4).T @ np.linalg.inv(np.array(state.F_T_EE).reshape(4, 4).T)
    return {
        "differ": float(np.abs(told - found["ee"]).max()),
        "joints_differ": float(np.abs(np.array(state.q) - found["qpos"]).max()),
        "torque": attempt(robot.start),
    }


judge(connect, attempt, [waves, model])
