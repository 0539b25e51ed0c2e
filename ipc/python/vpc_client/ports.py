"""Ports: publishers and subscribers of one service, and those of a camera and an operator."""

import math
import os
import time
from typing import NamedTuple

from .errors import BadMessage, NoAnswer, Refused
from .messages import (
    CHECKS,
    MAX_POINTS,
    SERVICES,
    Action,
    Features,
    Hold,
    Outcome,
    Request,
    StrategyCode,
    TwistState,
)

# How long a lockstep camera waits for an answer.
PATIENCE_S = 10.0
# Sleep between two looks for an answer: of a lockstep camera, of everybody else.
POLL_S = 20e-6
SLOW_POLL_S = 1e-3


def check(service, message):
    """Raises BadMessage where a message breaks the contract."""
    kind = type(message)
    if message.stamp.sequence == 0:
        raise BadMessage(f"{service}: sequence = 0; allowed: 1 and more")
    for field, rule in CHECKS[kind].items():
        value = getattr(message, field)
        if isinstance(rule, tuple):
            least, most = rule
            if not least <= value <= most:
                raise BadMessage(f"{service}: {field} = {value}; allowed: {least} to {most}")
        elif isinstance(rule, str):
            used = 2 * getattr(message, rule) if rule else len(value)
            for i in range(used):
                if not math.isfinite(value[i]):
                    raise BadMessage(f"{service}: {field}[{i}] = {value[i]}; allowed: finite numbers")
        elif value >= len(rule):
            raise BadMessage(f"{service}: {field} = {value}; allowed: 0 to {len(rule) - 1}")


def now_ns():
    """CLOCK_MONOTONIC, the clock of all stamps."""
    return time.clock_gettime_ns(time.CLOCK_MONOTONIC)


class Sent(NamedTuple):
    """What the answer to a message bears."""

    sequence: int
    published_ns: int


class _Port:
    def __init__(self, name, port):
        self.name = name
        self._port = port

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.close()

    def close(self):
        """Closes the port; the second time it does nothing."""
        if self._port is not None:
            self._port.delete()
            self._port = None


class Publisher(_Port):
    """Publishes the messages of one service."""

    def __init__(self, name, port):
        super().__init__(name, port)
        self.sequence = 0

    def publish(self, message):
        """Publishes a copy under the next sequence number. `published_ns` 0 becomes the present time, other values stand
        (simulated time in lockstep); returns Sent."""
        kind = SERVICES[self.name].message
        if not isinstance(message, kind):
            raise BadMessage(f"{self.name}: a {type(message).__name__}; allowed: {kind.__name__}")
        stamped = kind.from_buffer_copy(message)
        stamped.stamp.sequence = self.sequence + 1
        stamped.stamp.published_ns = stamped.stamp.published_ns or now_ns()
        check(self.name, stamped)
        self.sequence += 1
        self._port.send_copy(stamped)
        return Sent(stamped.stamp.sequence, stamped.stamp.published_ns)

    def refresh(self):
        """Connects to subscribers that came since, and hands them the history of the service. Publishing does it, too;
        who waits for an answer must do it while waiting."""
        self._port.update_connections()

    def restart(self):
        """Counts from 1 again: for features, a new run."""
        self.sequence = 0


class Subscriber(_Port):
    """Receives the messages of one service."""

    def receive(self):
        """The oldest message that waits, as a copy; None where there is none. BadMessage where it breaks the contract;
        the next one may be good."""
        sample = self._port.receive()
        if sample is None:
            return None
        message = SERVICES[self.name].message.from_buffer_copy(sample.payload().contents)
        # Back to shared memory: one sample may be borrowed at a time.
        del sample
        check(self.name, message)
        return message

    def latest(self):
        """The newest message since the last call, None where there is none; those before it are thrown away."""
        newest = None
        for _ in range(SERVICES[self.name].buffer + 1):
            message = self.receive()
            if message is None:
                break
            newest = message
        return newest

    def messages(self, seconds=None, count=None, poll_s=SLOW_POLL_S):
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

    def __iter__(self):
        return self.messages()


class _Role:
    """Ports that open and close together."""

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.close()

    def close(self):
        """Closes the ports; the second time it does nothing."""
        for port in self._ports:
            port.close()


class CameraPorts(_Role):
    """Publishes features, receives twists."""

    def __init__(self, domain):
        # The subscriber first: no answer may be missed.
        self.twist = domain.subscriber("vpc/twist", 4)
        self._ports = [self.twist]
        try:
            self.features = domain.publisher("vpc/features")
        except BaseException:
            self.close()
            raise
        self._ports.append(self.features)

    def publish_features(self, points, data_ns=None, exposure_ns=0, visible=None, published_ns=0):
        """Publishes points [(u, v), ...] in px; returns Sent.

        `data_ns` is the middle of the exposure [as published], `exposure_ns` its length, 0 where unknown; bit i of
        `visible` tells whether point i was measured [all]; `published_ns` is for simulated time [now]."""
        count = len(points)
        if not 1 <= count <= MAX_POINTS:
            raise BadMessage(f"vpc/features: count = {count}; allowed: 1 to {MAX_POINTS}")
        message = Features()
        message.stamp.published_ns = published_ns or now_ns()
        message.stamp.data_ns = message.stamp.published_ns if data_ns is None else data_ns
        message.count = count
        message.exposure_ns = exposure_ns
        message.visible = (1 << count) - 1 if visible is None else visible
        for i, (u, v) in enumerate(points):
            message.points[2 * i], message.points[2 * i + 1] = u, v
        return self.features.publish(message)

    def restart(self):
        """The next features begin a new run, for which the controller forgets everything."""
        self.features.restart()

    def wait_for_answer(self, sent, patience_s=PATIENCE_S):
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


class OperatorPorts(_Role):
    """Asks the controller. Each method returns the Reply, and raises Refused or NoAnswer."""

    def __init__(self, domain):
        self.replies = domain.subscriber("vpc/replies")
        self._ports = [self.replies]
        try:
            self.requests = domain.publisher("vpc/requests")
        except BaseException:
            self.close()
            raise
        self._ports.append(self.requests)

    def status(self, **patience):
        """Asks for nothing but the state."""
        return self._asked(Action.STATUS, **patience)

    def arm(self, **patience):
        """Lets the law move the camera, from the next good features on."""
        return self._asked(Action.ARM, **patience)

    def disarm(self, **patience):
        """Brakes to zero, and stays there until the next `arm`."""
        return self._asked(Action.DISARM, **patience)

    def stop(self, **patience):
        """Zero at once, without braking, until the next `arm`."""
        return self._asked(Action.STOP, **patience)

    def strategy(self, name, neighbours=0, **patience):
        """Another strategy: previous, knn with 1 to 64 neighbours, gpr, ibvs."""
        try:
            strategy = StrategyCode[name.upper()]
        except KeyError:
            allowed = ", ".join(code.words for code in StrategyCode)
            raise ValueError(f"strategy {name}; allowed: {allowed}") from None
        return self._asked(Action.STRATEGY, strategy, neighbours, **patience)

    def record(self, **patience):
        """Has the controller write its flight record."""
        return self._asked(Action.RECORD, **patience)

    def _asked(self, action, strategy=0, neighbours=0, **patience):
        reply = self.ask(action, strategy, neighbours, **patience)
        if reply.outcome != Outcome.DONE:
            words = Outcome(reply.outcome).words
            raise Refused(reply, f"{action.words}: {words} ({TwistState(reply.state).words}, {Hold(reply.hold).words})")
        return reply

    def ask(self, action, strategy=0, neighbours=0, patience_s=1.0):
        """Sends a request and returns its Reply, refusal or not."""
        message = Request()
        message.id = int.from_bytes(os.urandom(8), "little")
        message.action, message.strategy, message.neighbours = action, strategy, neighbours
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
