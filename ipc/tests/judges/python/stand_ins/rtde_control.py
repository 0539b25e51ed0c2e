"""Stands in for ur-rtde's module: the calls of robot_bridge.py, with the names, defaults and results of 1.6.5."""

import time

import numpy as np
import stand_in


class RTDEControlInterface:
    def __init__(self, hostname, frequency=-1.0, flags=1, ur_cap_port=50002, rt_priority=0):
        self.arm = stand_in.arm(hostname)
        self.watchdog_s, self.kicked = np.inf, time.monotonic()

    def getTCPOffset(self):
        return [*stand_in.OFFSET, *stand_in.log(stand_in.from_rpy(*stand_in.OFFSET_RPY)).tolist()]

    def setWatchdog(self, min_frequency=10.0):
        self.arm.log("setWatchdog", frequency=min_frequency)
        self.watchdog_s = 1.0 / min_frequency
        return True

    def kickWatchdog(self):
        self.arm.until = time.monotonic() + self.watchdog_s
        return True

    def speedL(self, xd, acceleration=0.25, time=0.0):
        assert len(xd) == 6 and 0.0 < acceleration <= 40.0
        self.arm.log("speedL", twist=xd, acceleration=acceleration, time=time)
        self.arm.move(xd)
        return not self.arm.fault()

    def speedStop(self, a=10.0):
        self.arm.log("speedStop", a=a)
        self.arm.move(np.zeros(6))
        return True

    def stopScript(self):
        self.arm.log("stopScript")

    def isProgramRunning(self):
        return not self.arm.fault()
