#!/usr/bin/env python3
"""A free-flying camera that plays the emulator's part: publishes features, integrates the twists that come back.

    vpcd --scene ipc/scene/scenes/paper-sim.toml --clock lockstep &
    pip install -r ipc/python/requirements.txt
    python3 ipc/python/camera.py --scene ipc/scene/scenes/paper-sim.toml

Needs Python 3.11 or later. Exit code 0 where the goal was reached.
"""

import argparse
import sys
import tomllib

import contract
import numpy as np



def rotation(vector):
    """Rotation matrix of a rotation vector (axis times angle)."""
    angle = np.linalg.norm(vector)
    x, y, z = vector
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    if angle < 1e-12:
        return np.eye(3) + cross
    cross /= angle
    return np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross


class Camera:
    """A pinhole camera and the pattern's points in its frame."""

    def __init__(self, scene, translation, rotation_vector):
        self.intrinsics = [scene["camera"][key] for key in ("fx", "fy", "cx", "cy")]
        pattern = np.array(scene["pattern"]["points"])
        self.points = pattern @ rotation(np.array(rotation_vector)).T + np.array(translation)

    def pixels(self):
        fx, fy, cx, cy = self.intrinsics
        x, y, z = self.points.T
        return np.column_stack((cx + fx * x / z, cy + fy * y / z))

    def move(self, twist, duration):
        """Exact rigid motion of the camera under a constant twist in its own frame: what it sees moves the other way."""
        v, w = np.array(twist[:3]) * duration, np.array(twist[3:]) * duration
        angle = np.linalg.norm(w)
        if angle < 1e-9:
            left = np.eye(3)
        else:
            axis = w / angle
            x, y, z = axis
            cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
            left = np.eye(3) + (1 - np.cos(angle)) / angle * cross + (1 - np.sin(angle) / angle) * cross @ cross
        # The camera's new pose in its old frame is (rotation(w), left v); points change by its inverse.
        self.points = (self.points - left @ v) @ rotation(w)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scene", required=True, help="scene file (TOML)")
    parser.add_argument("--domain", default=contract.default_directory(), help="directory of the domain [%(default)s]")
    parser.add_argument("--steps", type=int, default=450, help="most control periods [%(default)s]")
    parser.add_argument(
        "--start",
        type=float,
        nargs=6,
        metavar=("TX", "TY", "TZ", "RX", "RY", "RZ"),
        help="object in the camera frame at the start, m and rotation vector in rad [0.2 m to the right of the goal]",
    )
    arguments = parser.parse_args()
    with open(arguments.scene, "rb") as file:
        scene = tomllib.load(file)

    goal = scene["goal"]
    start = arguments.start or (np.array(goal["translation"]) + [0.2, 0.0, 0.1]).tolist() + goal["rotation"]
    wanted = Camera(scene, goal["translation"], goal["rotation"]).pixels()
    camera = Camera(scene, start[:3], start[3:])
    period = 1.0 / scene["camera"]["rate_hz"]
    threshold = scene["success"]["convergence_px"]

    domain = contract.Domain(arguments.domain)
    ports = contract.CameraPorts(domain)
    state = contract.STOPPED
    for step in range(arguments.steps):
        pixels = camera.pixels()
        error = np.abs(pixels - wanted).max()
        if error < threshold:
            break
        twist, state = ports.wait_for_answer(ports.publish(pixels.tolist()))
        camera.move(twist, period)
    else:
        step = arguments.steps
    error = np.abs(camera.pixels() - wanted).max()
    print(f"{step} steps, final error {error:.3f} px (threshold {threshold} px), controller {contract.STATES[state]}")
    return 0 if error < threshold else 1


if __name__ == "__main__":
    sys.exit(main())
