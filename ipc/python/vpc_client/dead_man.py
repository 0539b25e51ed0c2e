"""What a robot may do now."""

from __future__ import annotations

import math

from .messages import TwistCommand
from .ports import now_ns as present_ns

MOST_OBEYED_NS = 100_000_000
FUTURE_NS = 1_000_000
FOR_EVER = 2**64 - 1


def twist_in_force(newest: TwistCommand | None, now_ns: int | None = None) -> list[float]:
    """The dead man of every robot in real time: what the newest command lets it do at this instant (CLOCK_MONOTONIC, ns; None:
    now). Camera velocity in the camera frame, m/s and rad/s. Zero once the command is no longer valid, is older than 100 ms
    whatever it claims, is from the future or of lockstep, is not finite, or is None because none came yet. Call it in every
    cycle of the robot."""
    now = present_ns() if now_ns is None else now_ns
    still = [0.0] * 6
    if newest is None or newest.valid_until_ns == FOR_EVER:
        return still
    sent = newest.stamp.published_ns
    twist = list(newest.twist)
    in_force = sent - FUTURE_NS <= now < min(newest.valid_until_ns, sent + MOST_OBEYED_NS)
    return twist if in_force and all(math.isfinite(v) for v in twist) else still
