"""Camera and robot in ROS 2: an exact pinhole over a scene's pattern, moved by the twists that come.

    peer.py dds|rcl ROS_DOMAIN_ID SCENE STARTS [--base]

Takes one command a line on standard input, and answers each with a line of JSON. With --base the robot is commanded along
its base's axes, and tells its motion by the tool's pose."""

import json
import select
import sys
import time

import numpy as np
from camera import Camera, read_scene, read_starts, rotation
from referee import Referee

TICK = 0.01
# As MoveIt Servo: who hears nothing for so long stands.
TIMEOUT = 0.1
FRAMES = {"camera": "camera_optical_frame", "tool": "tool0", "base": "base_link"}
JOINTS = ["shoulder", "elbow", "wrist"]
# Standard deviation of what is seen.
NOISE_PX = 0.01
# The camera on the tool, and the object in the base: of the test's configuration.
MOUNT = rotation(np.radians([5.0, -40.0, 90.0])), np.array([0.05, -0.02, 0.08])
OBJECT = rotation([2.0, -1.0, 0.5]), np.array([0.6, -0.2, 0.1])


def stamp(wall):
    return {"sec": int(wall // 1e9), "nanosec": int(wall % 1e9)}


class World:
    """Where the camera is, what it sees, and how it moves."""

    def __init__(self, scene, start):
        self.camera = Camera(scene, start)
        self.object = Camera({**scene, "pattern": {"points": [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]}}, start)

    def move(self, twist, duration):
        self.camera.move(twist, duration)
        self.object.move(twist, duration)

    def tool(self):
        """Rotation and origin of the tool in the base."""
        origin, *ends = self.object.points
        turn = np.array([end - origin for end in ends])  # object from camera
        at = -turn @ origin
        turn, at = OBJECT[0] @ turn, OBJECT[0] @ at + OBJECT[1]  # the camera in the base
        turn = turn @ MOUNT[0].T
        return turn, at - turn @ MOUNT[1]

    def camera_twist(self, linear, angular):
        """Of the tool's origin along base axes, as the camera's."""
        turn, _ = self.tool()
        v, w = turn.T @ linear, turn.T @ angular
        return [*(MOUNT[0].T @ (v + np.cross(w, MOUNT[1]))), *(MOUNT[0].T @ w)]


def quaternion(turn):
    values, vectors = np.linalg.eigh(
        np.array(
            [
                [turn[0, 0] - turn[1, 1] - turn[2, 2], 0, 0, 0],
                [turn[0, 1] + turn[1, 0], turn[1, 1] - turn[0, 0] - turn[2, 2], 0, 0],
                [turn[0, 2] + turn[2, 0], turn[1, 2] + turn[2, 1], turn[2, 2] - turn[0, 0] - turn[1, 1], 0],
                [turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1], np.trace(turn)],
            ]
        )
    )
    return [float(x) for x in vectors[:, -1]]


class Peer:
    def __init__(self, graph, scene, starts, directory, base):
        self.scene, self.starts, self.base = scene, starts, base
        goal = scene["goal"]
        self.referee = Referee(scene, Camera(scene, goal["translation"] + goal["rotation"]).pixels(), directory)
        self.world = World(scene, starts[0])
        self.graph = graph
        self.twist, self.heard = [0.0] * 6, 0.0
        # What is wrong on purpose.
        self.faults = {}
        self.run, self.wish, self.deepest = None, None, None
        self.noise = np.random.default_rng(1)
        self.counts = {"twists": 0, "zeros": 0, "late": 0, "wrong_frame": 0}
        self.ticks = 0
        self.last = time.monotonic()

    def fault(self, name, default=None):
        return self.faults.get(name, default)

    def step(self):
        for frame, twist, wall in self.graph.twists():
            self.counts["twists"] += 1
            self.counts["zeros"] += not any(twist)
            if time.time_ns() - wall > 1e9 * TIMEOUT:
                self.counts["late"] += 1
                continue
            if frame != FRAMES["base" if self.base else "camera"]:
                self.counts["wrong_frame"] += 1
                continue
            self.twist = self.world.camera_twist(np.array(twist[:3]), np.array(twist[3:])) if self.base else twist
            self.heard = time.monotonic()
        now = time.monotonic()
        if now - self.heard > TIMEOUT:
            self.twist = [0.0] * 6
        self.world.move(self.twist, now - self.last)
        if self.run is not None:
            self.run["held_s"] = max(self.run["held_s"], now - self.last)
        self.last = now
        wall = time.time_ns()
        if not self.fault("robot_silent"):
            self.tell_robot(wall)
        self.ticks += 1
        if self.ticks % 3 == 0 and not self.fault("camera_silent"):
            self.tell_camera(wall)
        if self.wish and self.ticks % 10 == 0:
            self.graph.wish(self.header(FRAMES["camera"], wall), self.wish)

    def header(self, frame, wall):
        return {"stamp": stamp(wall), "frame_id": frame}

    def tell_robot(self, wall):
        wall += self.fault("robot_stamp_ms", 0) * 10**6
        q, dq = [0.1, -0.2, 0.3], [0.0, 0.0, 0.0]
        names = self.fault("joint_names", ["finger", *JOINTS])
        self.graph.joints(self.header("", wall), names, [0.9, *q], [0.0, *dq])
        if self.base:
            turn, at = self.world.tool()
            self.graph.pose(self.header(FRAMES["base"], wall), at.tolist(), quaternion(turn))
        else:
            self.graph.executed(self.header(self.fault("robot_frame", FRAMES["camera"]), wall), self.twist)

    def tell_camera(self, wall):
        if not self.world.camera.sees():
            return
        pixels = self.world.camera.pixels()
        self.deepest = self.deepest or self.referee.violation(pixels)
        if self.run is not None:
            self.judge(pixels)
        wall += self.fault("camera_stamp_ms", 0) * 10**6
        c = {**self.scene["camera"], **self.fault("camera", {})}
        header = self.header(self.fault("camera_frame", FRAMES["camera"]), wall)
        self.graph.info(header, c, self.fault("distortion", [0.0] * 5))
        # A camera repeats no image to the last bit; one that does counts as frozen.
        seen = pixels + self.noise.normal(0.0, NOISE_PX, pixels.shape)
        tags = [(number, [float(u), float(v)]) for number, (u, v) in enumerate(seen)]
        tags = [tag for tag in tags if tag[0] != self.fault("hidden")]
        if self.fault("nan") is not None:
            tags[self.fault("nan")][1][0] = float("nan")
        if self.fault("twice") is not None:
            tags.append(tags[self.fault("twice")])
        if self.fault("foreign"):
            tags.append((99, [500.0, 500.0]))
        self.graph.features(header, tags)

    def judge(self, pixels):
        run, seconds = self.run, time.monotonic() - self.run["begin"]
        run["deep"] = run["deep"] or self.referee.violation(pixels)
        run["error_px"] = self.referee.error(pixels)
        told = self.graph.state() if seconds > 1.5 else ""
        if told.startswith("disarmed"):
            run["deep"] = told
        if self.referee.arrived(pixels) or seconds > self.scene["success"]["time_s"] or run["deep"]:
            arrived = self.referee.arrived(pixels) and not run["deep"]
            self.answer(
                {
                    "arrived": bool(arrived),
                    "seconds": seconds,
                    "reason": run["deep"],
                    "error_px": run["error_px"],
                    "held_s": run["held_s"],
                }
            )
            self.run = None

    def answer(self, value):
        print(json.dumps(value), flush=True)

    def obey(self, line):
        word, _, rest = line.strip().partition(" ")
        if word == "place":
            self.world = World(self.scene, self.starts[int(rest)])
            self.answer({})
        elif word == "wish":
            # Ten times a second, until the next one; `null` for silence.
            self.wish, self.deepest = json.loads(rest), None
            self.answer({})
        elif word == "run":
            # Answered when it has ended. `held_s`: for how long it moved by one command, at most.
            self.run = {"begin": time.monotonic(), "deep": None, "error_px": None, "held_s": 0.0}
        elif word == "fault":
            self.faults = json.loads(rest)
            self.answer({})
        elif word == "call":
            self.call(rest)
        elif word == "status":
            heard = time.monotonic() - self.heard
            speed = float(np.abs(self.twist).max())
            error = self.referee.error(self.world.camera.pixels())
            self.answer(
                {
                    **self.counts,
                    "silent_s": heard,
                    "speed": speed,
                    "error_px": error,
                    "violation": self.deepest,
                    **self.graph.told(),
                }
            )
        elif word == "flood":
            for _ in range(5):
                self.graph.send(rest)
            self.tick()
            self.answer({})
        elif word == "raw":
            self.graph.raw()
            self.answer({})
        elif word == "raw_stop":
            self.graph.raw_stop()
            self.answer({})
        else:
            raise SystemExit(f"peer: {line}")

    def call(self, name):
        """The world goes on meanwhile."""
        begin = time.monotonic()
        while not self.graph.ready(name) and time.monotonic() < begin + 10.0:
            self.tick()
        begin = time.monotonic()
        self.graph.send(name)
        reply = None
        # To build a memory takes some time.
        patience = 240.0 if name == "teach" else 5.0
        while reply is None and time.monotonic() < begin + patience:
            self.tick()
            reply = self.graph.reply(name)
        success, message = reply or (None, "no reply")
        self.answer({"success": success, "message": message, "seconds": time.monotonic() - begin})

    def tick(self):
        self.step()
        time.sleep(max(0.0, self.last + TICK - time.monotonic()))

    def work(self):
        while True:
            readable, _, _ = select.select([sys.stdin], [], [], 0)
            if readable:
                line = sys.stdin.readline()
                if not line:
                    return
                self.obey(line)
            self.tick()


def main():
    via, number, scene, starts, *flags = sys.argv[1:]
    if via == "dds":
        from dds import Graph
    else:
        from rcl import Graph
    graph = Graph(int(number), FRAMES)
    Peer(graph, read_scene(scene), read_starts(starts), scene.rpartition("/")[0], "--base" in flags).work()


if __name__ == "__main__":
    main()
