#!/usr/bin/env python3
"""From vpcd to a robot that takes velocities of its tool: a Universal Robots arm by `ur-rtde`, or a UFACTORY xArm by
`xarm-python-sdk`. Copy it; for another robot, write one more class beside UniversalRobot and XArm.

    pip install -r ipc/clients/python/requirements.txt ur-rtde          # or xarm-python-sdk
    python3 ipc/clients/python/robot_bridge.py ur 192.168.1.10 --hand-eye hand-eye.toml \\
        --lower 0.2 -0.4 0.1 --upper 0.7 0.4 0.6 --dry-run

--dry-run prints frames and what would be sent, and moves nothing. Leave it out to drive the arm. SIGTERM and SIGINT
bring it to rest (exit code 0).

NOT RUN ON A ROBOT: it was tested against stand-ins with the signatures and units of ur-rtde 1.6.5 and xarm-python-sdk
1.18. Begin with --dry-run, then --linear 0.005 --angular 0.02, and a hand on the emergency stop. Watch the turns of an
xArm first: we take its angular velocity to be along base axes, which its documentation does not say.
"""

import argparse
import math
import signal
import sys
import time
import tomllib
from collections import deque
from dataclasses import dataclass, replace

try:
    import numpy as np
    import vpc_client
except ModuleNotFoundError as missing:
    sys.exit(f"robot_bridge: {missing.name} is missing; pip install -r ipc/clients/python/requirements.txt")
from vpc_client import BadArgument, RobotFaults, RobotMode

# Deceleration with which the tool nears a wall of its workspace, m/s^2: a fifth of the ramp's, which so can follow.
NEARING = 0.1
# The tool stands below this, m/s and rad/s.
AT_REST = 1e-6


def rotation(vector):
    """Rotation matrix of a rotation vector (axis times angle)."""
    angle = float(np.linalg.norm(vector))
    x, y, z = np.asarray(vector, dtype=float) / (angle or 1.0)
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + math.sin(angle) * cross + (1.0 - math.cos(angle)) * cross @ cross


def rotation_rpy(roll, pitch, yaw):
    """Rotation matrix Rz(yaw) Ry(pitch) Rx(roll)."""
    return rotation([0.0, 0.0, yaw]) @ rotation([0.0, pitch, 0.0]) @ rotation([roll, 0.0, 0.0])


@dataclass
class Pose:
    """Of one frame in another: m, rotation matrix."""

    translation: np.ndarray
    rotation: np.ndarray


@dataclass
class Measured:
    """What a driver reads in one cycle."""

    base_from_tool: Pose
    flange_from_tool: Pose
    # Velocity of the tool's origin along base axes, m/s and rad/s.
    twist: np.ndarray
    # Six or seven joints, rad and rad/s.
    q: list
    dq: list
    # Why the robot obeys nobody; None while it is well.
    fault: str | None

    def is_finite(self):
        base, tool = self.base_from_tool, self.flange_from_tool
        parts = (base.translation, base.rotation, tool.translation, tool.rotation, self.twist, self.q, self.dq)
        return all(np.isfinite(part).all() for part in parts)


class UniversalRobot:
    """`speedL(xd, acceleration, time)`: tool velocity along base axes. ur-rtde's script on the robot repeats it until the
    next one, even if we are dead: the script's watchdog must be on. `time` is what one repetition takes, not how long the
    velocity holds. The next velocity waits for it; with 0 it waits until this one is reached."""

    PERIOD_S = 1.0 / 125.0

    def __init__(self, address, acceleration):
        import rtde_control
        import rtde_receive

        # One number limits m/s^2 and rad/s^2. Our ramp acts before it.
        self.acceleration = max(acceleration)
        self.receive = rtde_receive.RTDEReceiveInterface(address)
        # Starts ur-rtde's script on the robot; needs remote control.
        self.control = rtde_control.RTDEControlInterface(address, 1.0 / self.PERIOD_S)
        # It asks the script: not for every cycle. Restart the bridge after a change of the TCP.
        *translation, rx, ry, rz = self.control.getTCPOffset()
        self.flange_from_tool = Pose(np.array(translation), rotation([rx, ry, rz]))
        self.is_refused = False

    def start(self):
        # The script, and with it the motion, ends when nothing comes for 100 ms.
        if not self.control.setWatchdog(10.0):
            raise OSError("ur: setWatchdog was refused; is the robot in remote control?")

    def measured(self):
        pose, receive = self.receive.getActualTCPPose(), self.receive
        safety, mode = receive.getSafetyMode(), receive.getRobotMode()
        reasons = {
            "protective stop": receive.isProtectiveStopped(),
            "emergency stop": receive.isEmergencyStopped(),
            "not connected": not receive.isConnected(),
            f"safety mode {safety}; allowed: 1 (normal), 2 (reduced)": safety not in (1, 2),
            f"robot mode {mode}; allowed: 7 (running)": mode != 7,
            "the control script does not run": not self.control.isProgramRunning(),
            "speedL was refused": self.is_refused,
        }
        return Measured(
            Pose(np.array(pose[:3]), rotation(pose[3:])),
            self.flange_from_tool,
            np.array(receive.getActualTCPSpeed()),
            receive.getActualQ(),
            receive.getActualQd(),
            next((reason for reason, holds in reasons.items() if holds), None),
        )

    def send(self, twist):
        self.is_refused |= not self.control.speedL(twist.tolist(), self.acceleration, self.PERIOD_S)
        self.control.kickWatchdog()

    def stop(self):
        """Ends the motion; the arm stands already, if all went well."""
        self.control.speedStop(self.acceleration)
        self.control.stopScript()


class XArm:
    """`vc_set_cartesian_velocity`: mm/s and rad/s along base axes, in mode 5. The robot stops itself after `duration`.
    It reports no velocity of its tool: that is measured here, over the last WINDOW poses."""

    PERIOD_S = 1.0 / 50.0
    WINDOW = 4
    HOLDS_S = 0.1

    def __init__(self, address, _acceleration):
        from xarm.wrapper import XArmAPI

        self.arm = XArmAPI(address, is_radian=True)
        self.poses, self.code, self.is_started = deque(maxlen=self.WINDOW), 0, False
        if tuple(self.arm.version_number) < (1, 8, 0):
            raise BadArgument(f"xarm: firmware {self.arm.version_number}; allowed: 1.8.0 and later, for `duration`")
        if self.arm.axis not in (6, 7):
            raise BadArgument(f"xarm: axis = {self.arm.axis}; allowed: 6 or 7")

    def start(self):
        """Errors stay: clear them and enable the motors in UFACTORY's own program."""
        for code in (self.arm.set_mode(5), self.arm.set_state(0)):
            if code != 0:
                raise OSError(f"xarm: set_mode or set_state returned {code}; error_code {self.arm.error_code}")
        # The arm reports its mode a little later.
        for _ in range(100):
            if self.arm.mode == 5 and self.arm.state < 3:
                self.is_started = True
                return
            time.sleep(0.02)
        raise OSError(f"xarm: mode {self.arm.mode}, state {self.arm.state}; allowed: mode 5, states 0 to 2")

    def measured(self):
        arm = self.arm
        code, pose = arm.get_position(is_radian=True)
        at = time.monotonic()
        angles_code, q = arm.get_servo_angle(is_radian=True)
        code = code or angles_code or self.code
        reasons = {
            "not connected": not arm.connected,
            f"error_code {arm.error_code}": arm.error_code != 0,
            f"state {arm.state}; allowed: 0 to 2": self.is_started and arm.state >= 3,
            f"mode {arm.mode}; allowed: 5": self.is_started and arm.mode != 5,
            f"a call returned {code}": code != 0,
        }
        fault = next((reason for reason, holds in reasons.items() if holds), None)
        if not all(isinstance(v, (int, float)) for v in pose):
            raise OSError(f"xarm: {fault}")
        here = Pose(np.array(pose[:3]) / 1000.0, rotation_rpy(*pose[3:6]))
        offset = arm.tcp_offset
        tool = Pose(np.array(offset[:3]) / 1000.0, rotation_rpy(*offset[3:6]))
        self.poses.append((at, here))
        dq = arm.realtime_joint_speeds
        return Measured(here, tool, self._velocity(), q[: arm.axis], dq[: arm.axis], fault)

    def _velocity(self):
        (begin, old), (end, new) = self.poses[0], self.poses[-1]
        if end <= begin:
            return np.zeros(6)
        # For the small turns of a few cycles, twice the sine is the angle.
        turn = new.rotation @ old.rotation.T
        axis = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
        return np.concatenate((new.translation - old.translation, axis / 2.0)) / (end - begin)

    def send(self, twist):
        speeds = [1000.0 * v for v in twist[:3]] + twist[3:].tolist()
        self.code = self.arm.vc_set_cartesian_velocity(
            speeds, is_radian=True, is_tool_coord=False, duration=self.HOLDS_S
        )

    def stop(self):
        self.arm.vc_set_cartesian_velocity([0.0] * 6, is_radian=True, is_tool_coord=False, duration=self.HOLDS_S)
        self.arm.disconnect()


ROBOTS = {"ur": UniversalRobot, "xarm": XArm}


class Bridge:
    """From vpc/twist to what the tool is sent, and from the robot to vpc/robot. Whatever is beyond a limit slows the
    camera down; it never turns it elsewhere."""

    def __init__(self, domain, flange_from_camera, arguments):
        self.mount, self.limits = flange_from_camera, arguments
        self.twists, self.states = domain.subscribe("vpc/twist", 4), domain.publisher("vpc/robot")
        self.command, self.has_obeyed, self.is_over, self.fault = None, False, False, None
        self.sent, self.sent_at = np.zeros(6), time.monotonic()
        # The last finite measurement; when the bridge was ready.
        self.measured, self.begun_ns = None, vpc_client.now_ns()

    def camera_in_base(self, measured):
        """The camera's axes in the base, and where it is from the tool's origin, along base axes."""
        base, tool = measured.base_from_tool.rotation, measured.flange_from_tool
        lever = base @ tool.rotation.T @ (self.mount.translation - tool.translation)
        return base @ tool.rotation.T @ self.mount.rotation, lever

    def share(self, wanted, place):
        """The share of a velocity that the workspace allows: speed falls to zero at a wall."""
        allowed = 1.0
        for v, x, lower, upper in zip(wanted, place, self.limits.lower, self.limits.upper, strict=False):
            room = upper - x if v > 0.0 else x - lower
            if abs(v) > 0.0:
                # max(0, NaN) is 0.
                allowed = min(allowed, math.sqrt(2.0 * NEARING * max(0.0, room)) / abs(v))
        return allowed

    def ramp(self, wanted):
        """The next velocity on the way to `wanted`. All axes take one share: the camera keeps its direction."""
        now = time.monotonic()
        # A late cycle is no reason for a jump.
        period, self.sent_at = min(now - self.sent_at, 0.04), now
        change = wanted - self.sent
        needed = max(
            np.linalg.norm(change[:3]) / self.limits.linear_acceleration,
            np.linalg.norm(change[3:]) / self.limits.angular_acceleration,
        )
        return wanted if needed <= period else self.sent + change * (period / needed)

    def step(self, measured):
        """One cycle of the robot: what to send, None at a fault; tells vpc/robot."""
        if measured.is_finite():
            self.measured = measured
        else:
            measured = replace(self.measured, fault="its pose, velocity or joints are not finite")
        try:
            self.command = self.twists.latest() or self.command
        except vpc_client.BadMessage as error:
            self.command = None
            print(f"robot_bridge: {error}", file=sys.stderr, flush=True)
        # What was meant for somebody before us is not obeyed.
        if self.command is not None and self.command.stamp.published_ns < self.begun_ns:
            self.command = None
        now = vpc_client.now_ns()
        asked = np.array(vpc_client.twist_in_force(None if self.is_over else self.command, now))
        is_stale = self.is_over or now >= vpc_client.in_force_until_ns(self.command)
        self.has_obeyed |= not is_stale
        axes, lever = self.camera_in_base(measured)
        linear, angular = np.linalg.norm(asked[:3]), np.linalg.norm(asked[3:])
        cap = min(1.0, self.limits.linear / max(linear, 1e-9), self.limits.angular / max(angular, 1e-9))
        turn = axes @ asked[3:]
        wanted = cap * np.concatenate((axes @ asked[:3] - np.cross(turn, lever), turn))
        share = self.share(wanted, measured.base_from_tool.translation)
        # A fault stays until the bridge is started again: it clears none.
        if measured.fault and self.fault is None:
            self.fault = measured.fault
            print(f"robot_bridge: fault: {self.fault}; start again once it is cleared", file=sys.stderr, flush=True)
        self.sent = np.zeros(6) if self.fault else self.ramp(share * wanted)
        self.tell(measured, axes, lever, now, is_stale, cap * share < 1.0)
        return None if self.fault else self.sent

    def tell(self, measured, axes, lever, now, is_stale, is_limited):
        state = vpc_client.RobotState()
        state.stamp.data_ns = now
        if self.fault:
            state.mode = RobotMode.FAULT
        elif not self.has_obeyed or self.limits.dry_run:
            state.mode = RobotMode.IDLE
        else:
            state.mode = RobotMode.STALE if is_stale else RobotMode.MOVING
        is_stale = state.mode == RobotMode.STALE
        raised = {RobotFaults.REFLEX: bool(self.fault), RobotFaults.STALE_COMMAND: is_stale}
        raised[RobotFaults.COMMAND_LIMITED] = is_limited
        state.faults = sum(int(fault) for fault, holds in raised.items() if holds)
        linear, angular = measured.twist[:3], measured.twist[3:]
        linear = linear + np.cross(angular, lever)
        state.twist[:] = [*(axes.T @ linear), *(axes.T @ angular)]
        state.joints = len(measured.q)
        state.q[: state.joints], state.dq[: state.joints] = measured.q, measured.dq
        self.states.publish(state)

    def run(self, driver):
        """Until SIGTERM or SIGINT, and then until the arm was sent zero."""
        due, said, self.begun_ns = time.monotonic(), 0.0, vpc_client.now_ns()
        while not self.is_over or (np.abs(self.sent) > AT_REST).any():
            twist = self.step(driver.measured())
            if self.limits.dry_run:
                if time.monotonic() - said >= 1.0:
                    said = time.monotonic()
                    print("would send", np.round(self.sent, 5).tolist(), flush=True)
            elif twist is not None:
                driver.send(twist)
            due = max(due + driver.PERIOD_S, time.monotonic())
            time.sleep(max(due - time.monotonic(), 0.0))


def read_hand_eye(path):
    """The camera in the flange; as ipc/clients/panda/hand-eye.toml."""
    with open(path, "rb") as file:
        try:
            table = tomllib.load(file)
        except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
            raise BadArgument(f"{path}: {error}; allowed: TOML") from None
    for key in ("translation", "rotation_deg"):
        value = table.get(key)
        numbers = value if isinstance(value, list) and len(value) == 3 else [None]
        if not all(isinstance(v, (int, float)) and math.isfinite(v) for v in numbers):
            raise BadArgument(f"{path}: {key} = {value}; allowed: three finite numbers")
    return Pose(np.array(table["translation"], dtype=float), rotation(np.radians(table["rotation_deg"])))


def parse():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("robot", choices=ROBOTS)
    parser.add_argument("address", help="of the robot's control box")
    parser.add_argument("--hand-eye", required=True, help="the camera in the flange (TOML)")
    parser.add_argument("--domain", help=f"directory of the domain [{vpc_client.default_directory()}]")
    for name, words in (("lower", "least"), ("upper", "greatest")):
        help = f"{words} place of the tool's origin in the base, m"
        parser.add_argument(f"--{name}", type=float, nargs=3, required=True, metavar=("X", "Y", "Z"), help=help)
    most = {"linear": 0.25, "angular": 1.0, "linear-acceleration": 2.0, "angular-acceleration": 5.0}
    units = ("m/s", "rad/s", "m/s^2", "rad/s^2")
    for (name, largest), value, unit in zip(most.items(), (0.05, 0.25, 0.5, 1.2), units, strict=True):
        parser.add_argument(f"--{name}", type=float, default=value, help=f"{unit}, up to {largest} [%(default)s]")
    parser.add_argument("--dry-run", action="store_true", help="print frames and what would be sent; move nothing")
    arguments = parser.parse_args()
    for name, largest in most.items():
        value = getattr(arguments, name.replace("-", "_"))
        if not 0.0 < value <= largest:
            raise BadArgument(f"--{name} {value}; allowed: more than 0, up to {largest}")
    for axis, lower, upper in zip("xyz", arguments.lower, arguments.upper, strict=True):
        if not -10.0 <= lower < upper <= 10.0:
            raise BadArgument(f"--lower {axis} = {lower}, --upper {axis} = {upper}; allowed: -10 to 10 m, lower first")
    return arguments


def main():
    arguments = parse()
    mount = read_hand_eye(arguments.hand_eye)
    driver = ROBOTS[arguments.robot](arguments.address, (arguments.linear_acceleration, arguments.angular_acceleration))
    measured = driver.measured()
    if not measured.is_finite():
        raise BadArgument(f"the robot's state is not finite: {measured}")
    place = measured.base_from_tool.translation
    for axis, x, lower, upper in zip("xyz", place, arguments.lower, arguments.upper, strict=True):
        if not lower <= x <= upper:
            raise BadArgument(f"the tool's {axis} = {x:.4f} m in the base; allowed: the workspace, {lower} to {upper}")
    with vpc_client.Domain(arguments.domain) as domain:
        bridge = Bridge(domain, mount, arguments)
        bridge.measured = measured

        def end(*_):
            bridge.is_over = True

        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, end)
        axes, lever = bridge.camera_in_base(measured)
        print(f"tool in the base {place.round(4).tolist()} m, camera {(place + lever).round(4).tolist()} m", flush=True)
        print(f"camera's x, y, z along base axes {axes.T.round(3).tolist()}, fault: {measured.fault}", flush=True)
        if arguments.dry_run:
            bridge.run(driver)
            return
        driver.start()
        print("ready", flush=True)
        try:
            bridge.run(driver)
        finally:
            driver.stop()


if __name__ == "__main__":
    try:
        main()
    except ModuleNotFoundError as missing:
        sys.exit(f"robot_bridge: {missing.name} is missing; pip install ur-rtde, or xarm-python-sdk")
    except (vpc_client.VpcError, OSError, RuntimeError, ValueError) as error:
        sys.exit(f"robot_bridge: {error}")
