"""Stands in for xarm-python-sdk's module: the calls of robot_bridge.py, with the names, defaults, units and results of 1.18.
An xArm 7."""

import math
import time

import numpy as np
import stand_in


class XArmAPI:
    axis = 7
    connected = True
    version_number = (2, 5, 0)

    def __init__(self, port=None, is_radian=False, do_not_open=False, **kwargs):
        self.arm, self.is_radian = stand_in.arm(port), is_radian
        self.mode, self._state = 0, 4

    def _angles(self, radians, is_radian):
        is_radian = self.is_radian if is_radian is None else is_radian
        return [round(float(v if is_radian else math.degrees(v)), 6) for v in radians]

    @property
    def state(self):
        return 4 if self.arm.fault() else self._state

    @property
    def error_code(self):
        return 31 if self.arm.fault() else 0

    @property
    def tcp_offset(self):
        return [1000.0 * v for v in stand_in.OFFSET] + self._angles(stand_in.OFFSET_RPY, None)

    @property
    def realtime_joint_speeds(self):
        return self._angles([0.01, 0.02, 0.03, 0.04, 0.05, 0.06, 0.07], None)

    def set_mode(self, mode=0, detection_param=0):
        self.arm.log("set_mode", mode=mode)
        self.mode = mode
        return 0

    def set_state(self, state=0):
        self.arm.log("set_state", state=state)
        self._state = 2 if state == 0 else state
        return 0

    def get_position(self, is_radian=None):
        self.arm.advance()
        place = [round(1000.0 * v, 6) for v in self.arm.known_place()]
        return 0, place + self._angles(stand_in.to_rpy(self.arm.turn), is_radian)

    def get_servo_angle(self, servo_id=None, is_radian=None, is_real=False):
        return 0, self._angles([0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7], is_radian)

    def vc_set_cartesian_velocity(self, speeds, is_radian=None, is_tool_coord=False, duration=-1, **kwargs):
        is_radian = self.is_radian if is_radian is None else is_radian
        turn = speeds[3:6] if is_radian else np.radians(speeds[3:6]).tolist()
        twist = [v / 1000.0 for v in speeds[:3]] + turn
        assert not is_tool_coord
        self.arm.log("vc_set_cartesian_velocity", twist=twist, duration=duration)
        if self.arm.fault():
            return 1
        if self.mode != 5 or self._state >= 3:
            return 9
        self.arm.move(twist, time.monotonic() + duration if duration > 0 else np.inf)
        return 0

    def disconnect(self):
        self.arm.log("disconnect")
