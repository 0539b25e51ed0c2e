"""Model predictive path integral control in NumPy: sampled twists over a second, weighted by exp(-cost / LAMBDA).

Usual settings: 512 samples of 30 steps about the last plan, shifted by a step; noise is held for five steps. The cost
is that of the table, and a penalty for each px inside something. Within NEAR times the threshold of arrival classic
visual servoing takes over. Tuned: LAMBDA out of 1, 10, 100, 1000, NOISE (of the limits) out of 0.1, 0.15, 0.2, 0.5 on
paper-sim, the first 5 of 20@5.
"""

import sys

import numpy

import adapter
from ibvs import Ibvs

SAMPLES, STEPS, HELD = 512, 30, 5
LAMBDA, NOISE = 10.0, 0.1
PENALTY, MARGIN_PX = 100.0, 3.0
NEAR = 10


def motions(twists, dt):
    """Rotations (.., 3, 3) and translations (.., 3) of points under twists (.., 6) of the camera, to second order."""
    v, w, cross = twists[..., :3], twists[..., 3:], numpy.zeros((*twists.shape[:-1], 3, 3))
    cross[..., 0, 1], cross[..., 0, 2], cross[..., 1, 2] = -w[..., 2], w[..., 1], -w[..., 0]
    cross -= cross.swapaxes(-1, -2)
    turns = numpy.eye(3) - dt * cross + 0.5 * dt * dt * cross @ cross
    return turns, -dt * v + 0.5 * dt * dt * (cross @ v[..., None])[..., 0]


class Mppi(Ibvs):
    def __init__(self, table):
        super().__init__(table)
        self.temperature, self.noise = [float(word) for word in sys.argv[1:]] or (LAMBDA, NOISE)
        self.nearest = numpy.minimum.reduce(self.scene.fields)

    def reset(self):
        super().reset()
        self.random = numpy.random.default_rng(1)
        self.mean = numpy.zeros((STEPS, 6))

    def plan(self, points, pixels):
        scene = self.scene
        if abs(pixels - scene.goal).max() < NEAR * scene.table["convergence_px"]:
            return super().plan(points, pixels)
        noise = self.noise * scene.limits * self.random.standard_normal((STEPS // HELD, SAMPLES, 6))
        noise[:, 0] = 0.0
        twists = self.mean[:, None] + numpy.repeat(noise, HELD, axis=0)
        twists = numpy.clip(twists, -scene.limits, scene.limits)
        costs = self.costs(points, twists, scene.share(pixels))
        weights = numpy.exp(-(costs - costs.min()) / self.temperature)
        plan = numpy.einsum("k,tkc->tc", weights / weights.sum(), twists)
        self.mean = numpy.vstack([plan[1:], plan[-1:]])
        return plan[0]

    def costs(self, points, twists, share):
        scene = self.scene
        turns, shifts = motions(twists, scene.period)
        now, ways = numpy.broadcast_to(points.T, (SAMPLES, *points.T.shape)), []
        for turn, shift in zip(turns, shifts):
            now = turn @ now + shift[..., None]
            ways.append(now)
        x, y, z = numpy.moveaxis(numpy.array(ways), 2, 0)
        # A point that comes behind the camera is far outside the image.
        is_ahead = z > 0.01
        z = numpy.where(is_ahead, z, 1.0)
        u, v = (
            numpy.where(is_ahead, centre + focal * along / z, -1e3)
            for along, focal, centre in zip((x, y), scene.focal, scene.centre)
        )
        costs = scene.k_q * ((u - scene.goal[:, 0]) ** 2 + (v - scene.goal[:, 1]) ** 2).sum(axis=(0, 2))
        costs += share * (scene.effort * twists**2).sum(axis=(0, 2))
        row, column = scene.at(v, 1), scene.at(u, 0)
        clear = numpy.minimum.reduce([u, v, scene.size[0] - u, scene.size[1] - v, self.nearest[row, column]])
        return costs + PENALTY * numpy.maximum(MARGIN_PX - clear, 0.0).sum(axis=(0, 2))


if __name__ == "__main__":
    adapter.run(Mppi)
