"""Crocoddyl's feasibility-driven differential dynamic programming with bounds (BoxFDDP) as a receding horizon.

The first plan of a run is solved until it converges; each cycle then shifts the plan by a period and improves it by one
iteration. Cold it begins with standing still; with `--memory FILE` with states and twists of the nearest trajectory
of our memory of motion. It prints how many iterations first plans took. 30 steps ahead; the cost is that of the table,
with a squared penalty for clearances below a margin. Within NEAR times the threshold classic visual servoing takes over.
Tuned: the penalty out of 1, 10, 100 and the margin out of 5, 10 px on paper-sim, the first 5 of 20@5.
"""

import json
import sys

import crocoddyl
import numpy

import adapter
from geometry import Tracker
from ibvs import Ibvs

STEPS, MOST = 30, 50
PENALTY, MARGIN_PX = 10.0, 10.0
LAST = 10.0  # weight of the last node
NEAR = 10


def skew(w):
    return numpy.array([[0.0, -w[2], w[1]], [w[2], 0.0, -w[0]], [-w[1], w[0], 0.0]])


class Period(crocoddyl.ActionModelAbstract):
    """A period: the state is the points in the camera, the control the twist."""

    def __init__(self, scene, is_last=False):
        n = len(scene.pattern)
        super().__init__(crocoddyl.StateVector(3 * n), 6, 1)
        self.scene, self.n, self.is_last = scene, n, is_last
        self.u_lb, self.u_ub = -scene.limits, scene.limits

    def look(self, x):
        """Pixels, their errors, what is too near, and how pixels change with the state."""
        scene = self.scene
        points = x.reshape(-1, 3)
        z = numpy.maximum(points[:, 2], 0.05)
        pixels = scene.centre + scene.focal * points[:, :2] / z[:, None]
        values, slopes = scene.barriers(pixels)
        return points, z, pixels, numpy.minimum(values - MARGIN_PX, 0.0), slopes

    def calc(self, data, x, u=None):
        scene, dt = self.scene, self.scene.period
        points, _, pixels, near, _ = self.look(x)
        cost = scene.k_q * ((pixels - scene.goal) ** 2).sum() + PENALTY * (near**2).sum()
        if u is None or self.is_last:
            data.cost, data.xnext = LAST * cost, x
            return
        rate = lambda points: -u[:3] - points @ skew(u[3:]).T
        data.cost = cost + scene.share(pixels) * (scene.effort * u**2).sum()
        data.xnext = (points + dt * rate(points + 0.5 * dt * rate(points))).ravel()

    def calcDiff(self, data, x, u=None):
        scene, dt, n = self.scene, self.scene.period, self.n
        points, z, pixels, near, slopes = self.look(x)
        # How the pixels of each point change with it.
        change = numpy.zeros((n, 2, 3))
        change[:, 0, 0], change[:, 1, 1] = scene.focal[0] / z, scene.focal[1] / z
        change[:, :, 2] = -scene.focal * points[:, :2] / z[:, None] ** 2
        rows = numpy.einsum("nbc,ncd->nbd", slopes, change) * (near < 0.0)[..., None]
        error = pixels - scene.goal
        weight = LAST if self.is_last or u is None else 1.0
        first = 2.0 * scene.k_q * numpy.einsum("nc,ncd->nd", error, change)
        first += 2.0 * PENALTY * numpy.einsum("nb,nbd->nd", near, rows)
        second = 2.0 * scene.k_q * change.transpose(0, 2, 1) @ change
        second += 2.0 * PENALTY * rows.transpose(0, 2, 1) @ rows
        data.Lx = weight * first.ravel()
        hessian = numpy.zeros((3 * n, 3 * n))
        for k in range(n):
            hessian[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] = weight * second[k]
        data.Lxx = hessian
        if self.is_last or u is None:
            data.Fx = numpy.eye(3 * n)
            return
        share = scene.share(pixels)
        data.Lu, data.Luu = 2.0 * share * scene.effort * u, numpy.diag(2.0 * share * scene.effort)
        data.Lxu = numpy.zeros((3 * n, 6))
        v, w = skew(u[:3]), skew(u[3:])
        data.Fx = numpy.kron(numpy.eye(n), numpy.eye(3) - dt * w + 0.5 * dt * dt * w @ w)
        by_v = -dt * numpy.eye(3) + 0.5 * dt * dt * w
        turn = lambda p: dt * skew(p) - 0.5 * dt * dt * (v + skew(w @ p) + w @ skew(p))
        data.Fu = numpy.vstack([numpy.hstack([by_v, turn(p)]) for p in points])


class Memory:
    """The trajectories of a memory file (memory-blob/FORMAT.md)."""

    def __init__(self, path):
        with open(path, "rb") as file:
            header = json.loads(file.read(int.from_bytes(file.read(8), "little")))
            data = file.read()
        of = {key: int(value) for key, value in header["__metadata__"].items() if key in ("inputs", "samples")}

        def tensor(name):
            begin, end = header[name]["data_offsets"]
            return numpy.frombuffer(data[begin:end]).reshape(header[name]["shape"])

        count, n = of["samples"], of["inputs"]
        self.x = tensor("samples.x").transpose(0, 2, 1).reshape(-1, n)[:count, : n - 2]
        self.offset, self.scale = tensor("scaling")[:, : n - 2]
        self.twists = tensor("samples.y")[:count, :6]
        self.trajectory, self.step = tensor("samples.origin")[:, :count]

    def way_from(self, scene, pixels):
        """States and twists of each period from the sample nearest in the image to its trajectory's end, then at
        rest."""
        wanted = (pixels.ravel() - self.offset) / self.scale
        nearest = ((self.x - wanted) ** 2).sum(axis=1).argmin()
        later = (self.trajectory == self.trajectory[nearest]) & (self.step >= self.step[nearest])
        order = numpy.flatnonzero(later)[self.step[later].argsort()]
        track = Tracker(scene)
        seen = (self.x[order] * self.scale + self.offset).reshape(len(order), -1, 2)
        states = numpy.array([track(pixels).ravel() for pixels in seen])
        steps = self.step[order] - self.step[nearest]
        between = lambda values, times: numpy.array([numpy.interp(times, steps, column) for column in values.T]).T
        xs, us = between(states, numpy.arange(STEPS + 1)), between(self.twists[order], numpy.arange(STEPS))
        us[numpy.arange(STEPS) > steps[-1]] = 0.0
        return list(xs), list(numpy.clip(us, -scene.limits, scene.limits))


class Fddp(Ibvs):
    iterations = []

    def __init__(self, table):
        super().__init__(table)
        self.memory = Memory(sys.argv[2]) if sys.argv[1:2] == ["--memory"] else None
        if sys.argv[1:2] == ['--p']: global PENALTY; PENALTY = float(sys.argv[2])
        self.model, self.last = Period(self.scene), Period(self.scene, is_last=True)

    def reset(self):
        super().reset()
        self.us = None

    def plan(self, points, pixels):
        scene, x = self.scene, points.ravel()
        if abs(pixels - scene.goal).max() < NEAR * scene.table["convergence_px"]:
            return super().plan(points, pixels)
        problem = crocoddyl.ShootingProblem(x, [self.model] * STEPS, self.last)
        solver = crocoddyl.SolverBoxFDDP(problem)
        solver.th_stop = 1e-3
        is_first, is_feasible = self.us is None, True
        if is_first and self.memory:
            xs, self.us = self.memory.way_from(scene, pixels)
            xs[0], is_feasible = x, False
        else:
            self.us = self.us or [numpy.zeros(6)] * STEPS
            xs = problem.rollout(self.us)
        solver.solve(xs, self.us, MOST if is_first else 1, is_feasible)
        if is_first:
            self.iterations.append(solver.iter + 1)
        us = [numpy.array(u) for u in solver.us]
        self.us = us[1:] + us[-1:]
        return us[0] if numpy.isfinite(us[0]).all() else numpy.zeros(6)


if __name__ == "__main__":
    adapter.run(Fddp)
    counts = Fddp.iterations
    print(" ".join(["fddp.py", *sys.argv[1:]]) + f": {numpy.mean(counts):.1f} iterations for a first plan")
