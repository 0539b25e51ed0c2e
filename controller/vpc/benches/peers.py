#!/usr/bin/env python3
"""Our solver beside others, in one run: quadratic programs, whole problems, and what foresight adds.

    python3 -m venv venv && venv/bin/pip install -r requirements.txt
    venv/bin/pip install --no-deps --target venv/acados comma-deps-acados==0.2.2.post92
    venv/bin/python peers.py

The problems are the 240 of ../fixtures/subproblems.json, each solved without a warm start; no solver keeps anything
from one solution to the next. The bench program solves them with the Rust crates and writes our quadratic programs;
the rest is solved here, one after the other. Times of Rust crates and of SciPy are those of the call; the others are
what the solver itself reports, without Python. The time of a quadratic program includes its setup; its data are copied
just before, because an iteration has just written them. For whole problems our workspace and the solvers of CasADi and
acados are made beforehand. An answer is judged by the mathematics of subproblems.py. acados is left out where its
directory is missing; its package brings a CasADi of its own.
"""

import contextlib
import ctypes
import json
import os
import pathlib
import subprocess
import sys
import tempfile
import time

# ruff: noqa: E402
os.environ["OPENBLAS_NUM_THREADS"] = "1"  # read on import; SciPy takes longer with more

import casadi
import clarabel
import daqp
import numpy
import piqp
import scipy.sparse

HERE = pathlib.Path(__file__).resolve().parent
ROOT = HERE.parents[2]
sys.path.append(str(HERE.parent / "fixtures"))
import subproblems

REPEATS = 5  # passes over all problems; the least time of each counts, because other work may disturb some
WINDOWS = (3, 10, 30)
REST = numpy.zeros(6)
RUST = ("ours", "slsqp (Rust)", "optimization_engine")  # in the order of the bench program
ACADOS = pathlib.Path(sys.prefix) / "acados"
# Solvers and compilers write to standard output, some of them from C; the tables go to a copy of it.
OUT = os.fdopen(os.dup(1), "w")


# Quadratic programs: minimise 1/2 d'Hd + g'd, rows d + clearances >= 0, lower <= d <= upper. Each function returns d
# and seconds.


def by_daqp(p):
    most = numpy.concatenate([p["upper"], numpy.full(len(p["rows"]), 1e30)])
    least = numpy.concatenate([p["lower"], -p["clearances"]])
    d, _, _, info = daqp.solve(p["hessian"], p["gradient"], p["rows"], most, least)
    return d, info["setup_time"] + info["solve_time"]


def by_qpoases(p):
    size = {"h": casadi.Sparsity.dense(6, 6), "a": casadi.Sparsity.dense(*p["rows"].shape)}
    options = {"hessian_type": "posdef", "printLevel": "none", "record_time": True, "error_on_fail": False}
    # A new object for each program: it would start warm from the one before.
    solver = casadi.conic("qp", "qpoases", size, options)
    data = {"h": p["hessian"], "g": p["gradient"], "a": p["rows"], "lba": -p["clearances"]}
    found = solver(**data, lbx=p["lower"], ubx=p["upper"])
    return numpy.array(found["x"]).ravel(), solver.stats()["t_wall_solver"]


def by_piqp(p):
    solver = piqp.DenseSolver()
    solver.settings.compute_timings = True
    solver.setup(p["hessian"], p["gradient"], G=p["rows"], h_l=-p["clearances"], x_l=p["lower"], x_u=p["upper"])
    solver.solve()
    return solver.result.x, solver.result.info.setup_time + solver.result.info.solve_time


def by_clarabel(p):
    rows = scipy.sparse.csc_matrix(numpy.vstack([-p["rows"], numpy.eye(6), -numpy.eye(6)]))
    room = numpy.concatenate([p["clearances"], p["upper"], -p["lower"]])
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    hessian = scipy.sparse.csc_matrix(numpy.triu(p["hessian"]))
    cones = [clarabel.NonnegativeConeT(len(room))]
    found = clarabel.DefaultSolver(hessian, p["gradient"], rows, room, cones, settings).solve()
    return numpy.array(found.x), found.solve_time


def compare_programs(programs, windows):
    columns = {"ours": ([p["step"] for p in programs], [p["us"] for p in programs])}
    for name, solve in {"DAQP": by_daqp, "qpOASES": by_qpoases, "PIQP": by_piqp, "Clarabel": by_clarabel}.items():
        columns[name] = measured(lambda p: solve({key: numpy.copy(value) for key, value in p.items()}), programs)
    merits = {name: numpy.array([*map(merit, programs, steps)]) for name, (steps, _) in columns.items()}
    least = numpy.min([*merits.values()], axis=0)
    counts = [len(p["rows"]) for p in programs]
    header(f"{len(programs)} quadratic programs, {min(counts)} to {max(counts)} rows", "least cost to 1e-6")
    for name, (_, times) in columns.items():
        show(name, windows, times, columns["ours"][1], merits[name] <= least + 1e-6 * abs(least))


def merit(p, d):
    """The cost and rho times all violations, which is what a program minimises, at d put into its bounds."""
    d = numpy.clip(d, p["lower"], p["upper"])
    violation = numpy.maximum(-(p["rows"] @ d + p["clearances"]), 0.0).sum()
    merit = p["value"] + d @ (0.5 * p["hessian"] @ d + p["gradient"]) + p["rho"] * violation
    return merit if numpy.isfinite(merit) else numpy.inf


# Whole problems. Each function returns the velocity and seconds.


def unit(problem):
    """The cost at rest, by which all costs are divided."""
    return max(problem.cost(REST)[0], 1.0)


def by_scipy(problem):
    begin = time.perf_counter()
    v = problem.solve(REST, constrained=True, ftol=1e-6)
    return v, time.perf_counter() - begin


class Model:
    """The symbols of a scene for CasADi: x and y are columns of normalised coordinates."""

    def __init__(self, scene):
        self.scene, self.n = scene, len(scene.pattern)
        self.target, self.unit = casadi.SX.sym("target", self.n, 2), casadi.SX.sym("unit")

    def step(self, x, y, v):
        z, ts = casadi.DM(1.0 / self.scene.goal_depth), self.scene.ts
        dx = -v[0] * z + v[2] * x * z + v[3] * x * y - v[4] * (1 + x * x) + v[5] * y
        dy = -v[1] * z + v[2] * y * z + v[3] * (1 + y * y) - v[4] * x * y - v[5] * x
        return x + ts * dx, y + ts * dy

    def pixels(self, x, y):
        return casadi.horzcat(*(self.scene.centre[c] + self.scene.focal[c] * p for c, p in enumerate((x, y))))

    def errors(self, pixels):
        """Their squares sum up to the image's share of the cost."""
        return casadi.sqrt(self.scene.k_q / self.unit) * casadi.vec(pixels - self.target)

    def efforts(self, v, commands):
        return casadi.sqrt(casadi.DM(self.scene.r) * commands / self.unit) * v

    def clearances(self, pixels):
        rows = [pixels[:, 0], pixels[:, 1], self.scene.size[0] - pixels[:, 0], self.scene.size[1] - pixels[:, 1]]
        for centre, half, p in zip(self.scene.part_centre, self.scene.part_half, self.scene.part_p):
            size = [casadi.fabs(pixels[:, c] - centre[c]) / half[c] for c in (0, 1)]
            rows.append(min(half) * ((size[0] ** p + size[1] ** p) ** (1.0 / p) - 1.0))
        return casadi.vertcat(*rows)


def casadi_solver(scene, np):
    """sqpmethod with the Gauss-Newton Hessian and DAQP. Tighter tolerances find no better answers here. Functions run
    in CasADi's virtual machine: as C they are a fifth faster for Np 3 and 10, and those of Np 30 take minutes to
    compile."""
    model, v, features = Model(scene), casadi.SX.sym("v", 6), casadi.SX.sym("features", len(scene.pattern), 2)
    x, y = ((features[:, c] - scene.centre[c]) / scene.focal[c] for c in (0, 1))
    errors, rows = [model.efforts(v, np - 1)], []
    for _ in range(np):
        x, y = model.step(x, y, v)
        errors.append(model.errors(model.pixels(x, y)))
        rows.append(model.clearances(model.pixels(x, y)))
    errors, rows = casadi.vertcat(*errors), casadi.vertcat(*rows)
    slope = casadi.jacobian(errors, v)
    p = casadi.vertcat(casadi.vec(features), casadi.vec(model.target), model.unit)
    lam_f, lam_g = casadi.SX.sym("lam_f"), casadi.SX.sym("lam_g", rows.numel())
    hessian = casadi.Function(
        "hessian", [v, p, lam_f, lam_g], [2 * lam_f * slope.T @ slope], ["x", "p", "lam_f", "lam_g"], ["hess_gamma_x_x"]
    )
    quiet = {"print_time": False, "print_header": False, "print_iteration": False, "print_status": False}
    options = {"qpsol": "daqp", "hess_lag": hessian, "max_iter": 50, "tol_pr": 1e-3, "tol_du": 1e-3}
    options |= {"record_time": True, "error_on_fail": False, "show_eval_warnings": False}
    options["qpsol_options"] = {"error_on_fail": False, "print_problem": False}
    program = {"x": v, "p": p, "f": casadi.sumsqr(errors), "g": rows}
    solver = casadi.nlpsol("sqp", "sqpmethod", program, options | quiet)
    cost = casadi.Function("f", [v, p], [program["f"]])

    def solve(problem):
        p = numpy.concatenate([problem.features.T.ravel(), problem.target.T.ravel(), [unit(problem)]])
        at = 0.1 * scene.limits
        assert abs(float(cost(at, p)) * unit(problem) / problem.cost(at)[0] - 1.0) < 1e-9, "another problem"
        found = solver(x0=REST, p=p, lbx=-scene.limits, ubx=scene.limits, lbg=0.0, ubg=numpy.inf)
        return numpy.array(found["x"]).ravel(), solver.stats()["t_wall_total"]

    return solve


def acados_solver(scene, np, directory):
    """SQP with the Gauss-Newton Hessian, full steps, generated C, and HPIPM on a stage for each step, which is faster
    here than condensing. The command u of stage 0 becomes the state w; those of later stages count for nothing. The
    tolerance is the loosest power of ten that finds all the answers of 1e-6."""
    from acados.acados_template import AcadosModel, AcadosOcp, AcadosOcpSolver

    model, n = Model(scene), len(scene.pattern)
    x, y, w, u, first = (casadi.SX.sym(name, size) for name, size in zip("xywuf", (n, n, 6, 6, 1)))
    v, pixels = first * u + (1 - first) * w, model.pixels(x, y)
    ocp = AcadosOcp(acados_path=os.environ["ACADOS_SOURCE_DIR"])
    ocp.model, ocp.dims.N = AcadosModel(), np
    symbols, cost, constraints, options = ocp.model, ocp.cost, ocp.constraints, ocp.solver_options
    symbols.name, symbols.x, symbols.u = f"{scene.name.replace('-', '_')}_{np}", casadi.vertcat(x, y, w), u
    symbols.p = casadi.vertcat(casadi.vec(model.target), model.unit, first)
    symbols.disc_dyn_expr = casadi.vertcat(*model.step(x, y, v), v)
    # It halves squares.
    errors = numpy.sqrt(2.0) * model.errors(pixels)
    efforts = numpy.sqrt(2.0) * model.efforts(first * u, np - 1) + 0.1 * (1 - first) * u
    stages = {"_0": efforts, "": casadi.vertcat(errors, efforts), "_e": errors}
    for stage, residuals in stages.items():
        size = residuals.numel()
        setattr(symbols, "cost_y_expr" + stage, residuals)
        setattr(cost, "cost_type" + stage, "NONLINEAR_LS")
        setattr(cost, "W" + stage, numpy.eye(size))
        setattr(cost, "yref" + stage, numpy.zeros(size))
    symbols.con_h_expr = symbols.con_h_expr_e = model.clearances(pixels)
    rows = symbols.con_h_expr.numel()
    constraints.lh = constraints.lh_e = numpy.zeros(rows)
    constraints.uh = constraints.uh_e = numpy.full(rows, 1e4)
    constraints.idxbu, constraints.lbu, constraints.ubu = numpy.arange(6), -scene.limits, scene.limits
    constraints.x0, ocp.parameter_values = numpy.zeros(2 * n + 6), numpy.ones(2 * n + 2)
    options.qp_solver, options.qp_solver_cond_N, options.hpipm_mode = "PARTIAL_CONDENSING_HPIPM", np, "SPEED"
    options.hessian_approx, options.integrator_type, options.nlp_solver_type = "GAUSS_NEWTON", "DISCRETE", "SQP"
    options.tf, options.time_steps, options.tol, options.nlp_solver_max_iter = float(np), numpy.ones(np), 1e-4, 50
    ocp.code_export_directory = f"{directory}/{symbols.name}"
    solver = AcadosOcpSolver(ocp, json_file=f"{directory}/{symbols.name}.json")

    def solve(problem):
        start = numpy.concatenate([((problem.features - scene.centre) / scene.focal).T.ravel(), REST])
        solver.reset()
        for stage in range(np + 1):
            solver.set(stage, "p", numpy.array([*problem.target.T.ravel(), unit(problem), stage == 0]))
            solver.set(stage, "x", start)
        solver.set(0, "lbx", start)
        solver.set(0, "ubx", start)
        solver.solve()
        return solver.get(0, "u"), float(numpy.ravel(solver.get_stats("time_tot"))[0])

    return solve


def find_acados():
    """Whether acados can be imported; it wants to be told where it is."""
    if not ACADOS.is_dir():
        return False
    place = ACADOS / "acados"
    os.environ |= {
        "ACADOS_SOURCE_DIR": str(place / "install"),
        "ACADOS_PYTHON_INTERFACE_PATH": str(place / "acados_template"),
    }
    for library in ("blasfeo", "hpipm", "qpOASES_e", "acados"):
        ctypes.CDLL(str(place / f"install/lib/lib{library}.so"), ctypes.RTLD_GLOBAL)
    sys.path.append(str(ACADOS))  # behind the CasADi of the venv
    return True


def compare_problems(problems, rust, directory):
    made = {"SciPy SLSQP": lambda scene, np: by_scipy, "CasADi sqpmethod, DAQP": casadi_solver}
    if find_acados():
        made["acados SQP, HPIPM"] = lambda scene, np: acados_solver(scene, np, directory)
    columns = {name: ([a["v"] for a in column], [a["us"] for a in column]) for name, column in zip(RUST, zip(*rust))}
    for name, make in made.items():
        keys = {(p["scene"], p["np"]) for p in problems}
        solvers = {(scene, np): make(subproblems.SCENES[scene], np) for scene, np in keys}
        columns[name] = measured(lambda p: solvers[p["scene"], p["np"]](posed(p)), problems)
    header(f"{len(problems)} problems without a warm start", "within 1 % of SciPy's best of six", "violated > 0.1 px")
    for name, (answers, times) in columns.items():
        good, violated = zip(*map(judge, problems, answers))
        show(name, [p["np"] for p in problems], times, columns["ours"][1], good, violated)


def judge(p, v):
    """Whether an answer is as good as SciPy's best, and whether it violates a constraint."""
    problem = posed(p)
    v = numpy.clip(v, -problem.scene.limits, problem.scene.limits)
    with numpy.errstate(over="ignore", invalid="ignore"):
        violated = not problem.violation(v) <= 0.1
        return not violated and problem.cost(v)[0] <= 1.01 * p["cost"], violated


def posed(p):
    """A problem of its own each time: it remembers what it previewed last."""
    features, target = numpy.array(p["features"]), numpy.array(p["target"])
    return subproblems.Problem(subproblems.SCENES[p["scene"]], p["np"], features, target)


def measured(solve, problems):
    """The answers, and the least time of each, us."""
    passes = [[solve(p) for p in problems] for _ in range(REPEATS)]
    seconds = [[s for _, s in found] for found in passes]
    return [answer for answer, _ in passes[0]], 1e6 * numpy.min(seconds, axis=0)


def header(what, *shares):
    windows = [f"Np {np}: p50, p99 us (x ours)" for np in WINDOWS]
    shares = [f"{share}: counts; all, 95 % interval" for share in shares]
    say("\n|", " | ".join([what, *windows, *shares]), "|\n|---" + "|--:" * (len(windows) + len(shares)) + "|")


def show(name, windows, times, ours, *shares):
    """Times by window, the median of their ratios to ours, and how often each of `shares` is true."""
    cells, of = [name], [numpy.equal(windows, np) for np in WINDOWS]
    for own, our in ((numpy.array(times)[chosen], numpy.array(ours)[chosen]) for chosen in of):
        p50, p99 = (f"{us:.{us < 100:d}f}" for us in numpy.quantile(own, [0.5, 0.99], method="inverted_cdf"))
        cells.append(f"{p50}, {p99} ({numpy.median(own / our):.3g}x)")
    for share in map(numpy.array, shares):
        low, high = wilson(share.sum(), len(share))
        counts = ", ".join(str(share[chosen].sum()) for chosen in of)
        cells.append(f"{counts} of {of[0].sum()}; {100 * share.mean():.1f} % ({100 * low:.1f} to {100 * high:.1f})")
    say("|", " | ".join(cells), "|")


def wilson(count, n, z=1.96):
    """The 95 % interval of a share."""
    middle, half = count + z * z / 2, z * numpy.sqrt(count * (n - count) / n + z * z / 4)
    return (middle - half) / (n + z * z), (middle + half) / (n + z * z)


def say(*words):
    print(*words, file=OUT, flush=True)


def run(*command):
    say("\n$", *command)
    subprocess.run(command, cwd=ROOT, check=True, stdout=OUT)


def main():
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    problems = json.loads((HERE.parent / "fixtures/subproblems.json").read_text())["problems"]
    with tempfile.TemporaryDirectory() as directory, contextlib.chdir(directory):
        run("cargo", "bench", "-q", "-p", "vpc-bench", "--bench", "step", "--", "--write", f"{directory}/found.json")
        found = json.loads(pathlib.Path("found.json").read_text())
        programs = [{key: numpy.array(value) for key, value in p.items()} for p in found["programs"]]
        compare_programs(programs, [p["np"] for p in problems for _ in range(2)])
        compare_problems(problems, found["answers"], directory)
    scene, memory = "ipc/scene/scenes/paper-sim", "memory-blob/default/paper-sim.vpcmem"
    starts = ("--scene", f"{scene}.toml", "--starts", f"{scene}-starts.csv", "--memory", memory)
    run("cargo", "table", *starts, "--strategies", "previous:3,foresight:3")
    run("cargo", "run", "-q", "--release", "--example", "step_times")


if __name__ == "__main__":
    main()
