"""The paper's strategies, and foresight, from one start: run it from the root of the repository.

With matplotlib, the ways of the image points are drawn into out/paper.png.
"""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import vpc

STRATEGIES = ["ibvs", "previous", "knn", "gpr", "foresight"]
scene = vpc.Scene.built_in("paper-sim")
memory = vpc.Memory.load("memory-blob/default/paper-sim.vpcmem", scene)
start = vpc.read_starts("ipc/scene/scenes/paper-sim-starts.csv")[97]


def way(strategy: str) -> tuple[NDArray[np.float64], str]:
    """The image points of a run, shape (steps, N, 2), and how it ended."""
    controller = vpc.Controller(scene, memory, strategy)
    camera = vpc.FreeCamera(scene, start)
    points = [camera.points]
    while camera.referee is None and camera.time_s < scene.time_s:
        step = controller.step(camera.points, camera.time_s)
        controller.think()
        camera.move(step.twist)
        points.append(camera.points)
    return np.array(points), camera.violation or camera.referee or "not in time"


def draw(ways: dict[str, NDArray[np.float64]], path: Path) -> None:
    """The ways over the occlusions."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(3 * len(ways), 3.2), layout="constrained")
    width, height = scene.size
    turn = np.linspace(0, 2 * np.pi, 200)
    for axes, (strategy, points) in zip(np.ravel(figure.subplots(1, len(ways))), ways.items()):
        for u, v, half_u, half_v, p in (it for one in scene.occlusions for it in one["parts"]):
            x, y = (np.sign(f) * np.abs(f) ** (2 / p) for f in (np.cos(turn), np.sin(turn)))
            axes.fill(u + half_u * x, v + half_v * y, color="0.8")
        axes.plot(points[:, :, 0], points[:, :, 1])
        axes.plot(*scene.goal.T, "k+")
        axes.set(title=strategy, xlim=(0, width), ylim=(height, 0), aspect="equal")
    path.parent.mkdir(exist_ok=True)
    figure.savefig(path)
    print("wrote", path)


ways = {}
for strategy in STRATEGIES:
    ways[strategy], end = way(strategy)
    print(f"{strategy:10} {len(ways[strategy]) - 1:4} steps: {end}")
try:
    draw(ways, Path("out/paper.png"))
except ImportError as error:
    print("no figure:", error)
