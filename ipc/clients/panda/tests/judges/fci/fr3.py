"""A client of the vendor's library for the FR3: does one thing with the robot, and prints what it saw.

    fr3.py ADDRESS CASE

The last line is one JSON object; the test judges it. Exceptions of the library stand in it by their
message; null is none.
"""

import gc
import math
import struct

import pylibfranka as lf
from judge import judge

# Maker of commands, numbers in one, the axis that moves, and the state's echo and its derivative.
CARTESIAN = (lf.CartesianVelocities, 6, 2, "O_dP_EE_c", "O_ddP_EE_c")
JOINT = (lf.JointVelocities, 7, 6, "dq_d", "ddq_d")
SECONDS = 2.0
# m/s and rad/s.
TOP = 0.05
# States hold numbers of 32 bits: an extrapolation from two of them is that far off.
ROUNDING = 1e-7


def attempt(action):
    """The message of the exception that the library throws; None if it throws none."""
    try:
        action()
    except (lf.FrankaException, RuntimeError) as error:
        return str(error)
    return None


def milliseconds(state):
    return round(1e3 * state.time.to_sec())


def run(robot, kind, velocity):
    """Runs a motion: `velocity` takes a state and the seconds since the last, and gives the velocity of
    the axis that moves, and whether it is the last."""
    make, count, axis, _, _ = kind
    start = robot.start_joint_velocity_control if make is lf.JointVelocities else robot.start_cartesian_velocity_control
    control = start(lf.ControllerMode.JointImpedance)
    try:
        is_last = False
        while not is_last:
            state, period = control.readOnce()
            numbers = [0.0] * count
            numbers[axis], is_last = velocity(state, period.to_sec())
            command = make(numbers)
            command.motion_finished = is_last
            control.writeOnce(command)
    finally:
        # The robot takes the next motion when this object is gone.
        del control
        gc.collect()


def move(robot, kind=CARTESIAN):
    """There and back, a sine, cubed so that it begins and ends without a jump in acceleration: how it
    ended, how far it came, and what the states echoed."""
    _, _, axis, echo, derivative = kind
    states, sent = [], []
    elapsed = 0.0

    def velocity(state, period):
        nonlocal elapsed
        elapsed += period
        speed = TOP * math.sin(2 * math.pi * min(elapsed, SECONDS) / SECONDS) ** 3
        place = state.q[axis] if kind is JOINT else state.O_T_EE[12 + axis]
        rate = state.control_command_success_rate
        now = (milliseconds(state), getattr(state, echo)[axis], getattr(state, derivative)[axis], rate, place)
        states.append(now)
        sent.append(speed)
        return speed, elapsed >= SECONDS

    error = attempt(lambda: run(robot, kind, velocity))
    places = [state[4] for state in states]
    return {
        "error": error,
        "states": len(states),
        "way": max(places) - places[0] if places else 0.0,
        "miss": places[-1] - places[0] if places else 0.0,
        "echo": echoes(states, sent),
    }


def echoes(states, sent):
    """As in panda.py: what the next state echoes, and how often something else where nothing was lost."""
    counts = dict.fromkeys(["commanded", "extrapolated", "other", "denied"], 0)
    for (at, was, change, _, _), speed, (then, now, _, rate, _) in zip(states, sent, states[1:]):
        if then != at + 1:
            continue
        if now == struct.unpack("f", struct.pack("f", speed))[0]:
            counts["commanded"] += 1
            continue
        counts["extrapolated" if abs(now - was - 1e-3 * change) <= ROUNDING else "other"] += 1
        counts["denied"] += rate == 1.0
    return counts


def errors(of):
    return [name for name in dir(of) if getattr(of, name) is True]


def seen(robot):
    # While the library waits for an answer, its socket fills with states and drops newer ones.
    robot.read_once()
    state = robot.read_once()
    return {
        "mode": state.robot_mode.name,
        "errors": {"now": errors(state.current_errors), "last_motion": errors(state.last_motion_errors)},
    }


def handshake(robot):
    times = [milliseconds(robot.read_once()) for _ in range(200)]
    state = robot.read_once()
    poses = {name: list(getattr(state, name)) for name in ["F_T_NE", "NE_T_EE", "F_T_EE"]}
    return seen(robot) | poses | {
        "rises": all(b > a for a, b in zip(times, times[1:])),
        "model": attempt(robot.load_model),
    }


def waves(robot):
    return {"joint": move(robot, JOINT), "cartesian": move(robot, CARTESIAN)}


def reflex(robot):
    step = lambda state, period: (0.025, False)
    found = {"step": attempt(lambda: run(robot, CARTESIAN, step)), "then": seen(robot)}
    found["refused"] = attempt(lambda: run(robot, CARTESIAN, step))
    found["recovery"] = attempt(robot.automatic_error_recovery)
    return found | {"recovered": seen(robot), "wave": move(robot)}


def taper(robot):
    """Joint 6 at 1.5 rad/s down to the end of its range."""
    make, count, _, *rest = JOINT
    elapsed, last = 0.0, None

    def velocity(state, period):
        nonlocal elapsed, last
        elapsed += period
        last = (state.q_d[5], state.dq_d[5])
        return -0.75 * (1 - math.cos(math.pi * min(elapsed / 0.6, 1.0))), False

    error = attempt(lambda: run(robot, (make, count, 5, *rest), velocity))
    return {"error": error, "q": last[0], "dq": last[1], "recovery": attempt(robot.automatic_error_recovery)}


CASES = [handshake, waves, reflex, taper]

judge(lambda address: lf.Robot(address, lf.RealtimeConfig.kIgnore), attempt, CASES)
