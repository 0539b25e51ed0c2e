"""A camera with a clock of its own, and frames that come when they would. Each frame is logged in `path`, one a line:
number, middle of the exposure on CLOCK_MONOTONIC, exposure, ns. Frames in LOST, counted from the start, never come."""

import random
import time

import numpy as np

RATE_HZ = 60.0
LOST = (80, 81, 82, 100)
# From the end of the exposure to the begin of the transfer, and what the fastest transfer takes.
READOUT_NS, TRANSFER_NS = 300_000, 4_000_000


class Sensor:
    def __init__(self, path, first=1):
        self.log, self.number, self.random = open(path, "w"), first - 1, random.Random(1)
        self.exposure_ns, self.begun, self.count = 5_000_000, time.monotonic_ns(), 0

    @staticmethod
    def clock(monotonic_ns):
        """The camera's clock: it runs fast by 15 in a million, and began somewhere."""
        return int((monotonic_ns - 10**9) * (1.0 + 15e-6)) - 7_777_777_777

    def frame(self, width, height, channels):
        """The next frame that comes: number, middle of the exposure and begin of the transfer on CLOCK_MONOTONIC, image."""
        while True:
            self.number, self.count = self.number + 1, self.count + 1
            middle = self.begun + int(self.number * 1e9 / RATE_HZ)
            if middle + self.exposure_ns > time.monotonic_ns() and self.count not in LOST:
                break
        sent = middle + self.exposure_ns // 2 + READOUT_NS
        # Every second frame is late; sleep may be, too.
        late = self.random.expovariate(1e-6) if self.number % 2 else 0.0
        arrives = sent + TRANSFER_NS + int(late)
        image = self.pixels(width, height, channels)
        print(self.number, middle, self.exposure_ns, file=self.log, flush=True)
        time.sleep(max(0.0, (arrives - time.monotonic_ns()) / 1e9 - 1e-3))
        while time.monotonic_ns() < arrives:
            pass
        return self.number, middle, sent, image

    def pixels(self, width, height, channels):
        """An image that says its number: first byte its low byte, then 1, 2, 3 ... row by row."""
        image = np.arange(width * height * channels, dtype=np.uint32).astype(np.uint8)
        image[0] = self.number % 256
        return image.reshape((height, width, channels) if channels > 1 else (height, width))
