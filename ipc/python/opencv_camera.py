#!/usr/bin/env python3
"""A real camera in the emulator's place: OpenCV frames in, features with exposure stamps out.

    pip install -r ipc/python/requirements-opencv.txt
    python3 ipc/python/opencv_camera.py --scene my-scene.toml --device 0 --dark
    vpcd --scene my-scene.toml        # disarmed: watch it first, then `vpcctl arm`

Markers are round blobs, bright on dark or, with --dark, dark on bright, one for each point of the scene's pattern. To
try it without a camera, give --video FILE or --image-file FILE; --print shows what is published, --dry publishes nothing.

This program only publishes features. The program that moves the camera receives `vpc/twist` (CONTRACT.md).

Time. A message carries the middle of the exposure on CLOCK_MONOTONIC. V4L2 drivers stamp frames on that clock and OpenCV
passes the stamp on; without a stamp, the program takes the time at which it read the frame. Either is later than the
exposure: measure by how much (film a clock; 100 to 130 ms is common without driver stamps) and give it as --latency-ms.

Roll. Markers look alike, so a pattern that looks the same after a turn (a square: a quarter turn) is found only if a single
arrangement is possible; the program says at the start within which roll. See --turn-max.

Lens. The controller knows a pinhole. With --calibration FILE (TOML: fx, fy, cx, cy in px and distortion, a list as
cv2.calibrateCamera returns it) points are mapped to the pinhole of the scene.

Needs Python 3.11 or later.
"""

import argparse
import contextlib
import itertools
import sys
import time
import tomllib

MISSING = "opencv_camera: {} is missing; pip install -r ipc/python/requirements-opencv.txt"

try:
    import numpy as np
except ImportError:
    sys.exit(MISSING.format("NumPy"))

# How far a marker may be from where it is expected: px, and share of the distance to the next marker.
GATE_PX = 40.0
GATE_SHARE = 0.4
# Mean distance of blobs from a turned, scaled and shifted goal, as a share of its size, that is still the pattern.
MISFIT = 0.15
# An arrangement must fit this much better than any other one.
CLEARLY = 1.5
# Frames with fewer than two markers in sight after which all are looked for anew.
PATIENCE = 5
MAX_BLOBS = 8
# How far the rim of a whole disc may be from an ellipse, px; its contour runs along whole pixels.
RIM_PX = 0.9


def import_cv2():
    """OpenCV, or the end of the program with what to do."""
    try:
        import cv2
    except ImportError:
        sys.exit(MISSING.format("OpenCV"))
    return cv2


def pinhole(camera):
    """The matrix of a camera with fx, fy, cx, cy in px."""
    return np.array([[camera["fx"], 0.0, camera["cx"]], [0.0, camera["fy"], camera["cy"]], [0.0, 0.0, 1.0]])


def goal_pixels(cv2, scene):
    """Where the points of the pattern are seen at the goal, px."""
    pattern, goal = np.array(scene["pattern"]["points"]), scene["goal"]
    pose = np.array(goal["rotation"]), np.array(goal["translation"])
    return cv2.projectPoints(pattern, *pose, pinhole(scene["camera"]), None)[0].reshape(-1, 2)


def similarity(source, target):
    """The turn, scale and shift that best takes points to points: (complex factor, shift); points as complex numbers."""
    a, b = source - source.mean(), target - target.mean()
    factor = np.vdot(a, b) / np.vdot(a, a).real if len(source) > 1 else 1.0
    return factor, target.mean() - factor * source.mean()


def complex_points(points):
    points = np.asarray(points, dtype=float).reshape(-1, 2)
    return points[:, 0] + 1j * points[:, 1]


def symmetry(goal):
    """The smallest turn after which the pattern looks the same, deg; 360 where there is none."""
    points = complex_points(goal)
    points = points - points.mean()
    size = np.abs(points).max()
    for count in range(len(points), 1, -1):
        turned = points * np.exp(2j * np.pi / count)
        if np.abs(turned[:, None] - points).min(axis=1).max() < MISFIT * size:
            return 360.0 / count
    return 360.0


def within(goal, turn_max):
    """How far the pattern may be rolled against the goal to be taken up, deg."""
    return min(turn_max, symmetry(goal) - turn_max)


def remedy(goal, turn_max):
    """What to do about a pattern that is not told from itself turned; empty where there is nothing to do."""
    turn, most = symmetry(goal), within(goal, turn_max)
    if most >= turn_max:
        return ""
    return (
        f"the pattern looks the same after {turn:.0f} deg and is taken up only within {max(most, 0.0):.0f} deg of the goal's"
        f" roll; move a marker, so that it does not, or give --turn-max {turn / 2 - 1:.0f} if it is never rolled by more"
    )


class Blobs:
    """Round blobs of a frame: threshold, shape, and the centroid of what stands out from its surroundings."""

    def __init__(self, cv2, dark, threshold, area, circularity):
        self.cv2, self.dark, self.threshold, self.area, self.circularity = cv2, dark, threshold, area, circularity

    def find(self, frame):
        """Centres (u, v) in px of at most MAX_BLOBS blobs, the largest first."""
        cv2 = self.cv2
        grey = cv2.cvtColor(frame, cv2.COLOR_BGR2GRAY) if frame.ndim == 3 else frame
        grey = 255 - grey if self.dark else grey
        if self.threshold is None:
            # Against the surroundings, so that shading does no harm.
            side = max(3, int(2.5 * np.sqrt(self.area[1]))) | 1
            surroundings = cv2.blur(grey, (side, side))
            mask = (grey.astype(np.int16) - surroundings > 25).astype(np.uint8)
        else:
            mask = (grey > self.threshold).astype(np.uint8)
        contours, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
        found = []
        for contour in contours:
            area, length = cv2.contourArea(contour), cv2.arcLength(contour, True)
            if not self.area[0] <= area <= self.area[1]:
                continue
            if 4.0 * np.pi * area < self.circularity * length**2:
                continue
            if len(contour) < 8 or not self.whole(contour):
                continue
            centre = self.centroid(grey, contour)
            if centre is not None:
                found.append((area, centre))
        found.sort(key=lambda blob: -blob[0])
        return np.array([centre for _, centre in found[:MAX_BLOBS]]).reshape(-1, 2)

    def whole(self, contour):
        """Whether the rim is an ellipse all around: a disc that something cuts is not, and its centroid would be off."""
        (u, v), axes, turn = self.cv2.fitEllipse(contour)
        half = 0.5 * np.array(axes)
        if half.min() < 2.0:
            return False
        x, y = (contour.reshape(-1, 2) - (u, v)).T
        cosine, sine = np.cos(np.radians(turn)), np.sin(np.radians(turn))
        radius = np.hypot((cosine * x + sine * y) / half[0], (cosine * y - sine * x) / half[1])
        return np.abs(radius - 1.0).max() * half.min() < RIM_PX

    def centroid(self, grey, contour):
        """Sub-pixel: each pixel weighs as much of the contrast as it has. None where the border cuts the blob."""
        cv2 = self.cv2
        u, v, width, height = cv2.boundingRect(contour)
        left, top, right, bottom = u - 3, v - 3, u + width + 3, v + height + 3
        if left < 0 or top < 0 or right > grey.shape[1] or bottom > grey.shape[0]:
            return None
        window = grey[top:bottom, left:right].astype(float)
        inside = np.zeros(window.shape, np.uint8)
        cv2.drawContours(inside, [contour - (left, top)], -1, 1, cv2.FILLED)
        near = cv2.dilate(inside, np.ones((5, 5), np.uint8))
        if near.all() or not inside.any():
            return None
        background, level = np.median(window[near == 0]), np.median(window[inside == 1])
        if level - background < 20.0:
            return None
        weight = np.clip((window - background) / (level - background), 0.1, 0.9) - 0.1
        moments = cv2.moments(weight * near)
        return left + moments["m10"] / moments["m00"], top + moments["m01"] / moments["m00"]


class Markers:
    """Which blob is which marker, over the frames."""

    def __init__(self, goal, turn_max):
        self.goal = complex_points(goal)
        self.turn_max = np.radians(turn_max)
        # Whether several arrangements fitted the blobs of the last frame.
        self.ambiguous = False
        self.last = self.goal.copy()
        self.seen = np.zeros(len(goal), dtype=bool)
        self.blind = PATIENCE + 1

    def update(self, blobs):
        """Takes the blobs of a frame: (points, visible), in the order of the pattern; hidden points are guesses."""
        blobs = complex_points(blobs)
        if self.blind <= PATIENCE:
            self.follow(blobs)
        self.ambiguous = False
        if self.blind > PATIENCE:
            self.acquire(blobs)
        return [(z.real, z.imag) for z in self.last], self.seen.copy()

    def acquire(self, blobs):
        """All markers at once, where one arrangement of blobs fits clearly better than every other one."""
        size = np.abs(self.goal - self.goal.mean()).max()
        fits = []
        for chosen in itertools.permutations(range(len(blobs)), len(self.goal)):
            target = blobs[list(chosen)]
            factor, shift = similarity(self.goal, target)
            if abs(np.angle(factor)) > self.turn_max or not 0.2 < abs(factor) < 5.0:
                continue
            off = np.abs(factor * self.goal + shift - target).mean() / (abs(factor) * size)
            fits.append((off, chosen))
        fits.sort()
        self.seen[:] = False
        there = bool(fits) and fits[0][0] <= MISFIT
        self.ambiguous = there and len(fits) > 1 and fits[1][0] < CLEARLY * fits[0][0] + 0.02
        if not there or self.ambiguous:
            return
        self.last, self.blind = blobs[list(fits[0][1])], 0
        self.seen[:] = True

    def follow(self, blobs):
        """Markers near where they were; then the hidden ones, near where the others say that they are."""
        last, before, free = self.last.copy(), self.seen.copy(), set(range(len(blobs)))
        self.seen[:] = False
        self.take(np.flatnonzero(before), last, blobs, free)
        found = self.seen.copy()
        if found.any():
            factor, shift = similarity(last[found], self.last[found])
            self.last[~found] = factor * last[~found] + shift
        self.take(np.flatnonzero(~before), self.last.copy(), blobs, free)
        self.blind = 0 if self.seen.sum() >= 2 else self.blind + 1

    def take(self, markers, expected, blobs, free):
        for i in markers:
            gaps = np.abs(np.delete(expected, i) - expected[i])
            gate = min(GATE_PX, GATE_SHARE * gaps.min())
            near = [k for k in free if abs(blobs[k] - expected[i]) < gate]
            # Two of them: not clear which.
            if len(near) == 1:
                self.last[i], self.seen[i] = blobs[near[0]], True
                free.discard(near[0])


class Source:
    """Frames of a device, of a video or of a picture, each with the time it stands for, ns."""

    def __init__(self, cv2, arguments, size, rate):
        self.cv2, self.size, self.rate, self.picture, self.capture = cv2, size, rate, None, None
        self.live = not (arguments.image_file or arguments.video)
        if arguments.image_file:
            self.picture = cv2.imread(arguments.image_file)
            if self.picture is None:
                sys.exit(f"opencv_camera: {arguments.image_file}: no picture that OpenCV can read")
            return
        self.capture = cv2.VideoCapture(arguments.video or arguments.device)
        if not self.capture.isOpened():
            name = arguments.video or f"/dev/video{arguments.device}"
            sys.exit(f"opencv_camera: {name}: cannot be opened as a camera or video")
        if self.live:
            self.capture.set(cv2.CAP_PROP_FRAME_WIDTH, size[0])
            self.capture.set(cv2.CAP_PROP_FRAME_HEIGHT, size[1])
            self.capture.set(cv2.CAP_PROP_FPS, rate)
            # The newest frame, not one that has waited.
            self.capture.set(cv2.CAP_PROP_BUFFERSIZE, 1)

    def frames(self):
        due = time.monotonic()
        while True:
            frame = self.picture
            if frame is None:
                there, frame = self.capture.read()
                if not there:
                    return
            if not self.live:
                # Files come as fast as they are read: at the rate of the scene instead.
                due += 1.0 / self.rate
                time.sleep(max(0.0, due - time.monotonic()))
            yield frame, self.stamp_ns()

    def stamp_ns(self):
        now = time.clock_gettime_ns(time.CLOCK_MONOTONIC)
        if self.live:
            # The V4L2 backend: the driver's stamp, in ms on CLOCK_MONOTONIC where it is a recent one.
            stamp = int(1e6 * self.capture.get(self.cv2.CAP_PROP_POS_MSEC))
            if 0 <= now - stamp < 1_000_000_000:
                return stamp
        return now


class Lens:
    """Maps points of the real lens to the pinhole of the scene."""

    def __init__(self, cv2, path, camera):
        self.cv2 = cv2
        with open(path, "rb") as file:
            real = tomllib.load(file)
        self.real, self.pinhole = pinhole(real), pinhole(camera)
        self.distortion = np.array(real.get("distortion", [0.0] * 5))

    def straighten(self, points):
        if len(points) == 0:
            return points
        points = np.asarray(points, dtype=float).reshape(-1, 1, 2)
        return self.cv2.undistortPoints(points, self.real, self.distortion, P=self.pinhole).reshape(-1, 2)


def parse():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scene", required=True, help="scene file (TOML), the controller's")
    parser.add_argument("--domain", help="directory of the domain [/tmp/vpc-<uid>]")
    source = parser.add_mutually_exclusive_group()
    source.add_argument("--device", type=int, default=0, help="index of the camera, /dev/videoN [%(default)s]")
    source.add_argument("--video", help="video file instead of a camera, played once")
    source.add_argument("--image-file", help="picture instead of a camera, published again and again")
    parser.add_argument("--dark", action="store_true", help="dark markers on a bright ground")
    parser.add_argument("--threshold", type=int, help="grey level that separates markers [adaptive]")
    parser.add_argument(
        "--area", type=float, nargs=2, default=(40.0, 3000.0), metavar="PX2", help="least and greatest area %(default)s"
    )
    parser.add_argument("--circularity", type=float, default=0.75, help="least 4 pi area / perimeter^2 [%(default)s]")
    parser.add_argument(
        "--turn-max", type=float, default=80.0, help="most roll of the pattern against the goal, deg [%(default)s]"
    )
    parser.add_argument("--latency-ms", type=float, default=0.0, help="from exposure to stamp, ms [%(default)s]")
    parser.add_argument("--exposure-ms", type=float, default=0.0, help="length of the exposure, ms [unknown]")
    parser.add_argument("--calibration", help="lens (TOML): fx, fy, cx, cy, distortion")
    parser.add_argument("--frames", type=int, help="end after this many frames")
    parser.add_argument("--print", action="store_true", help="print what is published, a line a frame")
    parser.add_argument("--dry", action="store_true", help="publish nothing: needs neither domain nor iceoryx2")
    return parser.parse_args()


def say(words):
    print(f"opencv_camera: {words}", file=sys.stderr, flush=True)


def publisher(arguments, stack):
    """The ports of a camera, closed at the end of the program; None where nothing is published."""
    if arguments.dry:
        return None
    import vpc_client

    try:
        domain = stack.enter_context(vpc_client.Domain(arguments.domain))
        if not domain.has_controller():
            say(f"no vpcd is in domain {domain.directory} yet; features go out all the same")
        return stack.enter_context(domain.camera())
    except vpc_client.VpcError as error:
        sys.exit(f"opencv_camera: {error}")


def main():
    arguments = parse()
    cv2 = import_cv2()
    try:
        with open(arguments.scene, "rb") as file:
            scene = tomllib.load(file)
    except (OSError, tomllib.TOMLDecodeError) as error:
        sys.exit(f"opencv_camera: {arguments.scene}: {error}")
    size = (scene["camera"]["width"], scene["camera"]["height"])
    lens = Lens(cv2, arguments.calibration, scene["camera"]) if arguments.calibration else None
    blobs = Blobs(cv2, arguments.dark, arguments.threshold, arguments.area, arguments.circularity)
    goal = goal_pixels(cv2, scene)
    markers = Markers(goal, arguments.turn_max)
    advice = remedy(goal, arguments.turn_max)
    if advice:
        say(advice)
    source = Source(cv2, arguments, size, scene["camera"]["rate_hz"])
    with contextlib.ExitStack() as stack:
        ports = publisher(arguments, stack)
        return watch(arguments, source, blobs, markers, lens, ports, advice)


def watch(arguments, source, blobs, markers, lens, ports, advice):
    """Publishes what each frame shows."""
    count = whole = 0
    was_ambiguous = False
    for frame, stamp_ns in itertools.islice(source.frames(), arguments.frames):
        size = (frame.shape[1], frame.shape[0])
        if size != source.size:
            sys.exit(f"opencv_camera: frames of {size[0]} x {size[1]} px; allowed: {source.size[0]} x {source.size[1]}")
        found = blobs.find(frame)
        points, visible = markers.update(lens.straighten(found) if lens else found)
        if markers.ambiguous and not was_ambiguous:
            say(f"frame {count + 1}: all markers are there, but which is which is not clear{' (see above)' if advice else ''}")
        was_ambiguous = markers.ambiguous
        bits = sum(1 << i for i, seen in enumerate(visible) if seen)
        data_ns = stamp_ns - int(1e6 * arguments.latency_ms)
        if ports:
            ports.publish_features(points, data_ns, exposure_ns=int(1e6 * arguments.exposure_ms), visible=bits)
        count += 1
        whole += all(visible)
        if arguments.print:
            text = " ".join(f"({u:.2f}, {v:.2f})" + ("" if seen else "?") for (u, v), seen in zip(points, visible))
            print(count, data_ns, text, flush=True)
    print(f"{count} frames, {whole} of them with all markers in sight")
    return 0 if whole else 1


if __name__ == "__main__":
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        sys.exit(130)
