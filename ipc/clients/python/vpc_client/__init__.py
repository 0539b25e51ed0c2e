"""The shared-memory contract of vpcd for Python; README.md beside this package is the page to begin with.

    with vpc_client.Domain() as domain:
        for cycle in domain.subscribe("vpc/cycles").messages(seconds=5):
            print(vpc_client.Hold(cycle.hold).words, cycle.step_ns)
"""

from .dead_man import in_force_until_ns, twist_in_force
from .domain import Domain, default_directory
from .errors import BadArgument, BadDomain, BadMessage, NoAnswer, OtherContract, Refused, Taken, VpcError
from .images import Image, ImagePublisher, ImageSubscriber, LoanedImage
from .messages import (
    MAX_POINTS,
    SERVICES,
    Action,
    ClockMode,
    CycleFlags,
    CycleRecord,
    DesiredTwist,
    Encoding,
    Features,
    Hold,
    ImageHeader,
    InputCode,
    Outcome,
    PhaseCode,
    RealTime,
    RecallCode,
    Reply,
    Request,
    RobotFaults,
    RobotMode,
    RobotState,
    Snapshot,
    SolverStatus,
    Stamp,
    StrategyCode,
    TwistCommand,
    TwistState,
)
from .ports import CameraPorts, OperatorPorts, Publisher, Sent, Subscriber, now_ns
from .stop import stop

__version__ = "0.1.0"

__all__ = [
    "MAX_POINTS",
    "SERVICES",
    "Action",
    "BadArgument",
    "BadDomain",
    "BadMessage",
    "CameraPorts",
    "ClockMode",
    "CycleFlags",
    "CycleRecord",
    "DesiredTwist",
    "Domain",
    "Encoding",
    "Features",
    "Hold",
    "Image",
    "ImageHeader",
    "ImagePublisher",
    "ImageSubscriber",
    "InputCode",
    "LoanedImage",
    "NoAnswer",
    "OperatorPorts",
    "OtherContract",
    "Outcome",
    "PhaseCode",
    "Publisher",
    "RealTime",
    "RecallCode",
    "Refused",
    "Reply",
    "Request",
    "RobotFaults",
    "RobotMode",
    "RobotState",
    "Sent",
    "Snapshot",
    "SolverStatus",
    "Stamp",
    "StrategyCode",
    "Subscriber",
    "Taken",
    "TwistCommand",
    "TwistState",
    "VpcError",
    "default_directory",
    "in_force_until_ns",
    "now_ns",
    "stop",
    "twist_in_force",
]
