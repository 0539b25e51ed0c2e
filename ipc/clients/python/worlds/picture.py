"""The printed sheet of tags, and what a picture shows besides the simulator's world: spot on the lens, grasped object."""

import io
import math
import pathlib
import re

import numpy as np
import resvg_py
from PIL import Image, ImageFilter

# Pixels of the sheet's texture per metre.
TEXTURE_PER_M = 8000.0
# Levels of the grasped object, and of the stray light of a spot; share of the light that passes it; its blur, px; how wide
# its border is, px.
OBJECT_LEVEL = 40.0
VEIL, TRANSMISSION, BLUR_PX, SOFT_PX = 27.0, 0.5, 16.0, 7.0
# Samples along a side of a pixel that the border of the grasped object crosses.
SAMPLES = 4


class Sheet:
    """A drawing of `vpc-camera tags`, as it comes out of a printer. Its origin is that of the pattern, x to the right, y
    down."""

    def __init__(self, path):
        text = pathlib.Path(path).read_text()
        head = re.search(r'viewBox="(\S+) (\S+) (\S+) (\S+)"', text)
        if head is None:
            raise ValueError(f"{path}: no viewBox; allowed: a drawing of `vpc-camera tags`")
        left, top, width, height = (float(number) for number in head.groups())
        # Whole pixels, which resvg would round to for itself, and stretch the drawing.
        columns, rows = (math.ceil(1e-3 * TEXTURE_PER_M * side - 1e-6) for side in (width, height))
        width, height = (1e3 * side / TEXTURE_PER_M for side in (columns, rows))
        # Corners in the pattern's frame: left, top, right, bottom, m.
        self.box = tuple(1e-3 * side for side in (left, top, left + width, top + height))
        size = f'width="{columns}" height="{rows}" viewBox="{left} {top} {width} {height}"'
        text = re.sub('width="[^"]*" height="[^"]*" viewBox="[^"]*"', size, text, count=1)
        png = resvg_py.svg_to_bytes(svg_string=text)
        self.image = Image.open(io.BytesIO(bytes(png))).convert("RGB")


def _norm(part, u, v):
    """Below 1 inside of a part of an occlusion."""
    (center_u, center_v), (half_u, half_v), p = part["center"], part["half"], part["p"]
    return (np.abs((u - center_u) / half_u) ** p + np.abs((v - center_v) / half_v) ** p) ** (1.0 / p)


class Lens:
    """Paints a scene's occlusions into pictures of its camera."""

    def __init__(self, scene):
        width, height = int(scene["camera"]["width"]), int(scene["camera"]["height"])
        self.spots, self.objects = [], []
        for occlusion in scene.get("occlusion", []):
            if "mask" in occlusion:
                raise ValueError(f"occlusion {occlusion['name']}: a mask; allowed: parts")
            if occlusion.get("on_lens"):
                u, v = np.meshgrid(np.arange(width), np.arange(height))
                action = np.zeros((height, width))
                for part in occlusion["parts"]:
                    least = min(part["half"])
                    depth = (1.0 - _norm(part, u, v)) * least / min(SOFT_PX, 0.5 * least)
                    depth = np.clip(depth, 0.0, 1.0)
                    action = np.maximum(action, depth * depth * (3.0 - 2.0 * depth))
                rows, columns = (np.flatnonzero(action.any(axis=k)) for k in (1, 0))
                reach = int(3 * BLUR_PX)
                window = tuple(slice(max(found[0] - reach, 0), found[-1] + reach + 1) for found in (rows, columns))
                self.spots.append((window, action[window]))
            else:
                offsets = (np.arange(SAMPLES) + 0.5) / SAMPLES - 0.5
                us = (np.arange(width)[:, None] + offsets).ravel()
                vs = (np.arange(height)[:, None] + offsets).ravel()
                u, v = np.meshgrid(us, vs)
                inside = np.any([_norm(part, u, v) < 1.0 for part in occlusion["parts"]], axis=0)
                share = inside.reshape(height, SAMPLES, width, SAMPLES).mean(axis=(1, 3))
                self.objects.append((share, bool(occlusion.get("grasped"))))

    def cover(self, levels, is_grasped):
        """A picture (height, width), levels from 0 to 255, behind the occlusions; uint8."""
        levels = np.array(levels, float)
        for share, goes in self.objects:
            if is_grasped or not goes:
                levels += share * (OBJECT_LEVEL - levels)
        for window, action in self.spots:
            around = Image.fromarray(np.clip(levels[window], 0, 255).astype(np.uint8))
            blurred = np.asarray(around.filter(ImageFilter.GaussianBlur(BLUR_PX)), float)
            levels[window] += action * (TRANSMISSION * blurred + VEIL - levels[window])
        return np.clip(np.rint(levels), 0, 255).astype(np.uint8)
