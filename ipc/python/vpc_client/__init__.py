"""The shared-memory contract of vpcd for Python; README.md beside this package is the page to begin with.

    with vpc_client.Domain() as domain, domain.operator() as operator:
        operator.arm()
        for cycle in domain.subscribe("vpc/cycles").messages(seconds=5):
            print(cycle.state, cycle.step_ns)
"""

from .domain import Domain, default_directory
from .errors import BadMessage, NoAnswer, OtherContract, Refused, Taken, VpcError
from .messages import (
    MAX_POINTS,
    SERVICES,
    Action,
    ClockMode,
    CycleFlags,
    CycleRecord,
    Features,
    Hold,
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

__all__ = [name for name in dir() if name[0].isupper()] + ["default_directory", "now_ns"]
