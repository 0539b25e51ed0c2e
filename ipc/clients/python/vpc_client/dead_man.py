"""What a robot may do now."""

from __future__ import annotations

import math

from .messages import TwistCommand
from .ports import now_ns as present_ns

MOST_OBEYED_NS = 100_000_000
FUTURE_NS = 1_000_000
FOR_EVER = 2**64 - 1


def in_force_until_ns(newest: TwistCommand | None) -> int:
    """Until when a robot in real time obeys a command, CLOCK_MONOTONIC, ns: while it is valid, but no longer than 100 ms after it
    was published. 0 for a command of lockstep, and for None."""
    if newest is None or newest.valid_until_ns == FOR_EVER:
        return 0
    return min(newest.valid_until_ns, newest.stamp.published_ns + MOST_OBEYED_NS)


def twist_in_force(newest: TwistCommand | None, now_ns: int | None = None) -> list[float]:
    """The dead man of every robot in real time: what the newest command lets it do at this instant (CLOCK_MONOTONIC, ns; None:
    now). Camera velocity in the camera frame, m/s and rad/s. Zero once the command is no longer valid, is older than 100 ms
    whatever it claims, is from the future or of lockstep, is not finite, or is None because none came yet. Call it in every
    cycle of the robot."""
    now = present_ns() if now_ns is None else now_ns
    still = [0.0] * 6
    if newest is None or now >= in_force_until_ns(newest) or now < newest.stamp.published_ns - FUTURE_NS:
        return still
    twist = list(newest.twist)
    return twist if all(math.isfinite(v) for v in twist) else still
