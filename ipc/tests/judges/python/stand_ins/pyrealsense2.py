"""Stands in for pyrealsense2: the calls of realsense_camera.py, with the names and units of 2.59. The serial number is the
path of the sensor's log. Without the metadata where the path ends in `.bare`."""

from enum import Enum

import sensor

stream = Enum("stream", "color infrared")
format = Enum("format", "bgr8 y8")
option = Enum("option", "enable_auto_exposure exposure")
frame_metadata_value = Enum("frame_metadata_value", "frame_timestamp sensor_timestamp actual_exposure")


class config:
    def enable_device(self, serial):
        self.serial = serial

    def enable_stream(self, kind, *shape):
        *index, self.width, self.height, self.format, self.rate = shape
        assert self.format == {stream.color: format.bgr8, stream.infrared: format.y8}[kind]
        assert index == ([] if kind == stream.color else [1])


class Frame:
    def __init__(self, camera, shape):
        self.camera = camera
        self.number, self.middle, self.sent, self.data = camera.frame(*shape)

    def get_frame_number(self):
        return self.number

    def supports_frame_metadata(self, _):
        return not self.camera.log.name.endswith(".bare")

    def get_frame_metadata(self, kind):
        """us, on the camera's clock."""
        values = {
            frame_metadata_value.frame_timestamp: self.camera.clock(self.sent),
            frame_metadata_value.sensor_timestamp: self.camera.clock(self.middle),
            frame_metadata_value.actual_exposure: self.camera.exposure_ns,
        }
        return values[kind] // 1000

    def get_data(self):
        return self.data


class Frames:
    def __init__(self, frame):
        self.frame = frame

    def get_color_frame(self):
        return self.frame

    def get_infrared_frame(self, index=0):
        assert index == 1
        return self.frame


class pipeline:
    def start(self, chosen):
        self.chosen, self.camera = chosen, sensor.Sensor(chosen.serial)
        return self

    def get_device(self):
        return self

    def first_color_sensor(self):
        self.unit_ns = 100_000
        return self

    def first_depth_sensor(self):
        self.unit_ns = 1000
        return self

    def set_option(self, kind, value):
        if kind == option.exposure:
            self.camera.exposure_ns = int(value * self.unit_ns)

    def wait_for_frames(self, timeout_ms=5000):
        channels = 3 if self.chosen.format == format.bgr8 else 1
        return Frames(Frame(self.camera, (self.chosen.width, self.chosen.height, channels)))

    def stop(self):
        self.camera.log.close()
