"""Stands in for Aravis: the calls of aravis_camera.py, with the names and units of 0.8. The camera's name is the path of
the sensor's log: a camera of GigE Vision 1 where it ends in `.gev`, which counts frames to 65535; without a clock that can
be read where it ends in `.bare`."""

import time
from enum import Enum

import sensor

BufferStatus = Enum("BufferStatus", "SUCCESS MISSING_PACKETS")
Auto = Enum("Auto", "OFF ONCE CONTINUOUS")
WIDTH, HEIGHT = 96, 64
TICKS = 125_000_000


class Buffer:
    @staticmethod
    def new_allocate(size):
        assert size == WIDTH * HEIGHT
        return Buffer()

    def get_status(self):
        return self.status

    def get_frame_id(self):
        return self.number

    def get_timestamp(self):
        return self.stamp

    def get_image_width(self):
        return WIDTH

    def get_image_height(self):
        return HEIGHT

    def get_data(self):
        return self.data


class Stream:
    def __init__(self, camera):
        self.camera, self.free = camera, []

    def push_buffer(self, buffer):
        self.free.append(buffer)

    def timeout_pop_buffer(self, _timeout_us):
        # Without a buffer Aravis drops frames.
        buffer, found = self.free.pop(), self.camera.sensor
        number, middle, _, image = found.frame(WIDTH, HEIGHT, 1)
        buffer.number = (number - 1) % 0xFFFF + 1 if self.camera.is_old else number
        # Begin of the exposure.
        buffer.stamp = found.clock(middle - found.exposure_ns // 2)
        buffer.data = image.tobytes()
        buffer.status = BufferStatus.MISSING_PACKETS if number % 97 == 0 else BufferStatus.SUCCESS
        return buffer


class Camera:
    @staticmethod
    def new(name):
        return Camera(name)

    def __init__(self, name):
        self.is_old, self.is_bare = name.endswith(".gev"), name.endswith(".bare")
        # The numbers of a camera of GigE Vision 1 begin again in between.
        self.sensor = sensor.Sensor(name, 1)
        if self.is_old:
            self.sensor.number += 0xFFFF - 60
            self.sensor.begun -= int((0xFFFF - 60) * 1e9 / sensor.RATE_HZ)

    def is_feature_available(self, name):
        return not self.is_bare and name == ("GevTimestampControlLatch" if self.is_old else "TimestampLatch")

    def execute_command(self, name):
        assert self.is_feature_available(name)
        # A command and its answer over the network; the first one is slow.
        time.sleep(0.00002)
        self.latched = self.sensor.clock(time.monotonic_ns())
        time.sleep(0.00002)

    def get_integer(self, name):
        if name == "GevTimestampTickFrequency":
            return TICKS
        return {"TimestampLatchValue": self.latched, "GevTimestampValue": self.latched * TICKS // 10**9}[name]

    def set_pixel_format_from_string(self, name):
        assert name == "Mono8"

    def is_exposure_auto_available(self):
        return not self.is_old

    def set_exposure_time_auto(self, auto):
        assert auto == Auto.OFF and not self.is_old

    def set_exposure_time(self, exposure_us):
        self.sensor.exposure_ns = int(1000 * exposure_us)

    def get_exposure_time(self):
        return self.sensor.exposure_ns / 1000

    def set_frame_rate(self, rate):
        assert rate == sensor.RATE_HZ

    def get_payload(self):
        return WIDTH * HEIGHT

    def create_stream(self, _callback, _data):
        return Stream(self)

    def start_acquisition(self):
        pass

    def stop_acquisition(self):
        self.sensor.log.close()
