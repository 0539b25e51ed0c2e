"""Judges a run by the scene's own words, as hw-sim's referee does: violation, arrival, end of time.

Written from the scene file alone, so that a mistake cannot hide on both sides."""

import pathlib

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


class Mask:
    """The white pixels of an image; pixel (i, j) is the square of side 1 about (i, j)."""

    def __init__(self, path, far):
        """Depths beyond `far` px are told as infinite."""
        try:
            from PIL import Image
        except ImportError:
            raise SystemExit(f"referee: {path} is read with Pillow, which is missing; pip install pillow") from None
        self.white = np.asarray(Image.open(path).convert("L")) >= 128
        self.reach = int(far) + 2

    def depth(self, pixel):
        """Distance of a point on a white pixel to the nearest one that is not, px; 0 elsewhere. What lies outside the
        image is no way out."""
        height, width = self.white.shape
        # From the corner of the first pixel: pixels begin at whole numbers.
        u, v = pixel[0] + 0.5, pixel[1] + 0.5
        i, j = (min(max(int(np.floor(x)), 0), size - 1) for x, size in ((u, width), (v, height)))
        if not (0.0 <= u <= width and 0.0 <= v <= height and self.white[j, i]):
            return 0.0
        left, top = max(i - self.reach, 0), max(j - self.reach, 0)
        rows, columns = np.nonzero(~self.white[top : j + self.reach + 1, left : i + self.reach + 1])
        if len(rows) == 0:
            return float("inf")
        gap_u = np.maximum(np.maximum(left + columns - u, u - (left + columns + 1)), 0.0)
        gap_v = np.maximum(np.maximum(top + rows - v, v - (top + rows + 1)), 0.0)
        return float(np.hypot(gap_u, gap_v).min())


class Referee:
    """Judges true features, period by period."""

    def __init__(self, scene, goal, directory="."):
        """`goal` are the features at the goal, px; masks are looked for in `directory`, that of the scene file."""
        self.size = np.array([scene["camera"]["width"], scene["camera"]["height"]])
        self.goal = goal
        self.violation_px = scene["success"]["violation_px"]
        self.convergence_px = scene["success"]["convergence_px"]
        self.occlusions = []
        for table in scene.get("occlusion", []):
            areas = [Part(part) for part in table.get("parts", [])]
            if "mask" in table:
                areas.append(Mask(pathlib.Path(directory) / table["mask"], self.violation_px))
            self.occlusions.append((table["name"], areas))

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
        for name, areas in self.occlusions:
            if any(area.depth(pixel) > self.violation_px for area in areas for pixel in pixels):
                return name
        return None

    def arrived(self, pixels):
        return self.error(pixels) <= self.convergence_px
