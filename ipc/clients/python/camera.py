#!/usr/bin/env python3
"""A free-flying camera that plays the emulator's part: publishes features, integrates the twists that come back.

    vpcd --scene ipc/scene/scenes/paper-sim.toml --clock lockstep &
    pip install -r ipc/clients/python/requirements.txt
    python3 ipc/clients/python/camera.py --scene ipc/scene/scenes/paper-sim.toml

From one start [0.2 m to the right of the goal], or from those of a file, one after another, each a new run:

    python3 ipc/clients/python/camera.py --scene ipc/scene/scenes/paper-sim.toml \\
        --starts ipc/scene/scenes/paper-sim-starts.csv --all --json runs.json

A run ends at the goal, where a point comes too deep into an occlusion or out of the image, or when the scene's time is
up: as `cargo table` judges it. Needs Python 3.11 or later. Exit code 0 where the goal was
reached; with --all and --first where every run was driven to its end, whatever it came to.
"""

import argparse
import csv
import json
import pathlib
import sys
import time
import tomllib

try:
    import numpy as np
    import vpc_client
except ModuleNotFoundError as missing:
    sys.exit(f"camera: {missing.name} is missing; pip install -r ipc/clients/python/requirements.txt")
from referee import Referee

# Least depth of a point that a camera sees, m.
IN_FRONT = 1e-6


def cross_matrix(vector):
    x, y, z = vector
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def rotation(vector):
    """Rotation matrix of a rotation vector (axis times angle)."""
    angle = np.linalg.norm(vector)
    if angle < 1e-12:
        return np.eye(3) + cross_matrix(vector)
    cross = cross_matrix(np.asarray(vector) / angle)
    return np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross


class Camera:
    """A pinhole camera and the pattern's points in its frame."""

    def __init__(self, scene, pose):
        """`pose`: the object in the camera frame, m and rotation vector in rad."""
        self.intrinsics = [scene["camera"][key] for key in ("fx", "fy", "cx", "cy")]
        pattern = np.array(scene["pattern"]["points"])
        self.points = pattern @ rotation(pose[3:]).T + np.array(pose[:3])

    def sees(self):
        return bool((self.points[:, 2] >= IN_FRONT).all())

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
            cross = cross_matrix(w / angle)
            left = np.eye(3) + (1 - np.cos(angle)) / angle * cross + (1 - np.sin(angle) / angle) * cross @ cross
        # The camera's new pose in its old frame is (rotation(w), left v); points change by its inverse.
        self.points = (self.points - left @ v) @ rotation(w)


def run(scene, referee, ports, start, steps):
    """Closes the loop from a start for at most `steps` periods; what became of it."""
    camera = Camera(scene, start)
    period = 1.0 / scene["camera"]["rate_hz"]
    state = vpc_client.TwistState.STOPPED
    begin_ns = time.monotonic_ns()
    ports.restart()

    def ended(step, reason, error):
        return {"success": reason is None, "reason": reason, "steps": step, "error_px": error, "state": state.words}

    for step in range(steps):
        if not camera.sees():
            return ended(step, "lost_sight", float("inf"))
        pixels = camera.pixels()
        error = referee.error(pixels)
        if referee.violation(pixels):
            return ended(step, "violation", error)
        if referee.arrived(pixels):
            return ended(step, None, error)
        # In lockstep the frames are the clock.
        sent = ports.publish_features(pixels.tolist(), published_ns=begin_ns + int(1e9 * period * step))
        answer = ports.wait_for_answer(sent)
        state = vpc_client.TwistState(answer.state)
        camera.move(answer.twist, period)
    error = referee.error(camera.pixels()) if camera.sees() else float("inf")
    return ended(steps, "not_converged", error)


def read_starts(path):
    with open(path, newline="") as file:
        return [[float(row[key]) for key in ("tx", "ty", "tz", "rx", "ry", "rz")] for row in csv.DictReader(file)]


def parse():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scene", required=True, help="scene file (TOML)")
    parser.add_argument("--domain", help=f"directory of the domain [{vpc_client.default_directory()}]")
    parser.add_argument("--steps", type=int, help="most control periods of a run [the scene's time]")
    parser.add_argument("--json", help="file for the result of each run")
    starts = parser.add_mutually_exclusive_group()
    starts.add_argument(
        "--start",
        type=float,
        nargs=6,
        metavar=("TX", "TY", "TZ", "RX", "RY", "RZ"),
        help="object in the camera frame at the start, m and rotation vector in rad [0.2 m to the right of the goal]",
    )
    starts.add_argument("--starts", help="start poses (CSV: tx,ty,tz,rx,ry,rz)")
    which = parser.add_mutually_exclusive_group()
    which.add_argument("--index", type=int, default=0, help="index of the start, from 0 [%(default)s]")
    which.add_argument("--first", type=int, help="run only this many starts, from the first on")
    which.add_argument("--all", action="store_true", help="run all starts")
    return parser, parser.parse_args()


def read_scene(path):
    with open(path, "rb") as file:
        try:
            scene = tomllib.load(file)
        except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
            raise ValueError(f"{path}: not a scene: {error}") from None
    for table in ("camera", "pattern", "goal", "success"):
        if table not in scene:
            raise ValueError(f"{path}: not a scene: [{table}] is missing")
    return scene


def main():
    parser, arguments = parse()
    scene = read_scene(arguments.scene)
    many = False
    if arguments.starts:
        poses = dict(enumerate(read_starts(arguments.starts)))
        many = arguments.all or arguments.first is not None
        if not many:
            if arguments.index not in poses:
                parser.error(f"--index {arguments.index}; allowed: 0 to {len(poses) - 1}")
            poses = {arguments.index: poses[arguments.index]}
        elif arguments.first is not None:
            poses = {index: pose for index, pose in poses.items() if index < arguments.first}
    elif arguments.all or arguments.first is not None:
        parser.error("--all and --first need --starts")
    else:
        goal = scene["goal"]
        poses = {0: arguments.start or (np.array(goal["translation"]) + [0.2, 0.0, 0.1]).tolist() + goal["rotation"]}
    steps = arguments.steps or round(scene["success"]["time_s"] * scene["camera"]["rate_hz"])

    goal = Camera(scene, scene["goal"]["translation"] + scene["goal"]["rotation"]).pixels()
    referee = Referee(scene, goal, pathlib.Path(arguments.scene).parent)
    runs = []
    with vpc_client.Domain(arguments.domain) as domain, domain.camera() as ports:
        if not domain.has_controller():
            words = f"camera: no vpcd is in domain {domain.directory}; waiting up to 10 s for one (vpcd --clock lockstep)"
            print(words, file=sys.stderr, flush=True)
            domain.wait_for_controller()
        for index, pose in poses.items():
            result = run(scene, referee, ports, pose, steps)
            runs.append({"start": index, **result})
            head = f"start {index}: " if many else ""
            verdict = "" if result["success"] else f", {result['reason']}"
            print(
                f"{head}{result['steps']} steps, final error {result['error_px']:.3f} px (threshold"
                f" {scene['success']['convergence_px']} px), controller {result['state']}{verdict}",
                flush=True,
            )
    good = sum(result["success"] for result in runs)
    if many:
        print(f"success {good} of {len(runs)} ({100.0 * good / max(len(runs), 1):.1f} %)")
    if arguments.json:
        with open(arguments.json, "w") as file:
            json.dump({"scene": arguments.scene, "starts": arguments.starts, "runs": runs}, file, indent=1)
    return 0 if many or good == len(runs) else 1


if __name__ == "__main__":
    try:
        sys.exit(main())
    except (vpc_client.VpcError, OSError, ValueError) as error:
        sys.exit(f"camera: {error}")
