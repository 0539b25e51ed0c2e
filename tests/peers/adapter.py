"""Lets a method steer in `cargo table --external`: README.md describes the lines that pass. Needs Python 3.9 alone.

    class Mine:
        def __init__(self, scene):      # once; `scene` is the table of the first line
            self.goal = scene["goal"]["features"]

        def reset(self):                # optional, at the begin of each run
            pass

        def step(self, points):         # every period: [[u, v], ...] in px
            return [0.0] * 6            # vx, vy, vz in m/s, wx, wy, wz in rad/s, in the camera's frame

    adapter.run(Mine)
"""

import json
import os
import sys


class Limiter:
    """Scales a twist into the limits of velocity, then clips its change to those of acceleration."""

    def __init__(self, scene):
        self.limits = scene["limits"]
        # null: no limit
        changes = [most and most * scene["period"] for most in scene["acceleration"]]
        self.changes = [float("inf") if most is None else most for most in changes]

    def __call__(self, twist, before):
        most = max([1.0] + [abs(v) / limit for v, limit in zip(twist, self.limits)])
        within = zip(twist, before, self.changes)
        return [was + min(max(v / most - was, -change), change) for v, was, change in within]


def is_whole(points):
    """Whether a frame has arrived, with all points."""
    return points is not None and None not in points


def answers(method):
    """Takes each line of the table, gives the answer to it."""
    line = yield
    made = limiter = None
    twist = [0.0] * 6
    while True:
        if "scene" in line:
            limiter = Limiter(line["scene"])
            made = method(line["scene"])
            line = yield "ready"
        elif "run" in line:
            twist = [0.0] * 6
            getattr(made, "reset", lambda: None)()
            line = yield "ready"
        else:
            # Without a frame the last twist goes on; where a point is hidden the camera stops.
            if is_whole(line["points"]):
                twist = limiter([float(v) for v in made.step(line["points"])], twist)
            elif line["points"] is not None:
                twist = limiter([0.0] * 6, twist)
            line = yield twist


def run(method):
    """Steers until the table ends. `method` takes the scene, and gives an object with a method `step`."""
    # What a method or its library prints is no answer: it goes to standard error.
    out = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    talk = answers(method)
    next(talk)
    for line in sys.stdin:
        out.write(json.dumps(talk.send(json.loads(line))) + "\n")
        out.flush()
