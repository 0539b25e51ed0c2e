"""A law of your own beside ours, from the same starts: run it from the root of the repository."""

import numpy as np
from numpy.typing import NDArray

import vpc

scene = vpc.Scene.built_in("paper-sim")
memory = vpc.Memory.load("memory-blob/default/paper-sim.vpcmem", scene)
goal, limits = scene.goal, scene.velocity_limits
FOCAL, GAIN = 800.0, 0.5  # px, per s
SIZE = np.linalg.norm(np.std(scene.pattern, axis=0))  # m


def proportional(points: NDArray[np.float64], time_s: float) -> NDArray[np.float64]:
    """Classic visual servoing: the error falls as exp(-GAIN t), occlusions do not count."""
    depth = FOCAL * SIZE / np.linalg.norm(np.std(points, axis=0))
    x, y = ((points - np.array(scene.size) / 2) / FOCAL).T
    zero, z = np.zeros_like(x), np.full_like(x, 1 / depth)
    rows_u = np.stack([-z, zero, x * z, x * y, -(1 + x * x), y], axis=1)
    rows_v = np.stack([zero, -z, y * z, 1 + y * y, -x * y, -x], axis=1)
    interaction = np.stack([rows_u, rows_v], axis=1).reshape(-1, 6)
    twist = -GAIN * np.linalg.pinv(interaction) @ ((points - goal) / FOCAL).ravel()
    return np.asarray(twist / max(1.0, np.max(np.abs(twist) / limits)))


starts = scene.starts(10, seed=7)
rows = vpc.run(scene, starts, [proportional, "ibvs", "foresight"], memory)
print("law            arrives   mean cost")
for name in dict.fromkeys(row["strategy"] for row in rows):
    runs = [row for row in rows if row["strategy"] == name]
    arrives = sum(row["success"] for row in runs)
    cost = sum(row["cost"] for row in runs) / len(runs)
    print(f"{name:14} {arrives:3} of {len(runs)} {cost:10.1f}")
