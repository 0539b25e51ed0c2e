"""The contract of CONTRACT.md in Python: message types, the guard of a domain, the services.

Needs the wheel `iceoryx2==0.9.3`, the same version as the daemon's. `camera.py` beside this file is the example.
"""

import ctypes
import fcntl
import os
import shutil
import time

import iceoryx2 as iox2

MAX_POINTS = 8
STATES = ("stopped", "moving", "arrived", "holding", "braking", "disarmed")
STOPPED, MOVING, ARRIVED, HOLDING, BRAKING, DISARMED = range(6)
ACTIONS = ("status", "arm", "disarm", "stop", "strategy", "record")
STRATEGIES = ("previous", "knn", "gpr", "ibvs")
OUTCOMES = (
    "done",
    "refused: no good features are coming",
    "refused: the robot is not ready",
    "refused: still braking",
    "refused: no memory of motion for this strategy",
    "refused: neighbours out of range",
    "refused: shutting down",
    "refused: no flight record is kept",
)
PATIENCE_S = 10.0


class Stamp(ctypes.Structure):
    """Head of every message: sequence number from 1, and CLOCK_MONOTONIC in ns."""

    _fields_ = [
        ("sequence", ctypes.c_uint64),
        ("published_ns", ctypes.c_uint64),
        ("data_ns", ctypes.c_uint64),
    ]

    @staticmethod
    def type_name():
        return "vpc/Stamp/1"


class Features(ctypes.Structure):
    """Image points in px; service vpc/features."""

    _fields_ = [
        ("stamp", Stamp),
        ("exposure_ns", ctypes.c_uint64),
        ("count", ctypes.c_uint32),
        ("visible", ctypes.c_uint32),
        ("points", ctypes.c_double * (2 * MAX_POINTS)),
    ]

    @staticmethod
    def type_name():
        return "vpc/Features/1"


class TwistCommand(ctypes.Structure):
    """Camera velocity in the camera frame, m/s and rad/s; service vpc/twist."""

    _fields_ = [
        ("stamp", Stamp),
        ("features_sequence", ctypes.c_uint64),
        ("features_published_ns", ctypes.c_uint64),
        ("valid_until_ns", ctypes.c_uint64),
        ("state", ctypes.c_uint32),
        ("reserved", ctypes.c_uint32),
        ("twist", ctypes.c_double * 6),
    ]

    @staticmethod
    def type_name():
        return "vpc/TwistCommand/1"


class RobotState(ctypes.Structure):
    """Object in the camera frame and what the robot does; service vpc/robot."""

    _fields_ = [
        ("stamp", Stamp),
        ("features_sequence", ctypes.c_uint64),
        ("mode", ctypes.c_uint32),
        ("faults", ctypes.c_uint32),
        ("translation", ctypes.c_double * 3),
        ("rotation", ctypes.c_double * 3),
        ("twist", ctypes.c_double * 6),
        ("joints", ctypes.c_uint32),
        ("reserved", ctypes.c_uint32),
        ("q", ctypes.c_double * 7),
        ("dq", ctypes.c_double * 7),
        ("room", ctypes.c_double * 8),
    ]

    @staticmethod
    def type_name():
        return "vpc/RobotState/1"


class CycleRecord(ctypes.Structure):
    """Telemetry of one cycle; service vpc/cycles."""

    _fields_ = (
        [("stamp", Stamp), ("cycle", ctypes.c_uint64)]
        + [(name, ctypes.c_uint32) for name in ("clock", "status")]
        + [
            (name, ctypes.c_uint64)
            for name in (
                "wake_latency_ns",
                "receive_ns",
                "step_ns",
                "send_ns",
                "overruns",
                "features_sequence",
                "features_age_ns",
                "lost_records",
            )
        ]
        + [
            (name, ctypes.c_uint32)
            for name in (
                "count",
                "way_point_count",
                "recalled",
                "strategy",
                "neighbours",
                "np",
                "iterations",
                "qp_iterations",
                "hold",
                "state",
            )
        ]
        + [
            ("points", ctypes.c_double * (2 * MAX_POINTS)),
            ("way_point", ctypes.c_double * (2 * MAX_POINTS)),
            ("twist", ctypes.c_double * 6),
        ]
        + [(name, ctypes.c_double) for name in ("cost", "violation_px", "clearance_px", "error_px")]
        + [("realtime", ctypes.c_uint32), ("phase", ctypes.c_uint32), ("phase_error_ns", ctypes.c_int64)]
        + [
            (name, ctypes.c_uint32)
            for name in ("minor_faults", "major_faults", "blocked", "allocations")
        ]
        + [("room", ctypes.c_uint64 * 4)]
    )

    @staticmethod
    def type_name():
        return "vpc/CycleRecord/2"


class Request(ctypes.Structure):
    """What an operator asks of the controller; service vpc/requests."""

    _fields_ = [("stamp", Stamp), ("id", ctypes.c_uint64)] + [
        (name, ctypes.c_uint32) for name in ("action", "strategy", "neighbours", "reserved")
    ]

    @staticmethod
    def type_name():
        return "vpc/Request/1"


class Reply(ctypes.Structure):
    """The controller's answer; service vpc/replies."""

    _fields_ = [("stamp", Stamp), ("id", ctypes.c_uint64)] + [
        (name, ctypes.c_uint32)
        for name in ("action", "outcome", "state", "hold", "strategy", "neighbours")
    ]

    @staticmethod
    def type_name():
        return "vpc/Reply/1"


for _message, _size in (
    (Features, 168),
    (TwistCommand, 104),
    (RobotState, 320),
    (CycleRecord, 544),
    (Request, 48),
    (Reply, 56),
):
    if ctypes.sizeof(_message) != _size:
        raise ImportError(f"{_message.__name__}: {ctypes.sizeof(_message)} bytes; allowed: {_size}")

# Service: message, history, buffer, subscribers, publishers.
SERVICES = {
    "vpc/features": (Features, 1, 64, 8, 1),
    "vpc/twist": (TwistCommand, 0, 64, 8, 1),
    "vpc/robot": (RobotState, 1, 64, 8, 1),
    "vpc/cycles": (CycleRecord, 0, 1024, 8, 1),
    "vpc/requests": (Request, 0, 16, 4, 8),
    "vpc/replies": (Reply, 0, 64, 16, 1),
}


def default_directory():
    return f"/tmp/vpc-{os.geteuid()}"


def now_ns():
    return time.clock_gettime_ns(time.CLOCK_MONOTONIC)


class Domain:
    """Membership of a domain, with the guard of CONTRACT.md; keep it for as long as its ports are in use."""

    def __init__(self, directory):
        os.makedirs(directory, mode=0o700, exist_ok=True)
        if os.path.islink(directory) or os.stat(directory).st_uid != os.geteuid():
            raise PermissionError(f"domain {directory}: allowed: a directory (no link) of our own")
        self.directory = os.path.realpath(directory)
        self._startup = self._open("startup")
        self._member = self._open("lock")
        self.start_up(self._join)

    def _open(self, name):
        return os.open(os.path.join(self.directory, name), os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)

    def start_up(self, action):
        """Runs `action` while nobody else joins, leaves or opens a port."""
        end = time.monotonic() + PATIENCE_S
        while True:
            try:
                fcntl.flock(self._startup, fcntl.LOCK_EX | fcntl.LOCK_NB)
                break
            except BlockingIOError:
                if time.monotonic() > end:
                    raise TimeoutError(f"domain {self.directory}: another process is joining or leaving") from None
                time.sleep(0.001)
        try:
            return action()
        finally:
            fcntl.flock(self._startup, fcntl.LOCK_UN)

    def _join(self):
        prefix = self._prefix()
        try:
            fcntl.flock(self._member, fcntl.LOCK_EX | fcntl.LOCK_NB)
            # Alone: clear away what the dead left.
            shutil.rmtree(os.path.join(self.directory, "iox2"), ignore_errors=True)
            for name in os.listdir("/dev/shm"):
                if name.startswith(prefix):
                    os.unlink(os.path.join("/dev/shm", name))
        except BlockingIOError:
            pass
        fcntl.flock(self._member, fcntl.LOCK_SH | fcntl.LOCK_NB)
        self._remove_unborn(prefix)

        iox2.set_log_level(iox2.LogLevel.Error)
        config = iox2.config.default()
        config.global_cfg.root_path = iox2.Path.new(os.path.join(self.directory, "iox2"))
        config.global_cfg.prefix = iox2.FileName.new(prefix)
        config.global_cfg.node.cleanup_dead_nodes_on_destruction = False
        self.node = (
            iox2.NodeBuilder.new()
            .config(config)
            .signal_handling_mode(iox2.SignalHandlingMode.Disabled)
            .create(iox2.ServiceType.Ipc)
        )
        self.services = {
            name: self.node.service_builder(iox2.ServiceName.new(name))
            .publish_subscribe(message)
            .max_publishers(publishers)
            .max_subscribers(subscribers)
            .max_nodes(32)
            .history_size(history)
            .subscriber_max_buffer_size(buffer)
            .subscriber_max_borrowed_samples(1)
            .enable_safe_overflow(True)
            .open_or_create()
            for name, (message, history, buffer, subscribers, publishers) in SERVICES.items()
        }

    @staticmethod
    def _remove_unborn(prefix):
        """Removes shared memory that a killed process created and never gave a size: iceoryx2 would wait for it."""

        def empty():
            for entry in os.scandir("/dev/shm"):
                try:
                    if entry.name.startswith(prefix) and entry.stat().st_size == 0:
                        yield entry
                except FileNotFoundError:
                    pass

        for _ in range(120):
            young = False
            for entry in list(empty()):
                if time.time() - entry.stat().st_mtime >= 0.3:
                    os.unlink(entry.path)
                else:
                    young = True
            if not young:
                return
            time.sleep(0.005)

    def _prefix(self):
        value = 0xCBF29CE484222325
        for byte in os.fsencode(self.directory):
            value = ((value ^ byte) * 0x100000001B3) % 2**64
        return f"vpc_{value:016x}_"

    def publisher(self, name):
        return self.start_up(lambda: self.services[name].publisher_builder().create())

    def subscriber(self, name, buffer):
        return self.start_up(lambda: self.services[name].subscriber_builder().buffer_size(buffer).create())


class CameraPorts:
    """Publishes features, receives twists."""

    def __init__(self, domain):
        # The subscriber first: no answer may be missed.
        self._twist = domain.subscriber("vpc/twist", 4)
        self._features = domain.publisher("vpc/features")
        self._sequence = 0

    def publish(self, points, data_ns=None, exposure_ns=0, visible=None):
        """Publishes points [(u, v), ...] in px; returns (sequence, published_ns).

        `data_ns` is the middle of the exposure [now], `exposure_ns` its length, 0 where unknown; bit i of `visible` tells
        whether point i was measured [all]."""
        self._sequence += 1
        message = Features()
        message.stamp.sequence = self._sequence
        message.stamp.published_ns = now_ns()
        message.stamp.data_ns = message.stamp.published_ns if data_ns is None else data_ns
        message.count = len(points)
        message.exposure_ns = exposure_ns
        message.visible = (1 << len(points)) - 1 if visible is None else visible
        for i, (u, v) in enumerate(points):
            message.points[2 * i], message.points[2 * i + 1] = u, v
        self._features.send_copy(message)
        return message.stamp.sequence, message.stamp.published_ns

    def wait_for_answer(self, sent, patience_s=PATIENCE_S):
        """The twist that answers the features `sent`, as a list of six numbers, and the state."""
        end = time.monotonic() + patience_s
        while True:
            sample = self._twist.receive()
            if sample is not None:
                # A copy: the sample goes back to shared memory when it is dropped.
                command = TwistCommand.from_buffer_copy(sample.payload().contents)
                del sample
                if (command.features_sequence, command.features_published_ns) == sent:
                    return list(command.twist), command.state
                continue
            if time.monotonic() > end:
                raise TimeoutError(f"no answer to features {sent[0]} within {patience_s} s; does vpcd run?")
            # A controller that comes late gets the message by the history of the service.
            self._features.update_connections()
            time.sleep(20e-6)


class OperatorPorts:
    """Asks the controller: arm, disarm, stop, another strategy, status."""

    def __init__(self, domain):
        self._replies = domain.subscriber("vpc/replies", 64)
        self._requests = domain.publisher("vpc/requests")
        self._sequence = 0

    def ask(self, action, strategy=None, neighbours=0, patience_s=1.0):
        """Sends a request (a name of ACTIONS; for "strategy" a name of STRATEGIES) and returns the Reply to it."""
        self._sequence += 1
        message = Request()
        message.stamp.sequence, message.stamp.published_ns = self._sequence, now_ns()
        message.id = int.from_bytes(os.urandom(8), "little")
        message.action = ACTIONS.index(action)
        message.strategy = 0 if strategy is None else STRATEGIES.index(strategy)
        message.neighbours = neighbours
        self._requests.send_copy(message)
        end = time.monotonic() + patience_s
        while time.monotonic() < end:
            sample = self._replies.receive()
            if sample is not None:
                reply = Reply.from_buffer_copy(sample.payload().contents)
                del sample
                if reply.id == message.id:
                    return reply
                continue
            self._requests.update_connections()
            time.sleep(1e-3)
        raise TimeoutError(f"no reply to {action} within {patience_s} s; does vpcd run?")
