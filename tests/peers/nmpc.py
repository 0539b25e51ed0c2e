"""Nonlinear model predictive control by acados: `nmpc.py NP`, real-time iteration (SQP_RTI) with HPIPM.

States are the points in the camera, a twist in each of NP periods, the cost that of the table, clearances in each
period and halfway to the next as soft rows (L1); masks as discs that fill them. Tuned: the weight of the rows, out of
10, 100, 1000 on paper-sim and cup-disc-bars, 20@5.
"""

import ctypes
import os
import pathlib
import sys
import tempfile

import numpy

import adapter
from geometry import BEYOND, Peer

WEIGHT = float(sys.argv[2]) if len(sys.argv) > 2 else 10.0
# A disc fills a mask to this depth, px.
DEEP_PX = 3.0


def acados():
    """The package's libraries, which want to be told where they are; gives the module and CasADi."""
    place = next(pathlib.Path(path) for path in sys.path if (pathlib.Path(path) / "acados/install").is_dir()) / "acados"
    os.environ |= {
        "ACADOS_SOURCE_DIR": str(place / "install"),
        "ACADOS_PYTHON_INTERFACE_PATH": str(place / "acados_template"),
    }
    for library in ("blasfeo", "hpipm", "qpOASES_e", "acados"):
        ctypes.CDLL(str(place / f"install/lib/lib{library}.so"), ctypes.RTLD_GLOBAL)
    from acados import acados_template

    return acados_template


def discs(scene, field):
    """Centres and radii of discs that fill what a field has inside."""
    depth, found = -field.copy(), []
    v, u = numpy.mgrid[: field.shape[0], : field.shape[1]] - BEYOND
    while depth.max() > DEEP_PX:
        at = numpy.unravel_index(depth.argmax(), depth.shape)
        centre, radius = (u[at], v[at]), -field[at]
        found.append((centre, radius))
        depth[(u - centre[0]) ** 2 + (v - centre[1]) ** 2 < (radius + DEEP_PX) ** 2] = 0.0
    return found


class Nmpc(Peer):
    def __init__(self, table):
        super().__init__(table)
        self.np = int(sys.argv[1])
        with tempfile.TemporaryDirectory() as directory:
            self.solver = self.made(acados(), directory)

    def rows(self, casadi, pixels):
        """Positive where clear, px."""
        scene, rows = self.scene, []
        boxes = [(part["center"], part["half"], part["p"]) for part in scene.parts]
        for occlusion, field in zip(scene.table["occlusions"], scene.fields):
            if occlusion["rectangles"]:
                boxes += [(centre, (radius, radius), 2.0) for centre, radius in discs(scene, field)]
        for u, v in pixels:
            rows += [u, v, scene.size[0] - u, scene.size[1] - v]
            for (cu, cv), (hu, hv), p in boxes:
                a, b = ((u - cu) / hu) ** 2 + 1e-9, ((v - cv) / hv) ** 2 + 1e-9
                rows.append(min(hu, hv) * ((a ** (p / 2) + b ** (p / 2)) ** (1 / p) - 1.0))
        return casadi.vertcat(*rows)

    def made(self, template, directory):
        import casadi

        scene, n = self.scene, len(self.scene.pattern)
        x, v, share = casadi.SX.sym("x", 3 * n), casadi.SX.sym("v", 6), casadi.SX.sym("share")

        def rate(x):
            each = [-v[:3] - casadi.cross(v[3:], x[3 * k : 3 * k + 3]) for k in range(n)]
            return casadi.vertcat(*each)

        def seen(x):
            return [[scene.focal[c] * x[3 * k + c] / x[3 * k + 2] + scene.centre[c] for c in (0, 1)] for k in range(n)]

        def after(dt):
            return x + dt * rate(x + 0.5 * dt * rate(x))

        pixels = seen(x)
        errors = casadi.vertcat(*[two[c] - scene.goal[k, c] for k, two in enumerate(pixels) for c in (0, 1)])
        # It halves squares.
        errors = numpy.sqrt(2.0 * scene.k_q) * errors
        efforts = numpy.sqrt(2.0) * casadi.sqrt(casadi.DM(scene.effort) * share) * v
        ocp = template.AcadosOcp(acados_path=os.environ["ACADOS_SOURCE_DIR"])
        ocp.model, ocp.dims.N = template.AcadosModel(), self.np
        model, cost, constraints, options = ocp.model, ocp.cost, ocp.constraints, ocp.solver_options
        model.name, model.x, model.u, model.p = f"nmpc_{self.np}", x, v, share
        model.disc_dyn_expr = after(scene.period)
        for stage, residuals in {"_0": efforts, "": casadi.vertcat(errors, efforts), "_e": errors}.items():
            size = residuals.numel()
            setattr(model, "cost_y_expr" + stage, residuals)
            setattr(cost, "cost_type" + stage, "NONLINEAR_LS")
            setattr(cost, "W" + stage, numpy.eye(size))
            setattr(cost, "yref" + stage, numpy.zeros(size))
        # Also halfway to the next period: a point may pass a bar between two.
        at, halfway = self.rows(casadi, pixels), self.rows(casadi, seen(after(0.5 * scene.period)))
        for stage, rows in {"_0": halfway, "": casadi.vertcat(at, halfway), "_e": at}.items():
            count = rows.numel()
            setattr(model, "con_h_expr" + stage, rows)
            setattr(constraints, "lh" + stage, numpy.zeros(count))
            setattr(constraints, "uh" + stage, numpy.full(count, 1e6))
            setattr(constraints, "idxsh" + stage, numpy.arange(count))
            for side in "lu":
                setattr(cost, f"Z{side}{stage}", numpy.zeros(count))
                setattr(cost, f"z{side}{stage}", numpy.full(count, WEIGHT))
        constraints.idxbu, constraints.lbu, constraints.ubu = numpy.arange(6), -scene.limits, scene.limits
        constraints.x0, ocp.parameter_values = scene.goal_points.ravel(), numpy.ones(1)
        options.qp_solver, options.hpipm_mode = "PARTIAL_CONDENSING_HPIPM", "SPEED"
        options.hessian_approx, options.integrator_type, options.nlp_solver_type = "GAUSS_NEWTON", "DISCRETE", "SQP_RTI"
        options.tf, options.time_steps = float(self.np), numpy.ones(self.np)
        ocp.code_export_directory = directory + "/code"
        return template.AcadosOcpSolver(ocp, json_file=directory + "/ocp.json", verbose=False)

    def reset(self):
        super().reset()
        self.is_first = True

    def plan(self, points, pixels):
        solver, state = self.solver, points.ravel()
        for stage in range(self.np + 1):
            solver.set(stage, "p", self.scene.share(pixels))
            # A run begins at rest; afterwards the last plan, shifted by a period.
            later = min(stage + 1, self.np)
            solver.set(stage, "x", state if self.is_first or stage == 0 else solver.get(later, "x"))
            if stage < self.np:
                solver.set(stage, "u", numpy.zeros(6) if self.is_first else solver.get(min(later, self.np - 1), "u"))
        solver.set(0, "lbx", state)
        solver.set(0, "ubx", state)
        failed = solver.solve() not in (0, 2)
        twist = numpy.array(solver.get(0, "u"))
        self.is_first = failed or not numpy.isfinite(twist).all()
        return numpy.zeros(6) if self.is_first else twist

    def limited(self, twist):
        return numpy.clip(twist, -self.scene.limits, self.scene.limits)


if __name__ == "__main__":
    adapter.run(Nmpc)
