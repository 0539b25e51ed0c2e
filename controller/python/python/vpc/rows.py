"""Dicts that vpc returns; pandas.DataFrame takes a list of them."""

from __future__ import annotations

from typing import Literal, TypedDict


class Occlusion(TypedDict):
    """An occlusion of the image."""

    name: str
    #: Whether foresight may take points behind it for a short time.
    crossable: bool
    #: Center u, v and half axes, px, and the exponent p of each part.
    parts: list[tuple[float, float, float, float, float]]


class Row(TypedDict):
    """What happened in a run."""

    #: The strategy with its steps ahead ("foresight:3"), or the name of your law.
    strategy: str
    #: Index of the start.
    start: int
    #: Whether the goal was reached in time without a violation.
    success: bool
    #: Why not.
    reason: (
        Literal["violation", "not_converged", "lost_sight", "disarmed", "beyond_limits"] | None
    )
    #: Why the controller disarmed, if it did.
    cause: str | None
    #: Cycles until the run was decided.
    steps: int
    #: Mean over the cycles of the scene's time of l(v) / Np, against the goal (paper, Table I).
    cost: float
    #: That Np.
    np: int
    #: Mean change of the command from period to period after the arrival, as a share of the limit.
    change: float | None
    #: Time until the camera rested at the goal, s; always None for your law.
    standstill_s: float | None
    #: Error of the object's pose at the end of a run that arrived, mm.
    error_mm: float | None
    #: The same of its rotation, mrad.
    error_mrad: float | None
    #: Least clearance of a point from a border in a frame, px; negative inside.
    least_clearance_px: float
    #: The same between frames, px.
    least_between_px: float
    #: The same of a marker's edge, where markers have a size, px.
    least_edge_px: float | None
    #: Iterations of the solver; 0 for your law.
    iterations: int
    #: Cycles in which the solver did not converge; 0 for your law.
    not_converged: int
