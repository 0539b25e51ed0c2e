"""Hostile twists, the same ones, for a camera that obeys them, one behind a control barrier function, and one that vpc
guards with its strategy `follow`. Needs `pip install ./controller/python` and requirements.txt; takes a scene file.

The barrier: a quadratic program a period (ProxSuite), min (v - v_d)' R (v - v_d) + RHO |slack|^2 where each clearance h
of each point has dh/dt >= -ALPHA h - slack, within the limits. Tuned: ALPHA out of 1, 2, 4, 8, 16, the largest that
loses no point with --seed 5. Distances are those of geometry.py, on a grid of pixels.
"""

import argparse
import time
import tomllib

import numpy
from proxsuite import proxqp

import geometry
import vpc

ALPHA, RHO = 2.0, 1e6
# Instants of a period at which the camera is judged.
INSTANTS = 12
# A wish is harmless if it keeps all points so far from every border until the next frame, px.
HARMLESS_PX = 18.0


def scene_of(path):
    """A scene as arrays."""
    with open(path, "rb") as file:
        table = tomllib.load(file)
    ours = vpc.Scene.load(path)
    cost = table["cost"] | {"np": 3}
    goal = table["goal"] | {"features": ours.goal}
    occlusions = [{"rectangles": []} | one for one in table.get("occlusion", [])]
    named = {"period": 1 / ours.rate_hz, "pattern": ours.pattern, "limits": ours.velocity_limits}
    table = table | named | {"cost": cost, "goal": goal, "occlusions": occlusions}
    return ours, geometry.Scene(table)


class Obeying:
    """No guard: the twist within the limits."""

    def __init__(self, ours, scene):
        self.limits = scene.limits

    def __call__(self, pixels, wanted, seconds):
        return numpy.clip(wanted, -self.limits, self.limits)


class Barrier(geometry.Peer):
    """The nearest twist for which no clearance falls faster than ALPHA times itself."""

    def __init__(self, ours, scene):
        self.scene, self.track = scene, geometry.Tracker(scene)
        self.count = len(scene.pattern) * (4 + len(scene.fields))
        self.weights = numpy.append(scene.r, numpy.full(self.count, RHO))
        free = numpy.full(self.count, 1e10)
        self.most, self.least = numpy.append(scene.limits, free), numpy.append(-scene.limits, 0.0 * free)

    def __call__(self, pixels, wanted, seconds):
        points = self.track(pixels)
        values, slopes = self.scene.barriers(pixels)
        motion = self.scene.interaction(points).reshape(-1, 2, 6) * self.scene.focal[:, None]
        rows = numpy.einsum("nbc,ncd->nbd", slopes, motion).reshape(-1, 6)
        rows = numpy.hstack([rows, numpy.eye(self.count)])
        gradient = numpy.append(-self.weights[:6] * wanted, numpy.zeros(self.count))
        qp = proxqp.dense.QP(6 + self.count, 0, self.count, True)
        qp.settings.eps_abs = 1e-9
        far = numpy.full(self.count, 1e20)
        least = -ALPHA * values.ravel()
        qp.init(numpy.diag(self.weights), gradient, None, None, rows, least, far, self.least, self.most)
        qp.solve()
        twist = numpy.array(qp.results.x[:6])
        twist = twist if numpy.isfinite(twist).all() else numpy.zeros(6)
        self.track.predict(twist)
        return twist


class Ours:
    """The law, with the strategy `follow`."""

    def __init__(self, ours, scene):
        self.controller = vpc.Controller(ours, strategy="follow")

    def __call__(self, pixels, wanted, seconds):
        return self.controller.step(pixels, seconds, wanted=wanted).twist


def wishes(random, limits, count):
    """What a policy wants that goes wrong: it goes on, jumps, and asks for too much."""
    wanted = limits.copy()
    for _ in range(count):
        what = random.integers(10)
        if what == 0:
            wanted = 3 * limits * random.uniform(-1, 1, 6)
        elif what < 3:
            wanted = 0.2 * limits * random.uniform(-1, 1, 6)
        yield wanted


class Run:
    """A camera under a guard from a start: its depth, and what the guard did."""

    def __init__(self, guard, ours, scene, start, seed, cycles):
        self.deepest, self.spoiled, self.harmless, self.times, self.changes = 0.0, 0, 0, [], []
        guard = guard(ours, scene)
        points = scene.pattern @ geometry.rotation(start[3:]).T + start[:3]
        random = numpy.random.default_rng(seed)
        for k, wanted in enumerate(wishes(random, scene.limits, cycles)):
            pixels = scene.pixels(points)
            begin = time.perf_counter()
            twist = guard(pixels, wanted, k * scene.period)
            self.times.append(1e6 * (time.perf_counter() - begin))
            within = numpy.clip(wanted, -scene.limits, scene.limits)
            is_harmless = (within == wanted).all() and clearance(scene, points, wanted)[0] >= HARMLESS_PX
            self.harmless += is_harmless
            is_changed = (abs(twist - wanted) > 1e-3 * scene.limits).any()
            self.spoiled += bool(is_harmless and is_changed)
            self.changes.append(abs((twist - within) / scene.limits).max())
            least, points = clearance(scene, points, twist)
            self.deepest = max(self.deepest, -least)
            if points[:, 2].min() < 0.05:
                return


def clearance(scene, points, twist):
    """The least clearance of a point until the next frame, px, and the points then."""
    least = numpy.inf
    for _ in range(INSTANTS):
        points = geometry.moved(points, numpy.asarray(twist), scene.period / INSTANTS)
        least = min(least, scene.barriers(scene.pixels(points))[0].min())
    return least, points


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", nargs="?", default="ipc/scene/scenes/paper-sim.toml")
    parser.add_argument("--starts", type=int, default=20, help="so many [default: 20]")
    parser.add_argument("--cycles", type=int, default=300, help="wishes from each [default: 300]")
    parser.add_argument("--seed", type=int, default=36, help="of starts and wishes [default: 36]")
    options = parser.parse_args()
    ours, scene = scene_of(options.scene)
    print("           deepest, px    harmless changed   mean change   time, us: p50   p99")
    for name, guard in [("obeys", Obeying), ("CBF-QP", Barrier), ("follow", Ours)]:
        starts = enumerate(ours.starts(options.starts, options.seed))
        runs = [Run(guard, ours, scene, start, options.seed + k, options.cycles) for k, start in starts]
        times = numpy.concatenate([run.times for run in runs])
        spoiled, harmless = sum(run.spoiled for run in runs), sum(run.harmless for run in runs)
        change = 100 * numpy.mean(numpy.concatenate([run.changes for run in runs]))
        p50, p99 = numpy.percentile(times, [50, 99])
        deepest = max(run.deepest for run in runs)
        print(f"{name:10} {deepest:11.2f} {spoiled:9} of {harmless:5} {change:11.1f} % {p50:15.0f} {p99:5.0f}")


if __name__ == "__main__":
    main()
