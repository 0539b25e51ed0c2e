"""Judges a run by the scene's own words, as hw-sim's referee does: violation, arrival, end of time.

Written from the scene file alone, so that a mistake cannot hide on both sides."""

import numpy as np

# Samples of a border's direction in which the closest point is first looked for, and golden-section steps after that.
SAMPLES = 64
REFINEMENTS = 40
GOLDEN = 0.5 * (5.0**0.5 - 1.0)


class Part:
    """The points with (|u - c_u| / h_u)^p + (|v - c_v| / h_v)^p < 1."""

    def __init__(self, table):
        self.center, self.half, self.p = np.array(table["center"]), np.array(table["half"]), table["p"]

    def depth(self, pixel):
        """Distance to the border of a point inside, px; 0 outside."""
        offset = np.abs(pixel - self.center)
        if ((offset / self.half) ** self.p).sum() >= 1.0:
            return 0.0

        # By symmetry the closest point of the border lies in the same quadrant: by its direction from the centre.
        def distance(theta):
            u, v = np.cos(theta), np.sin(theta)
            radius = (np.abs(u) ** self.p + np.abs(v) ** self.p) ** (-1.0 / self.p)
            return np.hypot(self.half[0] * radius * u - offset[0], self.half[1] * radius * v - offset[1])

        thetas = np.linspace(0.0, np.pi / 2, SAMPLES + 1)
        best = int(np.argmin(distance(thetas)))
        low, high = thetas[max(best - 1, 0)], thetas[min(best + 1, SAMPLES)]
        for _ in range(REFINEMENTS):
            a, b = high - GOLDEN * (high - low), low + GOLDEN * (high - low)
            low, high = (low, b) if distance(a) < distance(b) else (a, high)
        return float(min(distance(0.5 * (low + high)), distance(thetas[best])))


class Referee:
    """Judges true features, period by period."""

    def __init__(self, scene, goal):
        """`goal` are the features at the goal, px."""
        self.size = np.array([scene["camera"]["width"], scene["camera"]["height"]])
        self.goal = goal
        self.occlusions = [
            (table["name"], [Part(part) for part in table["parts"]]) for table in scene.get("occlusion", [])
        ]
        self.violation_px = scene["success"]["violation_px"]
        self.convergence_px = scene["success"]["convergence_px"]

    def error(self, pixels):
        """Largest component of s - s*, px."""
        return float(np.abs(pixels - self.goal).max())

    def violation(self, pixels):
        """What a point lies too deep in, or None."""
        if not np.isfinite(pixels).all():
            return "outside the image"
        out = np.maximum(np.maximum(-pixels, pixels - self.size), 0.0)
        if np.hypot(out[:, 0], out[:, 1]).max() > self.violation_px:
            return "outside the image"
        for name, parts in self.occlusions:
            for part in parts:
                if max(part.depth(pixel) for pixel in pixels) > self.violation_px:
                    return name
        return None

    def arrived(self, pixels):
        return self.error(pixels) <= self.convergence_px
