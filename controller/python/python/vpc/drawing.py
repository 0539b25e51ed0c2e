"""A picture of the image plane; needs matplotlib."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from ._vpc import Scene

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def draw(axes: Axes, scene: Scene, ways: ArrayLike | None = None, title: str = "") -> None:
    """Draws what the camera sees, px: the occlusions, the goal, and the ways of the points, shape
    (steps, N, 2), from circles to the goal's crosses. Painted areas are not drawn.

    Raises ValueError for ways of another shape.
    """
    turn = np.linspace(0, 2 * np.pi, 200)
    for u, v, half_u, half_v, p in (part for one in scene.occlusions for part in one["parts"]):
        x, y = (np.sign(f) * np.abs(f) ** (2 / p) for f in (np.cos(turn), np.sin(turn)))
        axes.fill(u + half_u * x, v + half_v * y, color="0.8")
    if ways is not None:
        points = np.asarray(ways, dtype=float)
        if points.shape[1:] != scene.goal.shape:
            allowed = f"[any number, {len(scene.goal)}, 2]"
            raise ValueError(f"ways: shape {list(points.shape)}; allowed: {allowed}")
        for way in points.swapaxes(0, 1):
            (line,) = axes.plot(*way.T)
            axes.plot(*way[0], "o", color=line.get_color(), markersize=4)
    axes.plot(*scene.goal.T, "k+")
    width, height = scene.size
    axes.set(xlim=(0, width), ylim=(height, 0), aspect="equal", title=title)
