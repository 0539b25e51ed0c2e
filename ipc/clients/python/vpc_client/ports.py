"""Ports: publishers and subscribers of one service, and those of a camera and an operator."""

from __future__ import annotations

import fcntl
import math
import numbers
import os
import time
import weakref
from collections.abc import Iterable, Iterator
from types import TracebackType
from typing import TYPE_CHECKING, Any, Generic, NamedTuple, TypeVar, cast

from .errors import BadArgument, BadMessage, NoAnswer, Refused
from .messages import (
    CHECKS,
    MAX_POINTS,
    SERVICES,
    Action,
    Features,
    Hold,
    Outcome,
    Reply,
    Request,
    StrategyCode,
    TwistCommand,
    TwistState,
)

if TYPE_CHECKING:
    from .domain import Domain

# How long a lockstep camera waits for an answer.
PATIENCE_S = 10.0
# Sleep between two looks for an answer: of a lockstep camera, of everybody else.
POLL_S = 20e-6
SLOW_POLL_S = 1e-3


def check(service: str, message: Any, sequenced: bool = True) -> None:
    """Raises BadMessage where a message breaks the contract; one that is not `sequenced` has no number yet."""
    kind = type(message)
    if sequenced and message.stamp.sequence == 0:
        raise BadMessage(f"{service}: sequence = 0; allowed: 1 and more")
    for field, rule in CHECKS[kind].items():
        value = getattr(message, field)
        if isinstance(rule, tuple):
            least, most = rule
            if not least <= value <= most:
                raise BadMessage(f"{service}: {field} = {value}; allowed: {least} to {most}")
        elif isinstance(value, float):
            if not math.isfinite(value):
                raise BadMessage(f"{service}: {field} = {value}; allowed: finite numbers")
        elif isinstance(rule, str):
            used = 2 * getattr(message, rule) if rule else len(value)
            for i in range(used):
                if not math.isfinite(value[i]):
                    raise BadMessage(f"{service}: {field}[{i}] = {value[i]}; allowed: finite numbers")
        elif not rule.knows(value):
            allowed = ", ".join(f"{int(code)} {code.words}" for code in rule)
            raise BadMessage(f"{service}: {field} = {value}; allowed: {allowed}")


def now_ns() -> int:
    """CLOCK_MONOTONIC, the clock of all stamps."""
    return time.clock_gettime_ns(time.CLOCK_MONOTONIC)


class Sent(NamedTuple):
    """What the answer to a message bears."""

    sequence: int
    published_ns: int


S = TypeVar("S", bound="_Closes")
M = TypeVar("M")


class _Closes:
    """Closes at the end of a `with`."""

    def __enter__(self: S) -> S:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        raise NotImplementedError


class Port(_Closes):
    """A publisher or subscriber of one service."""

    def __init__(self, service: str, port: Any) -> None:
        self.service = service
        # A port keeps its domain.
        self.domain: Domain | None = None
        self._open: Any = port

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.service!r}{', closed' if self._open is None else ''})"

    @property
    def _port(self) -> Any:
        if self._open is None:
            raise BadArgument(f"{self.service}: this port was closed; allowed: open ports")
        return self._open

    def close(self) -> None:
        """Closes the port; the second time it does nothing."""
        if self._open is not None:
            self._delete()
            self._open = None

    def _delete(self) -> None:
        self._open.delete()


def free(place: int, process: int) -> None:
    """Frees a publisher's place. Forked children hold the same file: closing ours would not do, and theirs must not free
    our place."""
    if os.getpid() == process:
        fcntl.flock(place, fcntl.LOCK_UN)
    os.close(place)


class PublishingPort(Port):
    """A publisher of one service, with its place among them."""

    sequence = 0

    def __init__(self, service: str, port: Any, place: int) -> None:
        super().__init__(service, port)
        # Also for one that nobody closes. At the end of the process the kernel does it, after the port is gone.
        self._free_place = weakref.finalize(self, free, place, os.getpid())
        self._free_place.atexit = False

    def close(self) -> None:
        """Closes the port and frees its place; the second time it does nothing."""
        if self._open is not None:
            super().close()
            self._free_place()

    def refresh(self) -> None:
        """Connects to subscribers that came since, and hands them the history of the service. Publishing does it, too;
        call it while you wait for an answer."""
        self._port.update_connections()

    def restart(self) -> None:
        """Counts from 1 again: for features, a new run."""
        self.sequence = 0


class Publisher(PublishingPort, Generic[M]):
    """Publishes the messages of one service."""

    def publish(self, message: M) -> Sent:
        """Publishes a copy under the next sequence number.

        `published_ns` 0 becomes the present time; other values stand (simulated time in lockstep)."""
        kind = SERVICES[self.service].message
        if not isinstance(message, kind):
            raise BadMessage(f"{self.service}: a {type(message).__name__}; allowed: {kind.__name__}")
        stamped: Any = kind.from_buffer_copy(message)
        stamped.stamp.sequence = self.sequence + 1
        stamped.stamp.published_ns = stamped.stamp.published_ns or now_ns()
        check(self.service, stamped)
        self._port.send_copy(stamped)
        self.sequence += 1
        return Sent(stamped.stamp.sequence, stamped.stamp.published_ns)


class Subscriber(Port, Generic[M]):
    """Receives the messages of one service."""

    def receive(self) -> M | None:
        """The oldest message that waits, as a copy; None where there is none.

        Raises BadMessage where it breaks the contract; the next one may be good."""
        sample = self._port.receive()
        if sample is None:
            return None
        message: Any = SERVICES[self.service].message.from_buffer_copy(sample.payload().contents)
        # Back to shared memory: one sample may be borrowed at a time.
        del sample
        check(self.service, message)
        return cast("M", message)

    def latest(self) -> M | None:
        """The newest message since the last call, None where there is none; those before it are thrown away."""
        newest = None
        for _ in range(SERVICES[self.service].buffer + 1):
            message = self.receive()
            if message is None:
                break
            newest = message
        return newest

    def messages(
        self, seconds: float | None = None, count: int | None = None, poll_s: float = SLOW_POLL_S
    ) -> Iterator[M]:
        """Every message as it comes, for so many seconds or messages [for ever]."""
        end = math.inf if seconds is None else time.monotonic() + seconds
        left = math.inf if count is None else count
        while left > 0:
            message = self.receive()
            if message is not None:
                left -= 1
                yield message
            elif time.monotonic() >= end:
                return
            else:
                time.sleep(poll_s)

    def __iter__(self) -> Iterator[M]:
        return self.messages()


class CameraPorts(_Closes):
    """Publishes features, receives twists."""

    def __init__(self, twist: Subscriber[TwistCommand], features: Publisher[Features]) -> None:
        self.twist, self.features = twist, features

    def __repr__(self) -> str:
        return f"CameraPorts({self.twist!r}, {self.features!r})"

    def close(self) -> None:
        """Closes the ports; the second time it does nothing."""
        self.twist.close()
        self.features.close()

    def publish_features(
        self,
        points: Iterable[Iterable[float]],
        data_ns: int | None = None,
        exposure_ns: int = 0,
        visible: int | None = None,
        published_ns: int = 0,
    ) -> Sent:
        """Publishes points [(u, v), ...] in px, or an array of shape (N, 2).

        `data_ns` is the middle of the exposure [as published], `exposure_ns` its length, 0 where unknown; bit i of
        `visible` is set where point i was measured [all]; `published_ns` is for simulated time [now]."""
        pairs = _pairs(points)
        message = Features()
        stamp = message.stamp
        stamp.published_ns = unsigned("published_ns", published_ns) or now_ns()
        stamp.data_ns = stamp.published_ns if data_ns is None else unsigned("data_ns", data_ns)
        message.count = len(pairs)
        message.exposure_ns = unsigned("exposure_ns", exposure_ns)
        all_bits = (1 << len(pairs)) - 1
        message.visible = all_bits if visible is None else unsigned("visible", visible, all_bits)
        for i, (u, v) in enumerate(pairs):
            message.points[2 * i], message.points[2 * i + 1] = u, v
        return self.features.publish(message)

    def restart(self) -> None:
        """The next features begin a new run, for which the controller forgets everything."""
        self.features.restart()

    def wait_for_answer(self, sent: Sent, patience_s: float = PATIENCE_S) -> TwistCommand:
        """Lockstep: the TwistCommand that answers the features `sent`; answers to others are passed over."""
        end = time.monotonic() + patience_s
        while True:
            command = self.twist.receive()
            if command is not None:
                if (command.features_sequence, command.features_published_ns) == sent:
                    return command
                continue
            if time.monotonic() > end:
                raise NoAnswer(
                    f"vpc/twist: no answer to features {sent[0]} within {patience_s} s; does vpcd run in this domain, with"
                    " --clock lockstep?"
                )
            # A controller that comes late gets the message by the history of the service.
            self.features.refresh()
            time.sleep(POLL_S)


class OperatorPorts(_Closes):
    """Asks the controller. Each method returns the Reply, and raises Refused or NoAnswer; where no controller is in the
    domain, at once."""

    def __init__(self, replies: Subscriber[Reply], requests: Publisher[Request], domain: Domain) -> None:
        self.replies, self.requests, self._domain = replies, requests, domain

    def __repr__(self) -> str:
        return f"OperatorPorts({self.replies!r}, {self.requests!r})"

    def close(self) -> None:
        """Closes the ports; the second time it does nothing."""
        self.replies.close()
        self.requests.close()

    def status(self, patience_s: float = 1.0) -> Reply:
        """Asks for nothing but the state."""
        return self._asked(Action.STATUS, patience_s)

    def arm(self, patience_s: float = 1.0, veto: int = 0) -> Reply:
        """Lets the law move the camera, from the next good features on. Refused before the first.

        After an operator's stop or disarm it is Refused unless `veto` names the newest one: the `veto` of a Reply or a
        CycleRecord. A program that arms by itself takes the one that stood when it was started, and never that of a
        refusal: somebody has said no since."""
        return self._asked(Action.ARM, patience_s, veto=veto)

    def disarm(self, patience_s: float = 1.0) -> Reply:
        """Brakes to zero, and stays there until the next `arm`."""
        return self._asked(Action.DISARM, patience_s)

    def strategy(self, name: str, neighbours: int = 0, patience_s: float = 1.0) -> Reply:
        """Another strategy: previous, knn with 1 to 64 neighbours, gpr, ibvs, foresight, follow."""
        try:
            strategy = StrategyCode[name.upper()]
        except (AttributeError, KeyError):
            allowed = ", ".join(code.words for code in StrategyCode)
            raise BadArgument(f"strategy {name}; allowed: {allowed}") from None
        return self._asked(Action.STRATEGY, patience_s, strategy, neighbours)

    def record(self, patience_s: float = 1.0) -> Reply:
        """Has the controller write its flight record."""
        return self._asked(Action.RECORD, patience_s)

    def _asked(
        self, action: Action, patience_s: float, strategy: int = 0, neighbours: int = 0, veto: int = 0
    ) -> Reply:
        reply = self.ask(action, strategy, neighbours, patience_s, veto)
        if reply.outcome != Outcome.DONE:
            words = Outcome(reply.outcome).words
            raise Refused(reply, f"{action.words}: {words} ({TwistState(reply.state).words}, {Hold(reply.hold).words})")
        return reply

    def ask(
        self, action: Action, strategy: int = 0, neighbours: int = 0, patience_s: float = 1.0, veto: int = 0
    ) -> Reply:
        """Sends a request and returns its Reply, refusal or not."""
        if not self._domain.has_controller():
            raise NoAnswer(f"domain {self._domain.directory}: no controller; start vpcd in this domain")
        message = Request()
        message.id = int.from_bytes(os.urandom(8), "little")
        message.action, message.strategy = action, strategy
        message.neighbours = unsigned("neighbours", neighbours, 64)
        message.veto = unsigned("veto", veto, 2**32 - 1)
        self.requests.publish(message)
        end = time.monotonic() + patience_s
        while time.monotonic() < end:
            reply = self.replies.receive()
            if reply is not None:
                if reply.id == message.id:
                    return reply
                continue
            self.requests.refresh()
            time.sleep(SLOW_POLL_S)
        raise NoAnswer(
            f"vpc/replies: no answer to {Action(action).words} within {patience_s} s; does vpcd run in this domain?"
        )


def _pairs(points: Iterable[Iterable[float]]) -> list[tuple[float, float]]:
    """Points as pairs of numbers; raises BadMessage on arrays of any other shape than (N, 2)."""
    shape = getattr(points, "shape", None)
    pairs: list[tuple[float, float]] = []
    try:
        for u, v in points:
            if not isinstance(u, numbers.Real) or not isinstance(v, numbers.Real):
                raise TypeError
            pairs.append((float(u), float(v)))
    except (TypeError, ValueError):
        found = f"points of shape {shape}" if shape is not None else f"points = {points!r}"
        raise BadMessage(f"vpc/features: {found}; allowed: pairs (u, v) of numbers, shape (N, 2)") from None
    if not 1 <= len(pairs) <= MAX_POINTS:
        raise BadMessage(f"vpc/features: count = {len(pairs)}; allowed: 1 to {MAX_POINTS}")
    return pairs


def unsigned(name: str, value: int, most: int = 2**64 - 1) -> int:
    """An integer from 0 to `most`, which ctypes would cut without a word."""
    if not isinstance(value, numbers.Integral) or not 0 <= value <= most:
        raise BadArgument(f"{name} = {value}; allowed: 0 to {most}")
    return int(value)
