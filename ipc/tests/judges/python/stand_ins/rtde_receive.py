"""Stands in for ur-rtde's module: the calls of robot_bridge.py, with the names, defaults and results of 1.6.5."""

import stand_in


class RTDEReceiveInterface:
    def __init__(
        self, hostname, frequency=-1.0, variables=(), verbose=False, use_upper_range_registers=False, rt_priority=0
    ):
        self.arm = stand_in.arm(hostname)

    def getActualTCPPose(self):
        self.arm.advance()
        return [*self.arm.known_place(), *stand_in.log(self.arm.turn).tolist()]

    def getActualTCPSpeed(self):
        self.arm.advance()
        return self.arm.twist.tolist()

    def getActualQ(self):
        return [0.1, 0.2, 0.3, 0.4, 0.5, 0.6]

    def getActualQd(self):
        return [0.01, 0.02, 0.03, 0.04, 0.05, 0.06]

    def getSafetyMode(self):
        return 3 if self.arm.fault() else 1

    def getRobotMode(self):
        return 7

    def isProtectiveStopped(self):
        return self.arm.fault()

    def isEmergencyStopped(self):
        return False

    def isConnected(self):
        return True
