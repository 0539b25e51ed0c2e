"""A client of the vendor's library: does one thing with the robot, and prints what it saw.

    panda.py ADDRESS CASE

The last line is one JSON object; the test judges it. A line `moving MS` says that a motion is in full
swing, and the robot's time. Exceptions of the library stand in it by their message; null is none.
"""

import json
import math
import re
import time

import panda_py
from judge import judge
from panda_py import libfranka as lf

# What stock calls of the vendor's library have, and what switches them off.
STOCK = (True, 100.0)
RAW = (False, 1000.0)
CARTESIAN = (lf.CartesianVelocities, 6, 2, "O_dP_EE_c", "O_ddP_EE_c")
JOINT = (lf.JointVelocities, 7, 6, "dq_d", "ddq_d")
SECONDS = 2.0
# m/s and rad/s.
TOP = 0.05


def attempt(action):
    """The message of the exception that the library throws; None if it throws none."""
    try:
        action()
    except RuntimeError as error:
        return str(error)
    return None


def run(robot, kind, callback, options):
    """Runs a motion of velocities to its end."""
    control = robot.control_joint_velocity if kind is JOINT else robot.control_cartesian_velocity
    control(callback, lf.ControllerMode.kJointImpedance, *options)


def wave(kind, seconds):
    """There and back: a sine, cubed so that it begins and ends without a jump in acceleration."""
    make, count, axis, _, _ = kind
    velocity = [0.0] * count
    velocity[axis] = TOP * math.sin(2 * math.pi * min(seconds, SECONDS) / SECONDS) ** 3
    return velocity, make(velocity)


def move(robot, kind=CARTESIAN, options=RAW):
    """A wave of two seconds: how it ended, how far it came, what the states echoed, and silences."""
    _, _, axis, echo, derivative = kind
    states, sent, instants = [], [], []
    elapsed = 0.0

    def callback(state, duration):
        nonlocal elapsed
        before, elapsed = elapsed, elapsed + duration.to_sec()
        numbers, command = wave(kind, elapsed)
        place = state.q[axis] if kind is JOINT else state.O_T_EE[12 + axis]
        rate = state.control_command_success_rate
        states.append((state.time.to_msec(), getattr(state, echo), getattr(state, derivative), rate, place))
        sent.append(numbers)
        instants.append(time.monotonic())
        if before < 0.5 <= elapsed:
            print("moving", state.time.to_msec(), flush=True)
        return lf.motion_finished(command) if elapsed >= SECONDS else command

    error = attempt(lambda: run(robot, kind, callback, options))
    # Of a motion that finishes, the end is no silence: the robot answers when it stands.
    until = instants + ([time.monotonic()] if error else [])
    places = [state[4] for state in states]
    times = [state[0] for state in states]
    return {
        "error": error,
        "states": len(states),
        "way": max(places) - places[0] if places else 0.0,
        "miss": places[-1] - places[0] if places else 0.0,
        "gap_ms": max((b - a for a, b in zip(times, times[1:])), default=0),
        "silence_ms": 1e3 * max((b - a for a, b in zip(until, until[1:])), default=0.0),
        "echo": echoes(states, sent, options),
    }


def echoes(states, sent, options):
    """Counts what the next state echoes: the command, what the robot puts in the place of a lost one
    (constant acceleration), or something else. Where none of the last hundred was lost, it must be the
    command: those that are something else then are `denied`."""
    counts = dict.fromkeys(["commanded", "extrapolated", "other", "denied"], 0)
    tolerance = 1e-12 if options == STOCK else 0.0
    for (at, was, change, _, _), numbers, (then, now, _, rate, _) in zip(states, sent, states[1:]):
        if then != at + 1:
            continue
        if options == STOCK:
            # libfranka's lowpassFilter; its limiter changes nothing in a motion that is slow.
            gain = 1e-3 / (1e-3 + 1 / (2 * math.pi * options[1]))
            numbers = [gain * y + (1 - gain) * last for y, last in zip(numbers, was)]
        lost = [v + 1e-3 * a for v, a in zip(was, change)]
        if distance(now, numbers) <= tolerance:
            counts["commanded"] += 1
            continue
        counts["extrapolated" if distance(now, lost) <= 1e-12 else "other"] += 1
        counts["denied"] += rate == 1.0
    return counts


def distance(a, b):
    return max(abs(x - y) for x, y in zip(a, b, strict=True))


def errors(state):
    """The names in the state's errors, now and of the last motion."""
    names = lambda of: re.findall(r'"(\w+)"', str(of))
    return {"now": names(state.current_errors), "last_motion": names(state.last_motion_errors)}


def mode(robot):
    return robot.read_once().robot_mode.name


def shown(robot):
    """A state as the library prints it: with what its Python has no names for, to six digits."""
    return json.loads(str(robot.read_once()))


def handshake(robot):
    times = []

    def read(state):
        times.append(state.time.to_msec())
        return len(times) < 200

    robot.read(read)
    state = robot.read_once()
    # Column by column. Its hand is 0.4 mm shorter: 103 mm.
    pose = panda_py.fk(state.q).T.ravel()
    pose[12:15] += 0.0004 * pose[8:11]
    return {
        "version": robot.server_version(),
        "state": shown(robot),
        "rises": all(b > a for a, b in zip(times, times[1:])),
        "kinematics_differ": distance(pose, state.O_T_EE),
    }


def waves(robot):
    return {"stock": move(robot, CARTESIAN, STOCK), "raw": move(robot, CARTESIAN, RAW)}


def joints(robot):
    return {"stock": move(robot, JOINT, STOCK), "raw": move(robot, JOINT, RAW)}


def reflex(robot):
    step = lambda state, duration: lf.CartesianVelocities([0.0, 0.0, 0.025, 0.0, 0.0, 0.0])
    found = {"step": attempt(lambda: run(robot, CARTESIAN, step, RAW))}
    found["errors"] = errors(robot.read_once())
    found["mode"] = mode(robot)
    found["refused"] = attempt(lambda: run(robot, CARTESIAN, step, RAW))
    found["recovery"] = attempt(robot.automatic_error_recovery)
    found["recovered_mode"] = mode(robot)
    found["recovered_errors"] = errors(robot.read_once())
    return found | {"wave": move(robot)}


def finish_in_motion(robot):
    elapsed = 0.0

    def callback(state, duration):
        nonlocal elapsed
        elapsed += duration.to_sec()
        _, command = wave(CARTESIAN, elapsed)
        return lf.motion_finished(command) if elapsed >= SECONDS / 4 else command

    found = {"error": attempt(lambda: run(robot, CARTESIAN, callback, RAW))}
    # At once, while the robot may still brake: as the vendor's examples do it.
    found["recovery"] = attempt(robot.automatic_error_recovery)
    return found | {"mode": mode(robot), "wave": move(robot)}


def one_wave(robot):
    found = {"mode": mode(robot), "errors": errors(robot.read_once())}
    if found["mode"] == "kReflex":
        found["recovery"] = attempt(robot.automatic_error_recovery)
    return found | {"wave": move(robot)}


def refusals(robot):
    impedance = lf.ControllerMode.kJointImpedance
    pose = lambda state, duration: lf.CartesianPose(state.O_T_EE_c)
    positions = lambda state, duration: lf.JointPositions(state.q_d)
    torques = lambda state, duration: lf.Torques([0.0] * 7)
    return {
        "torques": attempt(lambda: robot.control(torques)),
        "pose": attempt(lambda: robot.control_cartesian_pose(pose, impedance)),
        "positions": attempt(lambda: robot.control_joint_position(positions, impedance)),
        "model": attempt(robot.load_model),
        "mode": mode(robot),
        "errors": errors(robot.read_once()),
        "wave": move(robot),
    }


def end_effector(robot):
    # Turned by 90 degrees about z, and 5 cm further out.
    longer = [0.0, 1.0, 0, 0, -1.0, 0.0, 0, 0, 0, 0, 1.0, 0, 0, 0, 0.05, 1.0]
    before = shown(robot)
    found = {}
    calls = 0

    def callback(state, duration):
        nonlocal calls
        calls += 1
        if calls == 100:
            found["while_moving"] = attempt(lambda: robot.set_ee(longer))
        still = lf.CartesianVelocities([0.0] * 6)
        return lf.motion_finished(still) if calls >= 200 else still

    found["motion"] = attempt(lambda: run(robot, CARTESIAN, callback, RAW))
    found["kept"] = shown(robot)["NE_T_EE"] == before["NE_T_EE"]
    found["no_pose"] = attempt(lambda: robot.set_ee([2.0, *longer[1:]]))
    found["at_rest"] = attempt(lambda: robot.set_ee(longer))
    after = shown(robot)
    found |= {name: after[name] for name in ["NE_T_EE", "F_T_NE", "F_T_EE"]}
    ahead = [b - a for a, b in zip(before["O_T_EE"][12:15], after["O_T_EE"][12:15])]
    found["out_m"] = sum(x * z for x, z in zip(ahead, before["O_T_EE"][8:11]))
    return found | {"wave": move(robot)}


CASES = [handshake, waves, joints, reflex, finish_in_motion, one_wave, refusals, end_effector]

judge(lambda address: lf.Robot(address, lf.RealtimeConfig.kIgnore), attempt, CASES)
