#!/usr/bin/env python3
"""A GigE Vision or USB3 Vision camera on `vpc/image`, by Aravis: grey images, stamped with the middle of their exposure.

    apt install gir1.2-aravis-0.8 python3-gi; pip install -r ipc/clients/python/requirements.txt
    python3 ipc/clients/python/aravis_camera.py --exposure-us 4000 --rate 60

NOT RUN ON A CAMERA: it was tested against a stand-in with the calls and units of Aravis 0.8, and once run on the fake camera
of Aravis 0.8.26, with a stand-in for the latch, which that one lacks.

Time. The camera stamps frames on its own clock. Once a second the program latches that clock: it lies between two readings
of CLOCK_MONOTONIC, and the shortest of the last rounds counts, so the offset is known to half of its duration (printed).
Cameras without a latch are refused. SFNC leaves open which instant the stamp is; most cameras stamp the begin of the
exposure. Look it up, and say --stamp middle or end otherwise. The exposure is fixed, so that its middle is known.
"""

import argparse
import signal
import sys
import time

try:
    import numpy as np
    import vpc_client
except ModuleNotFoundError as missing:
    sys.exit(f"aravis_camera: {missing.name} is missing; pip install -r ipc/clients/python/requirements.txt")
from vpc_client import BadArgument, Encoding

# Command, value and ticks a second (of ns where there are none): SFNC 2, then GigE Vision 1.
LATCHES = (
    ("TimestampLatch", "TimestampLatchValue", None),
    ("GevTimestampControlLatch", "GevTimestampValue", "GevTimestampTickFrequency"),
)
ROUNDS = 5
EVERY_NS = 1_000_000_000
PATIENCE_US = 2_000_000
BUFFERS = 8
# A larger gap in the frame numbers is a camera that started again.
MOST_LOST = 1000
# From the stamp to the middle, in exposures.
TO_MIDDLE = {"begin": 0.5, "middle": 0.0, "end": -0.5}


class Clock:
    """From the camera's clock to CLOCK_MONOTONIC."""

    def __init__(self, camera):
        self.camera = camera
        self.latch = next((latch for latch in LATCHES if camera.is_feature_available(latch[0])), None)
        if self.latch is None:
            raise BadArgument(f"the camera has no {LATCHES[0][0]}; allowed: cameras whose clock can be read")
        self.offset_ns, self.unsure_ns = min((self.round() for _ in range(ROUNDS)), key=lambda found: found[1])
        self.measured = time.monotonic_ns()

    def round(self):
        """One latch: offset and how far it may be off, ns."""
        command, value, frequency = self.latch
        before = time.monotonic_ns()
        self.camera.execute_command(command)
        after = time.monotonic_ns()
        ticks = self.camera.get_integer(value)
        camera_ns = ticks if frequency is None else ticks * 10**9 // self.camera.get_integer(frequency)
        return (before + after) // 2 - camera_ns, (after - before) // 2

    def follow(self):
        """Once a second: the clocks drift apart by some 0.05 ms."""
        if time.monotonic_ns() - self.measured > EVERY_NS:
            self.__init__(self.camera)


def lost(last, number):
    """Frames between two frame numbers; GigE Vision 1 counts to 65535, and then from 1."""
    if number <= last and 0xFFFF - MOST_LOST < last <= 0xFFFF:
        number += 0xFFFF
    return number - last - 1 if 0 < number - last <= MOST_LOST else 0


def run(Aravis, publisher, stream, clock, exposure_ns, stamp, is_over):
    last = None
    while not is_over():
        clock.follow()
        buffer = stream.timeout_pop_buffer(PATIENCE_US)
        if buffer is None:
            raise OSError(f"no frame for {PATIENCE_US / 1e6:.0f} s")
        # A frame that lost packets leaves a gap in the numbers.
        if buffer.get_status() == Aravis.BufferStatus.SUCCESS:
            number, shape = buffer.get_frame_id(), (buffer.get_image_height(), buffer.get_image_width())
            for _ in range(0 if last is None else lost(last, number)):
                publisher.skip()
            last = number
            middle_ns = buffer.get_timestamp() + clock.offset_ns + int(TO_MIDDLE[stamp] * exposure_ns)
            pixels = np.frombuffer(buffer.get_data(), np.uint8, shape[0] * shape[1]).reshape(shape)
            publisher.publish(pixels, Encoding.MONO8, middle_ns, middle_ns - exposure_ns // 2, exposure_ns)
        stream.push_buffer(buffer)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--camera", help="name or address, where there are several")
    parser.add_argument("--exposure-us", type=float, required=True)
    parser.add_argument("--rate", type=float, default=30.0, help="Hz [%(default)s]")
    parser.add_argument("--stamp", choices=TO_MIDDLE, default="begin", help="of the exposure [%(default)s]")
    parser.add_argument("--domain", help=f"directory of the domain [{vpc_client.default_directory()}]")
    arguments = parser.parse_args()
    for name, value, most in (("exposure-us", arguments.exposure_us, 1e6), ("rate", arguments.rate, 1000.0)):
        if not 1.0 <= value <= most:
            raise BadArgument(f"--{name} {value}; allowed: 1 to {most:.0f}")
    import gi

    gi.require_version("Aravis", "0.8")
    from gi.repository import Aravis

    camera, ended = Aravis.Camera.new(arguments.camera), []
    camera.set_pixel_format_from_string("Mono8")
    if camera.is_exposure_auto_available():
        camera.set_exposure_time_auto(Aravis.Auto.OFF)
    camera.set_exposure_time(arguments.exposure_us)
    camera.set_frame_rate(arguments.rate)
    # What the camera made of it.
    exposure_ns = int(1000 * camera.get_exposure_time())
    size = camera.get_payload()
    stream = camera.create_stream(None, None)
    for _ in range(BUFFERS):
        stream.push_buffer(Aravis.Buffer.new_allocate(size))
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: ended.append(True))
    with vpc_client.Domain(arguments.domain) as domain:
        publisher, clock = domain.image_publisher(size), Clock(camera)
        print(f"the camera's clock is known to {clock.unsure_ns / 1e6:.3f} ms", flush=True)
        camera.start_acquisition()
        try:
            run(Aravis, publisher, stream, clock, exposure_ns, arguments.stamp, lambda: bool(ended))
        finally:
            camera.stop_acquisition()


if __name__ == "__main__":
    try:
        main()
    except ModuleNotFoundError as missing:
        sys.exit(f"aravis_camera: {missing.name} is missing; apt install python3-gi gir1.2-aravis-0.8")
    except (vpc_client.VpcError, OSError, RuntimeError, ValueError) as error:
        sys.exit(f"aravis_camera: {error}")
