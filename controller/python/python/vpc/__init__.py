"""Visual predictive control with a memory of motion: the crates of vpcd, without a daemon.

Image points are in px (u right, v down, origin at the center of the upper left pixel), shape (N, 2)
in the order of the scene's pattern. Twists are camera velocities in the camera frame, linear m/s,
then angular rad/s, shape (6,). Poses are of the object in the camera frame: tx, ty, tz (m), rx, ry,
rz (rotation vector, rad), shape (6,). Arrays are float64; what NumPy converts to that is taken.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from typing import Any

from . import _vpc
from ._vpc import (
    Controller,
    Foreseen,
    FreeCamera,
    Memory,
    Panda,
    Recall,
    Scene,
    Step,
    __version__,
    read_starts,
    run,
)
from .drawing import draw
from .rows import Occlusion, PandaReport, PandaRow, Row

__all__ = [
    "Controller",
    "Foreseen",
    "FreeCamera",
    "Memory",
    "Occlusion",
    "Panda",
    "PandaReport",
    "PandaRow",
    "Recall",
    "Row",
    "Scene",
    "Step",
    "__version__",
    "draw",
    "read_starts",
    "records",
    "run",
]


def records(path: str | os.PathLike[str], kind: str = "cycles") -> Iterator[dict[str, Any]]:
    """The messages of one kind in a recording (MCAP) as dicts, in their order; keys and units are
    those of the contract. kind: "cycles", "desired", "features", "replies", "requests", "robot" or
    "twist".

    Raises OSError if the file cannot be read, and ValueError if it is no recording.
    """
    return map(json.loads, _vpc.records(path, kind))
