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
    """What happened in a run of the free camera."""

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


class PandaReport(TypedDict):
    """What the referee of the emulated arm counted."""

    #: Times that the robot stopped itself.
    reflexes: int
    #: Milliseconds in which a joint was out of its range, or a joint or the end effector too fast.
    limit_violations: int
    #: Milliseconds in which a joint or the end effector accelerated or jerked too much.
    discontinuities: int
    #: Names of the robot's errors, each once.
    errors: list[str]
    #: Largest share of a joint's limit of speed; 1 at the limit.
    joint_velocity: float
    #: The same of acceleration.
    joint_acceleration: float
    #: The same of jerk.
    joint_jerk: float
    #: Least distance of a joint from an end of its range, rad.
    joint_room: float
    #: Milliseconds in which the robot obeyed the controller.
    steered_ms: int
    #: Those in which the bridge slowed the camera down, for a joint or a singular posture.
    slowed_ms: int


class PandaRow(PandaReport):
    """What happened in a run of the emulated arm."""

    #: As in a Row.
    strategy: str
    #: Index of the start.
    start: int
    #: Whether the object was released at the goal and the robot backed away, with no violation.
    success: bool
    #: Why not.
    reason: (
        Literal["violation", "marker_lost", "time_out", "reflex", "disarmed", "beyond_limits"]
        | None
    )
    #: Why the controller held the camera in the last cycle.
    hold: str | None
    #: Time until the run was decided, s.
    time_s: float
    #: Time until the points arrived, s.
    arrived_s: float | None
    #: Mean over the cycles of l(v) / Np, against the goal; None for your law.
    cost: float | None
    #: Largest component of the true distance from the goal at the end, px.
    error_px: float
    #: Frames in which a marker was hidden.
    hidden_frames: int
    #: As in a Row.
    least_clearance_px: float
    #: As in a Row.
    least_between_px: float
    #: As in a Row.
    least_edge_px: float | None
