"""Classic visual servoing behind a control barrier function: the nearest twist that keeps every point in sight.

A quadratic program a period (ProxSuite): min |W (v - v_ibvs)|^2 + rho |slack|^2 where each clearance h of each point
has dh/dt >= -ALPHA h - slack, within the limits. Tuned: ALPHA out of 1, 2, 4, 8, 16 on paper-sim, 20@5.
"""

import sys

import numpy
from proxsuite import proxqp

import adapter
from ibvs import Ibvs

ALPHA, RHO = 4.0, 1e4


class Cbf(Ibvs):
    def __init__(self, table):
        super().__init__(table)
        self.alpha = float(sys.argv[1]) if len(sys.argv) > 1 else ALPHA
        n, scene = len(self.scene.pattern), self.scene
        self.count = n * (4 + len(scene.fields))
        weights = numpy.append(1.0 / scene.limits**2, numpy.full(self.count, RHO))
        self.hessian, self.weights = numpy.diag(weights), weights
        free = numpy.full(self.count, 1e10)
        self.most = numpy.append(scene.limits, free)
        self.least = numpy.append(-scene.limits, 0.0 * free)

    def plan(self, points, pixels):
        wanted = self.limited(super().plan(points, pixels))
        values, slopes = self.scene.barriers(pixels)
        motion = self.scene.interaction(points).reshape(-1, 2, 6) * self.scene.focal[:, None]
        rows = numpy.einsum("nbc,ncd->nbd", slopes, motion).reshape(-1, 6)
        rows = numpy.hstack([rows, numpy.eye(self.count)])
        least = -self.alpha * values.ravel()
        gradient = numpy.append(-self.weights[:6] * wanted, numpy.zeros(self.count))
        qp = proxqp.dense.QP(6 + self.count, 0, self.count, True)
        qp.settings.eps_abs = 1e-6
        far = numpy.full(self.count, 1e20)
        qp.init(self.hessian, gradient, None, None, rows, least, far, self.least, self.most)
        qp.solve()
        twist = numpy.array(qp.results.x[:6])
        return twist if numpy.isfinite(twist).all() else numpy.zeros(6)


if __name__ == "__main__":
    adapter.run(Cbf)
