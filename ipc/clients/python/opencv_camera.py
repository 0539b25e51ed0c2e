#!/usr/bin/env python3
"""A camera of your own: OpenCV frames in, the centres of AprilTags out, with the times of their exposure. A template.

    pip install -r ipc/clients/python/requirements-opencv.txt
    python3 ipc/clients/python/opencv_camera.py --scene my-scene.toml --device 0
    vpcd --scene my-scene.toml        # disarmed: watch it first, then `vpcctl arm`

One tag of the family 36h11 for each point of the scene's pattern, its centre at the point: numbers 0, 1, ... in the
order of the points, or those of --tags. A tag that is not found as a whole is not visible. To try it without a camera,
give --video FILE or --image-file FILE; --print shows what is published, --dry publishes nothing.

This program only publishes features. The program that moves the camera receives `vpc/twist` (CONTRACT.md). `vpc-camera`
does the same without Python, faster and more exactly.

Time. A message carries the middle of the exposure on CLOCK_MONOTONIC. V4L2 drivers stamp frames on that clock and OpenCV
passes the stamp on; without a stamp, the program takes the time at which it read the frame. Either is later than the
exposure: measure by how much (film a clock; 100 to 130 ms is common without driver stamps) and give it as --latency-ms.

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

MISSING = "opencv_camera: {} is missing; pip install -r ipc/clients/python/requirements-opencv.txt"

try:
    import numpy as np
except ImportError:
    sys.exit(MISSING.format("NumPy"))


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


class Tags:
    """Finds the tags of these numbers."""

    def __init__(self, cv2, numbers, lens):
        self.cv2, self.numbers, self.lens = cv2, numbers, lens
        self.detector = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11))
        # Where each was last seen.
        self.points = np.zeros((len(numbers), 2))

    def find(self, frame):
        """The centres (u, v), px, and whether each was found; one that was not is where it was last seen."""
        grey = self.cv2.cvtColor(frame, self.cv2.COLOR_BGR2GRAY) if frame.ndim == 3 else frame
        corners, numbers, _ = self.detector.detectMarkers(grey)
        found = {} if numbers is None else dict(zip(numbers.ravel().tolist(), corners, strict=True))
        visible = [number in found for number in self.numbers]
        for i in np.flatnonzero(visible):
            refined = self.refined(grey, found[self.numbers[i]])
            self.points[i] = centre(self.lens.straighten(refined) if self.lens else refined)
        return self.points, visible

    def refined(self, grey, corners):
        """The four corners to a part of a pixel, within less than a module (an eighth of the side)."""
        side = min(np.linalg.norm(corners[0] - np.roll(corners[0], 1, axis=0), axis=1))
        window = max(1, int(side / 8 / 2))
        stop = (self.cv2.TERM_CRITERIA_EPS + self.cv2.TERM_CRITERIA_COUNT, 50, 1e-3)
        return self.cv2.cornerSubPix(grey, corners.reshape(-1, 1, 2), (window, window), (-1, -1), stop).reshape(-1, 2)


def centre(corners):
    """Where the diagonals meet: the image of the centre of a square, however it is seen."""
    a, b, c, d = np.column_stack([corners, np.ones(4)])
    meeting = np.cross(np.cross(a, c), np.cross(b, d))
    return meeting[:2] / meeting[2]


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
        points = np.asarray(points, dtype=float).reshape(-1, 1, 2)
        return self.cv2.undistortPoints(points, self.real, self.distortion, P=self.pinhole).reshape(-1, 2)


def numbers(text):
    """Numbers of tags, as in 4,7,12,3; of the family's, and each once."""
    values = [int(word) for word in text.split(",")]
    if len(set(values)) != len(values) or not all(0 <= value <= 586 for value in values):
        raise argparse.ArgumentTypeError(f"{text}; allowed: 0 to 586, each once")
    return values


def parse():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scene", required=True, help="scene file (TOML), the controller's")
    parser.add_argument("--domain", help="directory of the domain [/tmp/vpc-<uid>]")
    source = parser.add_mutually_exclusive_group()
    source.add_argument("--device", type=int, default=0, help="index of the camera, /dev/videoN [%(default)s]")
    source.add_argument("--video", help="video file instead of a camera, played once")
    source.add_argument("--image-file", help="picture instead of a camera, published again and again")
    parser.add_argument("--tags", type=numbers, metavar="N,N,...", help="number of the tag at each point [0,1,...]")
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
    count = len(scene["pattern"]["points"])
    wanted = arguments.tags or list(range(count))
    if len(wanted) != count:
        sys.exit(f"opencv_camera: --tags: {len(wanted)} numbers; allowed: {count}, one for each point of the scene's pattern")
    size = (scene["camera"]["width"], scene["camera"]["height"])
    lens = Lens(cv2, arguments.calibration, scene["camera"]) if arguments.calibration else None
    source = Source(cv2, arguments, size, scene["camera"]["rate_hz"])
    with contextlib.ExitStack() as stack:
        return watch(arguments, source, Tags(cv2, wanted, lens), publisher(arguments, stack))


def watch(arguments, source, tags, ports):
    """Publishes what each frame shows."""
    count = whole = 0
    for frame, stamp_ns in itertools.islice(source.frames(), arguments.frames):
        size = (frame.shape[1], frame.shape[0])
        if size != source.size:
            sys.exit(f"opencv_camera: frames of {size[0]} x {size[1]} px; allowed: {source.size[0]} x {source.size[1]}")
        points, visible = tags.find(frame)
        bits = sum(1 << i for i, seen in enumerate(visible) if seen)
        data_ns = stamp_ns - int(1e6 * arguments.latency_ms)
        if ports:
            ports.publish_features(points.tolist(), data_ns, exposure_ns=int(1e6 * arguments.exposure_ms), visible=bits)
        count += 1
        whole += all(visible)
        if arguments.print:
            text = " ".join(f"({u:.2f}, {v:.2f})" + ("" if seen else "?") for (u, v), seen in zip(points, visible))
            print(count, data_ns, text, flush=True)
    print(f"{count} frames, {whole} of them with all tags in sight")
    return 0 if whole else 1


if __name__ == "__main__":
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        sys.exit(130)
