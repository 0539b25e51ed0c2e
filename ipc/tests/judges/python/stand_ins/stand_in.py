"""An arm whose tool carries out every velocity exactly and at once. In place of a robot's address it takes a path: it
appends its commands there as JSON lines, with the tool's place before each, and is at fault while PATH.fault exists; while
PATH.nan exists it does not know where it is."""

import json
import os
import time

import numpy as np

# m, with the tool turned to look down, and turned on about that.
PLACE = [0.5, 0.1, 0.3]
RPY = [3.0, 0.2, 0.6]
OFFSET = [0.02, -0.01, 0.12]
OFFSET_RPY = [0.1, -0.2, 0.3]


def exp(vector):
    angle = np.linalg.norm(vector)
    x, y, z = np.asarray(vector) / (angle or 1.0)
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross


def log(turn):
    """Rotation vector of a rotation matrix, for turns of less than 180 degrees."""
    axis = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]) / 2.0
    sine = np.linalg.norm(axis)
    return axis * (np.arctan2(sine, (np.trace(turn) - 1.0) / 2.0) / sine) if sine > 0.0 else axis


def from_rpy(roll, pitch, yaw):
    return exp([0.0, 0.0, yaw]) @ exp([0.0, pitch, 0.0]) @ exp([roll, 0.0, 0.0])


def to_rpy(turn):
    return [
        np.arctan2(turn[2, 1], turn[2, 2]),
        np.arctan2(-turn[2, 0], np.hypot(turn[2, 1], turn[2, 2])),
        np.arctan2(turn[1, 0], turn[0, 0]),
    ]


class Arm:
    def __init__(self, path):
        self.path = path
        self.place, self.turn = np.array(PLACE), from_rpy(*RPY)
        # Of the tool along base axes, m/s and rad/s, until this instant.
        self.twist, self.until, self.at = np.zeros(6), np.inf, time.monotonic()

    def advance(self):
        now = time.monotonic()
        duration = max(min(now, self.until) - self.at, 0.0)
        self.place = self.place + self.twist[:3] * duration
        self.turn = exp(self.twist[3:] * duration) @ self.turn
        self.at = now
        if now >= self.until or self.fault():
            self.twist = np.zeros(6)

    def fault(self):
        """Removing the file is what somebody does at the robot who clears the fault."""
        return os.path.exists(self.path + ".fault")

    def known_place(self):
        return (self.place * (np.nan if os.path.exists(self.path + ".nan") else 1.0)).tolist()

    def move(self, twist, until=np.inf):
        self.advance()
        if not self.fault():
            self.twist, self.until = np.array(twist, dtype=float), until

    def log(self, call, **arguments):
        self.advance()
        line = {"call": call, "at_ns": time.monotonic_ns(), **arguments}
        line |= {"place": self.place.tolist(), "turn": self.turn.tolist()}
        with open(self.path, "a") as file:
            file.write(json.dumps(line) + "\n")


ARMS = {}


def arm(path):
    """The one arm behind an address."""
    return ARMS.setdefault(path, Arm(path))
