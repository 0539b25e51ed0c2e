"""What travels: messages, codes and services of the contract, in ctypes.

Generated from the Rust sources, do not edit: VPC_BLESS=1 cargo test -p vpc-client-c
"""

import ctypes
import enum
from typing import NamedTuple

MAX_POINTS = 8


class TwistState(enum.IntEnum):
    """What the controller is about."""

    # No run is under way: start-up or shutdown; the twist is zero.
    STOPPED = 0
    # On the way to the goal.
    MOVING = 1
    # The image error is below the scene's convergence threshold; the controller keeps regulating.
    ARRIVED = 2
    # Features are missing, stale or refused; the twist is zero until good ones come.
    HOLDING = 3
    # Slowing down to zero, at the deceleration of the configuration.
    BRAKING = 4
    # The twist is zero until an operator arms the controller.
    DISARMED = 5

    @property
    def words(self):
        return _WORDS[type(self)][self]


class RobotMode(enum.IntEnum):
    """What the robot does with commands."""

    # It waits for a first valid command.
    IDLE = 0
    # It executes commands.
    MOVING = 1
    # It stopped because the last command is no longer valid.
    STALE = 2
    # It stopped by itself; see the faults.
    FAULT = 3

    @property
    def words(self):
        return _WORDS[type(self)][self]


class ClockMode(enum.IntEnum):
    """What starts a cycle."""

    # An absolute grid in time.
    FIXED = 0
    # Each new features message.
    LOCKSTEP = 1
    # A grid in time that keeps the nominal rate and follows the camera's phase.
    PHASE = 2

    @property
    def words(self):
        return _WORDS[type(self)][self]


class PhaseCode(enum.IntEnum):
    """What the grid of releases has to do with the camera's frames."""

    # Nothing: the clock is another one, or no frames come.
    FREE = 0
    # It is on the way to the camera's phase.
    SEEKING = 1
    # It follows it.
    LOCKED = 2

    @property
    def words(self):
        return _WORDS[type(self)][self]


class Hold(enum.IntEnum):
    """Why a cycle did not send the law's twist."""

    # It did not: the law's twist was sent.
    NONE = 0
    # No features have come yet.
    NO_FEATURES = 1
    # The latest features are older than the stale limit.
    STALE = 2
    # A message was refused on reception: count or numbers.
    INVALID = 3
    # A point was not visible.
    HIDDEN = 4
    # The count of points is not the pattern's.
    COUNT = 5
    # A point is not finite.
    NOT_FINITE = 6
    # A point lies outside the image.
    OFF_IMAGE = 7
    # The shared memory failed.
    TRANSPORT = 8
    # The law gave a twist that is not finite or beyond the limits.
    BAD_TWIST = 9
    # Features came in the wrong order: older than those before, from the same camera.
    ORDER = 10
    # Features bear the time of the future, or the clock jumped.
    CLOCK = 11
    # The solver failed several cycles in a row.
    SOLVER = 12
    # The robot reports a fault or a reflex.
    ROBOT_FAULT = 13
    # The robot's state was coming and fell silent.
    ROBOT_LOST = 14
    # Several releases in a row were missed.
    OVERRUNS = 15
    # Nobody has armed the controller yet.
    NOT_ARMED = 16
    # An operator disarmed or stopped it.
    OPERATOR = 17
    # The daemon is shutting down.
    SHUTDOWN = 18
    # No usable features came for so long that the camera was disarmed.
    LOST = 19
    # The loop itself stood still for that long.
    STANDSTILL = 20
    # Points lie in each other's places (they turn the other way than the pattern, or changed their names), in one
    # place, all on a line, or leap.
    MIXED = 21
    # Not one bit of the features changed, though the camera was commanded to move.
    FROZEN = 22
    # The memory's answers were out of range several cycles in a row.
    RECALL = 23

    @property
    def words(self):
        return _WORDS[type(self)][self]


class SolverStatus(enum.IntEnum):
    """How the solver ended."""

    # It did not run.
    IDLE = 0
    # Optimal to the tolerance, no constraint violated.
    CONVERGED = 1
    # Feasible, but the iterations ran out.
    ITERATION_LIMIT = 2
    # No further decrease.
    STALLED = 3
    # The best plan violates a constraint.
    INFEASIBLE = 4
    # No plan could be computed.
    NUMERICAL_FAILURE = 5

    @property
    def words(self):
        return _WORDS[type(self)][self]


class RecallCode(enum.IntEnum):
    """What the memory had to say."""

    # It was not asked: no features near a border, or a strategy without memory.
    UNASKED = 0
    # Its warm start and way point were followed.
    FOLLOWED = 1
    # Its answer was out of range; the cycle went without.
    REFUSED = 2
    # The law was stalled: the way point is a sample's features, back on a stored trajectory.
    DETOUR = 3

    @property
    def words(self):
        return _WORDS[type(self)][self]


class StrategyCode(enum.IntEnum):
    """Strategy of the law."""

    # Warm start from the previous cycle.
    PREVIOUS = 0
    # k nearest neighbours of the memory.
    KNN = 1
    # Gaussian-process regression over the memory.
    GPR = 2
    # Classic image-based visual servoing.
    IBVS = 3

    @property
    def words(self):
        return _WORDS[type(self)][self]


class Action(enum.IntEnum):
    """What an operator asks for."""

    # Nothing: the answer tells the state.
    STATUS = 0
    # Let the law move the camera, from the next good features on.
    ARM = 1
    # Brake to zero, and stay there until the next `arm`.
    DISARM = 2
    # Zero at once, without braking, and stay there until the next `arm`.
    STOP = 3
    # Change the strategy of the law.
    STRATEGY = 4
    # Write out the flight record.
    RECORD = 5

    @property
    def words(self):
        return _WORDS[type(self)][self]


class Outcome(enum.IntEnum):
    """What became of a request."""

    # Done, or already so.
    DONE = 0
    # Refused: no good features are coming, so that nothing could be controlled.
    NO_FEATURES = 1
    # Refused: the robot reports a fault, or was heard and fell silent.
    ROBOT = 2
    # Refused: the camera still brakes; ask again when it stands.
    BRAKING = 3
    # Refused: the controller's memory of motion lacks what the strategy needs, or there is no memory.
    NO_MEMORY = 4
    # Refused: neighbours out of range (knn: 1 to 64; other strategies: 0).
    NEIGHBOURS = 5
    # Refused: the controller is shutting down.
    SHUTDOWN = 6
    # Refused: the controller keeps no flight record.
    NO_RECORD = 7
    # Refused: the code of the action or of the strategy is none of the contract's.
    UNKNOWN = 8

    @property
    def words(self):
        return _WORDS[type(self)][self]


class RobotFaults(enum.IntFlag):
    # A command was not valid in time.
    STALE_COMMAND = 1
    # A command was outside the limits and was cut.
    COMMAND_LIMITED = 2
    # The robot's own reflex stopped it (Panda: a discontinuity or a limit of a joint).
    REFLEX = 4
    # A joint is at the limit of its range.
    JOINT_LIMIT = 8
    # The pattern left the image or went behind the camera.
    PATTERN_LOST = 16


class RealTime(enum.IntFlag):
    # Real time was asked for.
    ASKED = 1
    # ... and the thread has no SCHED_FIFO.
    NO_FIFO = 2
    # ... and the thread is not on its processor.
    NO_CPU = 4
    # ... and memory is not locked.
    NO_LOCK = 8


_WORDS = {
    TwistState: (
        "stopped",
        "moving",
        "arrived",
        "holding",
        "braking",
        "disarmed",
    ),
    RobotMode: (
        "idle",
        "moving",
        "stale",
        "fault",
    ),
    ClockMode: (
        "fixed",
        "lockstep",
        "phase",
    ),
    PhaseCode: (
        "free",
        "seeking",
        "locked",
    ),
    Hold: (
        "none",
        "no features",
        "stale features",
        "invalid message",
        "hidden point",
        "wrong count",
        "not finite",
        "off image",
        "transport",
        "bad twist",
        "features out of order",
        "clock anomaly",
        "solver failure",
        "robot fault",
        "robot silent",
        "overruns",
        "not armed",
        "operator",
        "shutdown",
        "features lost",
        "standstill of the loop",
        "points mixed up",
        "frozen image",
        "recall out of range",
    ),
    SolverStatus: (
        "idle",
        "converged",
        "iteration limit",
        "stalled",
        "infeasible",
        "numerical failure",
    ),
    RecallCode: (
        "not asked",
        "followed",
        "out of range",
        "detour",
    ),
    StrategyCode: (
        "previous",
        "knn",
        "gpr",
        "ibvs",
    ),
    Action: (
        "status",
        "arm",
        "disarm",
        "stop",
        "strategy",
        "record",
    ),
    Outcome: (
        "done",
        "refused: no good features are coming",
        "refused: the robot is not ready",
        "refused: still braking",
        "refused: no memory of motion for this strategy",
        "refused: neighbours out of range",
        "refused: shutting down",
        "refused: no flight record is kept",
        "refused: no such action or strategy",
    ),
}


class Stamp(ctypes.Structure):
    """Head of every message."""

    _fields_ = [
        # Number of the message, from 1, by one more for each message of one publisher; a publisher that restarts
        # starts from 1 again.
        ("sequence", ctypes.c_uint64),
        # When the message was published, CLOCK_MONOTONIC, ns.
        ("published_ns", ctypes.c_uint64),
        # The instant that the data describe, CLOCK_MONOTONIC, ns: for features the middle of the exposure.
        ("data_ns", ctypes.c_uint64),
    ]

    @staticmethod
    def type_name():
        return "vpc/Stamp/1"


class Features(ctypes.Structure):
    """Image features of one frame; service `vpc/features`."""

    _fields_ = [
        # Head; `data_ns` is the middle of the exposure.
        ("stamp", Stamp),
        # Length of the exposure, ns; 0 where unknown.
        ("exposure_ns", ctypes.c_uint64),
        # Points in this message, 1 to 8, in the order of the pattern.
        ("count", ctypes.c_uint32),
        # Bit i is set where point i was measured in this frame; a point that was not carries the tracker's guess.
        ("visible", ctypes.c_uint32),
        # Image points u1 v1 u2 v2 ..., px; u to the right, v down, origin at the centre of the upper left pixel. The first
        # `2 * count` are finite; the rest is zero.
        ("points", ctypes.c_double * 16),
    ]

    @staticmethod
    def type_name():
        return "vpc/Features/1"


class TwistCommand(ctypes.Structure):
    """Camera velocity command; service `vpc/twist`.
    
    Whoever executes it stops when it is no longer valid: a silent controller never leaves its last command standing."""

    _fields_ = [
        # Head; `data_ns` is that of the features it answers.
        ("stamp", Stamp),
        # Sequence number of the features it answers; 0 where it answers none.
        ("features_sequence", ctypes.c_uint64),
        # `published_ns` of the features it answers, which tells a restarted camera's message from its predecessor's.
        ("features_published_ns", ctypes.c_uint64),
        # The command holds until this instant, CLOCK_MONOTONIC, ns; afterwards the camera must stop. `u64::MAX` in
        # lockstep, where time does not pass between frames.
        ("valid_until_ns", ctypes.c_uint64),
        # A `TwistState` code.
        ("state", ctypes.c_uint32),
        # Zero.
        ("reserved", ctypes.c_uint32),
        # Velocity of the camera in the camera frame (x right, y down, z forward): vx vy vz in m/s, wx wy wz in rad/s;
        # finite, inside the scene's limits.
        ("twist", ctypes.c_double * 6),
    ]

    @staticmethod
    def type_name():
        return "vpc/TwistCommand/1"


class RobotState(ctypes.Structure):
    """State of the robot that carries the camera, at the instant `stamp.data_ns`; service `vpc/robot`."""

    _fields_ = [
        # Head.
        ("stamp", Stamp),
        # Sequence number of the features exposed at this instant; 0 where none were.
        ("features_sequence", ctypes.c_uint64),
        # A `RobotMode` code.
        ("mode", ctypes.c_uint32),
        # Bits of `RobotFaults`.
        ("faults", ctypes.c_uint32),
        # Object in the camera frame: translation, m.
        ("translation", ctypes.c_double * 3),
        # Object in the camera frame: rotation vector (axis times angle), rad.
        ("rotation", ctypes.c_double * 3),
        # Camera velocity in the camera frame as it is carried out: vx vy vz in m/s, wx wy wz in rad/s.
        ("twist", ctypes.c_double * 6),
        # Joints in `q` and `dq`, 0 for a free-flying camera, 7 for a Panda.
        ("joints", ctypes.c_uint32),
        # Zero.
        ("reserved", ctypes.c_uint32),
        # Joint positions, base to flange, rad.
        ("q", ctypes.c_double * 7),
        # Joint velocities, base to flange, rad/s.
        ("dq", ctypes.c_double * 7),
        # Zero; room for what a real arm will want to say.
        ("room", ctypes.c_double * 8),
    ]

    @staticmethod
    def type_name():
        return "vpc/RobotState/1"


class CycleRecord(ctypes.Structure):
    """Telemetry of one cycle; service `vpc/cycles`. Numbers of the law are NaN where it did not run."""

    _fields_ = [
        # Head; `data_ns` is when the cycle woke up.
        ("stamp", Stamp),
        # Number of the cycle, from 1.
        ("cycle", ctypes.c_uint64),
        # A `ClockMode` code.
        ("clock", ctypes.c_uint32),
        # A `SolverStatus` code.
        ("status", ctypes.c_uint32),
        # Wake-up after the release, ns; 0 in lockstep.
        ("wake_latency_ns", ctypes.c_uint64),
        # Time taken by receiving and the gate, ns.
        ("receive_ns", ctypes.c_uint64),
        # Time taken by the law, ns.
        ("step_ns", ctypes.c_uint64),
        # Time taken by sending, ns.
        ("send_ns", ctypes.c_uint64),
        # Releases missed since the start.
        ("overruns", ctypes.c_uint64),
        # Sequence number of the features used; 0 where none were.
        ("features_sequence", ctypes.c_uint64),
        # Age of the features used when the cycle woke up, from the middle of the exposure, ns.
        ("features_age_ns", ctypes.c_uint64),
        # Records lost since the start because the recorder was slower than the loop.
        ("lost_records", ctypes.c_uint64),
        # Points in `points`, 0 to 8.
        ("count", ctypes.c_uint32),
        # Points in `way_point`: 0 where the goal is tracked.
        ("way_point_count", ctypes.c_uint32),
        # A `RecallCode`.
        ("recalled", ctypes.c_uint32),
        # A `StrategyCode`.
        ("strategy", ctypes.c_uint32),
        # Neighbours averaged by k-NN; 0 for other strategies.
        ("neighbours", ctypes.c_uint32),
        # Steps previewed.
        ("np", ctypes.c_uint32),
        # Iterations of the solver.
        ("iterations", ctypes.c_uint32),
        # Active-set changes in its quadratic programs.
        ("qp_iterations", ctypes.c_uint32),
        # A `Hold` code.
        ("hold", ctypes.c_uint32),
        # A `TwistState` code.
        ("state", ctypes.c_uint32),
        # Features used, u1 v1 u2 v2 ..., px.
        ("points", ctypes.c_double * 16),
        # Way point tracked instead of the goal, u1 v1 u2 v2 ..., px.
        ("way_point", ctypes.c_double * 16),
        # Camera twist that was sent, camera frame, m/s and rad/s.
        ("twist", ctypes.c_double * 6),
        # The paper's running cost of the command that was sent.
        ("cost", ctypes.c_double),
        # Worst violation predicted over the window, px.
        ("violation_px", ctypes.c_double),
        # Least clearance of a feature from an occlusion, px; infinite in a scene without any.
        ("clearance_px", ctypes.c_double),
        # Largest component of s - s*, px.
        ("error_px", ctypes.c_double),
        # `RealTime` bits.
        ("realtime", ctypes.c_uint32),
        # A `PhaseCode`.
        ("phase", ctypes.c_uint32),
        # This release after the one that the camera's phase asks for, ns; 0 while the grid is free.
        ("phase_error_ns", ctypes.c_int64),
        # Page faults of the loop's thread from wake to send that were served without a disk.
        ("minor_faults", ctypes.c_uint32),
        # ... that waited for a disk.
        ("major_faults", ctypes.c_uint32),
        # Times that the loop's thread gave up its processor from wake to send, because a call blocked.
        ("blocked", ctypes.c_uint32),
        # Calls of the heap by the loop's thread from wake to send, where the allocator counts them.
        ("allocations", ctypes.c_uint32),
        # Zero: room to grow.
        ("room", ctypes.c_uint64 * 4),
    ]

    @staticmethod
    def type_name():
        return "vpc/CycleRecord/2"


class Request(ctypes.Structure):
    """An operator's request; service `vpc/requests`. Several operators may be at work."""

    _fields_ = [
        # Head; `data_ns` is zero.
        ("stamp", Stamp),
        # Chosen by the operator, so that the answer can be told from those to others.
        ("id", ctypes.c_uint64),
        # An `Action` code.
        ("action", ctypes.c_uint32),
        # For `strategy`: a `StrategyCode`; else zero.
        ("strategy", ctypes.c_uint32),
        # For `strategy` knn: neighbours averaged, 1 to 64; else zero.
        ("neighbours", ctypes.c_uint32),
        # Zero.
        ("reserved", ctypes.c_uint32),
    ]

    @staticmethod
    def type_name():
        return "vpc/Request/1"


class Reply(ctypes.Structure):
    """The controller's answer to a request; service `vpc/replies`."""

    _fields_ = [
        # Head; `data_ns` is the publication of the request.
        ("stamp", Stamp),
        # The request's.
        ("id", ctypes.c_uint64),
        # The request's `Action` code; zero where that is unknown.
        ("action", ctypes.c_uint32),
        # An `Outcome` code.
        ("outcome", ctypes.c_uint32),
        # A `TwistState` code: the state after the request.
        ("state", ctypes.c_uint32),
        # A `Hold` code: the cause of that state.
        ("hold", ctypes.c_uint32),
        # A `StrategyCode`: the strategy after the request.
        ("strategy", ctypes.c_uint32),
        # Its neighbours (knn), else zero.
        ("neighbours", ctypes.c_uint32),
    ]

    @staticmethod
    def type_name():
        return "vpc/Reply/1"


for _message, _size in (
    (Stamp, 24),
    (Features, 168),
    (TwistCommand, 104),
    (RobotState, 320),
    (CycleRecord, 544),
    (Request, 48),
    (Reply, 56),
):
    if ctypes.sizeof(_message) != _size:
        raise ImportError(f"{_message.__name__}: {ctypes.sizeof(_message)} bytes; allowed: {_size}")


class Service(NamedTuple):
    """A service and its queues; the same for everybody who opens it."""

    message: type
    history: int
    buffer: int
    subscribers: int
    publishers: int


SERVICES = {
    "vpc/features": Service(Features, 1, 64, 8, 1),
    "vpc/twist": Service(TwistCommand, 0, 64, 8, 1),
    "vpc/robot": Service(RobotState, 1, 64, 8, 1),
    "vpc/cycles": Service(CycleRecord, 0, 1024, 8, 1),
    "vpc/requests": Service(Request, 0, 16, 4, 8),
    "vpc/replies": Service(Reply, 0, 64, 16, 1),
}
