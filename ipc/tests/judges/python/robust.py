"""What must not happen: `stop` with an error that is not the package's, walls that vanish, an obeyed twist of before."""

import os
import sys
import types

import numpy as np
import robot_bridge
import vpc_client
from robot_bridge import Bridge, Measured, Pose


def stop_has_its_own_errors(directory):
    """The stop file is a pipe, which cannot be read at a place; the name cannot be one."""
    os.mkfifo(os.path.join(directory, "stop"))
    for path in (directory, "a\0b", "/nowhere"):
        try:
            vpc_client.stop(path, 0.1)
        except vpc_client.BadDomain as error:
            print("refused", error)
        else:
            sys.exit(f"{path}: accepted")


class Twists:
    def __init__(self):
        self.command = None

    def latest(self, *_):
        return self.command


def bridge(twists):
    limits = types.SimpleNamespace(
        lower=[0.2, -0.4, 0.1], upper=[0.7, 0.4, 0.6], linear=0.05, angular=0.25,
        linear_acceleration=0.5, angular_acceleration=1.2, dry_run=False,
    )  # fmt: skip
    port = types.SimpleNamespace(publish=lambda _: None)
    domain = types.SimpleNamespace(subscribe=lambda *_: twists, publisher=lambda *_: port)
    return Bridge(domain, Pose(np.zeros(3), np.eye(3)), limits)


def walls_hold_without_a_place():
    walls = bridge(Twists())
    for place in ([float("nan"), 0.0, 0.3], [float("inf"), 0.0, 0.3], [0.7, 0.0, 0.3]):
        share = walls.share(np.array([0.05, 0.0, 0.0, 0.0, 0.0, 0.0]), np.array(place))
        assert share == 0.0, (place, share)


def only_what_comes_after_the_start_is_obeyed():
    twists = Twists()
    twists.command = vpc_client.TwistCommand()
    twists.command.twist[:] = [0.01] * 6

    def publish():
        now = vpc_client.now_ns()
        twists.command.stamp.published_ns, twists.command.valid_until_ns = now, now + 90_000_000

    publish()
    driven = bridge(twists)
    here = Pose(np.array([0.5, 0.0, 0.3]), np.eye(3))
    measured = Measured(here, Pose(np.zeros(3), np.eye(3)), np.zeros(6), [0.0] * 6, [0.0] * 6, None)
    for _ in range(3):
        assert not driven.step(measured).any(), driven.sent
    publish()
    driven.step(measured)
    assert driven.step(measured).any()


stop_has_its_own_errors(sys.argv[1])
walls_hold_without_a_place()
only_what_comes_after_the_start_is_obeyed()
print("robust", robot_bridge.__name__)
