#!/usr/bin/env python3
"""An Intel RealSense camera on `vpc/image`: colour or left infrared images, stamped with the middle of their exposure.

    pip install -r ipc/clients/python/requirements.txt pyrealsense2
    python3 ipc/clients/python/realsense_camera.py --stream infrared --size 848x480 --rate 60

NOT RUN ON A CAMERA: it was tested against a stand-in with the calls and units of pyrealsense2 2.59.

Time. Firmware stamps the middle of the exposure (`sensor_timestamp`) and the begin of the transfer (`frame_timestamp`) on
the camera's clock; librealsense hands them over as metadata (on Linux with its patched kernel modules, or built with
FORCE_RSUSB_BACKEND). The offset from that clock to CLOCK_MONOTONIC is the least difference between a frame's arrival and
its `frame_timestamp` over the last 2 s: the fastest transfer. How long that takes, the camera cannot say: measure it
(vpc-calib) and give it as --transfer-ms; without it, stamps are late by that much. The first second is not published.
"""

import argparse
import signal
import sys
import time
from collections import deque

try:
    import numpy as np
    import vpc_client
except ModuleNotFoundError as missing:
    sys.exit(f"realsense_camera: {missing.name} is missing; pip install -r ipc/clients/python/requirements.txt")
from vpc_client import BadArgument, Encoding

# Over so long the least difference of the clocks counts; they drift by some 0.01 ms a second.
WINDOW_NS = 2_000_000_000
SETTLE_NS = 1_000_000_000
PATIENCE_MS = 2000
# A larger gap in the frame counter is a camera that started again.
MOST_LOST = 1000


class Offset:
    """From the camera's clock to CLOCK_MONOTONIC, ns."""

    def __init__(self):
        self.differences = deque()

    def measure(self, arrived_ns, sent_ns):
        """Takes a frame that the camera began to send at `sent_ns` of its clock; the least difference in the window."""
        while self.differences and self.differences[0][0] < arrived_ns - WINDOW_NS:
            self.differences.popleft()
        self.differences.append((arrived_ns, arrived_ns - sent_ns))
        return min(difference for _, difference in self.differences)


def metadata_ns(rs, frame, name):
    """A time in the frame's metadata, which has us."""
    kind = getattr(rs.frame_metadata_value, name)
    if not frame.supports_frame_metadata(kind):
        raise BadArgument(f"the frames have no metadata {name}; allowed: librealsense with metadata (see above)")
    return 1000 * frame.get_frame_metadata(kind)


def run(rs, publisher, pipeline, arguments, is_over):
    offset, last, begun = Offset(), None, time.monotonic_ns()
    while not is_over():
        frames = pipeline.wait_for_frames(PATIENCE_MS)
        arrived_ns = time.monotonic_ns()
        frame = frames.get_color_frame() if arguments.stream == "color" else frames.get_infrared_frame(1)
        number = frame.get_frame_number()
        if number == last:
            continue
        sent_ns = metadata_ns(rs, frame, "frame_timestamp")
        from_camera_ns = offset.measure(arrived_ns, sent_ns) - int(1e6 * arguments.transfer_ms)
        if arrived_ns < begun + SETTLE_NS:
            continue
        exposure_ns = metadata_ns(rs, frame, "actual_exposure")
        middle_ns = metadata_ns(rs, frame, "sensor_timestamp") + from_camera_ns
        if last is not None and 0 < number - last <= MOST_LOST:
            for _ in range(number - last - 1):
                publisher.skip()
        last = number
        encoding = Encoding.BGR8 if arguments.stream == "color" else Encoding.MONO8
        image = np.asanyarray(frame.get_data())
        publisher.publish(image, encoding, middle_ns, middle_ns - exposure_ns // 2, exposure_ns)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--stream", choices=("color", "infrared"), default="color", help="[%(default)s]")
    parser.add_argument("--size", default="640x480", help="width and height, px [%(default)s]")
    parser.add_argument("--rate", type=int, default=30, help="Hz [%(default)s]")
    parser.add_argument("--serial", help="of the camera, where there are several")
    parser.add_argument("--exposure-us", type=float, help="fixed exposure [automatic]")
    parser.add_argument("--transfer-ms", type=float, default=0.0, help="of the fastest frame, to be measured [0]")
    parser.add_argument("--domain", help=f"directory of the domain [{vpc_client.default_directory()}]")
    arguments = parser.parse_args()
    try:
        width, height = (int(side) for side in arguments.size.split("x"))
    except ValueError:
        raise BadArgument(f"--size {arguments.size}; allowed: WIDTHxHEIGHT, such as 640x480") from None
    if not 0.0 <= arguments.transfer_ms <= 200.0:
        raise BadArgument(f"--transfer-ms {arguments.transfer_ms}; allowed: 0 to 200")
    import pyrealsense2 as rs

    config, pipeline, ended = rs.config(), rs.pipeline(), []
    if arguments.serial:
        config.enable_device(arguments.serial)
    if arguments.stream == "color":
        config.enable_stream(rs.stream.color, width, height, rs.format.bgr8, arguments.rate)
    else:
        config.enable_stream(rs.stream.infrared, 1, width, height, rs.format.y8, arguments.rate)
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: ended.append(True))
    with vpc_client.Domain(arguments.domain) as domain:
        publisher = domain.image_publisher(3 * width * height)
        device = pipeline.start(config).get_device()
        try:
            color = arguments.stream == "color"
            sensor = device.first_color_sensor() if color else device.first_depth_sensor()
            if arguments.exposure_us is not None:
                sensor.set_option(rs.option.enable_auto_exposure, 0)
                # The colour sensor's option counts 100 us.
                sensor.set_option(rs.option.exposure, arguments.exposure_us / (100.0 if color else 1.0))
            run(rs, publisher, pipeline, arguments, lambda: bool(ended))
        finally:
            pipeline.stop()


if __name__ == "__main__":
    try:
        main()
    except ModuleNotFoundError as missing:
        sys.exit(f"realsense_camera: {missing.name} is missing; pip install pyrealsense2")
    except (vpc_client.VpcError, OSError, RuntimeError) as error:
        sys.exit(f"realsense_camera: {error}")
