"""Publishes the twists that another program wants: vpcd with `strategy = "follow"` sends the nearest allowed ones.

Each line of standard input is a twist, vx vy vz wx wy wz, in m/s and rad/s, in the camera's frame (x right, y down, z
forward). It counts for `--valid` seconds from when it is read; then the camera brakes. What writes the lines must send
each at once, not a block of them (`-u` for Python):

    python3 -u your_policy.py | python3 policy.py

With `--pad DEVICE` a gamepad steers: the left stick moves the camera sideways, up and down, the right stick turns it,
the triggers move it forward and back, and the two shoulder buttons roll it.
"""

import argparse
import select
import struct
import sys
import time

import vpc_client

# An event of Linux' joystick interface: time, ms; value; kind; number.
EVENT = struct.Struct("IhBB")
BUTTON, AXIS = 1, 2
# What vpcd takes at most, s.
LONGEST_S = 0.5
# How often a gamepad's twist is published, s.
EVERY_S = 1 / 60


class Pad:
    """A gamepad's axes, from -1 to 1, and buttons."""

    def __init__(self, file):
        self.file = file
        self.axes = [0.0, 0.0, -1.0, 0.0, 0.0, -1.0]
        self.buttons = [0] * 6

    def read(self):
        """Takes what comes in a period; False at the end."""
        end = time.monotonic() + EVERY_S
        while (left := end - time.monotonic()) > 0 and select.select([self.file], [], [], left)[0]:
            event = self.file.read(EVENT.size)
            if len(event) < EVENT.size:
                return False
            _, value, kind, number = EVENT.unpack(event)
            if kind & AXIS and number < len(self.axes):
                self.axes[number] = value / 32767
            elif kind & BUTTON and number < len(self.buttons):
                self.buttons[number] = value
        return True

    def twist(self, linear, angular):
        """The twist that the sticks ask for."""
        right, down, back, yaw, pitch, forward = self.axes
        roll = self.buttons[5] - self.buttons[4]
        velocity = [right, down, 0.5 * (forward - back)]
        return [linear * v for v in velocity] + [angular * w for w in (-pitch, yaw, roll)]


def twists(lines):
    """The twists of lines of six numbers."""
    for number, line in enumerate(lines, 1):
        try:
            twist = [float(word) for word in line.split()]
        except ValueError:
            twist = []
        if len(twist) != 6:
            raise SystemExit(f"policy: line {number} is {line.strip()!r}; allowed: six numbers, vx vy vz wx wy wz")
        yield twist


def pads(path, linear, angular):
    """The twists of a gamepad."""
    with open(path, "rb", buffering=0) as file:
        pad = Pad(file)
        while pad.read():
            yield pad.twist(linear, angular)


def valid(word):
    """Seconds for which a twist may count."""
    seconds = float(word)
    if not 0 < seconds <= LONGEST_S:
        raise argparse.ArgumentTypeError(f"{word} s; allowed: above 0, up to {LONGEST_S}")
    return seconds


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--domain", help="directory of the domain [default: /tmp/vpc-UID]")
    parser.add_argument("--valid", type=valid, default=0.2, help="how long a twist counts, s, up to 0.5 [default: 0.2]")
    parser.add_argument("--pad", metavar="DEVICE", help="a gamepad, for instance /dev/input/js0")
    parser.add_argument("--linear", type=float, default=0.1, help="of a stick that is pushed, m/s [default: 0.1]")
    parser.add_argument("--angular", type=float, default=0.3, help="of a stick that is pushed, rad/s [default: 0.3]")
    options = parser.parse_args()
    wanted = pads(options.pad, options.linear, options.angular) if options.pad else twists(sys.stdin)
    with vpc_client.Domain(options.domain) as domain, domain.publisher("vpc/desired") as publisher:
        domain.wait_for_controller()
        print(f"policy: to the vpcd of {domain.directory}; each twist counts for {options.valid} s", file=sys.stderr)
        for twist in wanted:
            desired = vpc_client.DesiredTwist()
            desired.twist[:] = twist
            desired.valid_until_ns = vpc_client.now_ns() + int(1e9 * options.valid)
            publisher.publish(desired)
        # Before the last one has counted, nobody may have read it.
        time.sleep(options.valid)


if __name__ == "__main__":
    try:
        main()
    except (vpc_client.VpcError, OSError) as error:
        raise SystemExit(f"policy: {error}") from None
    except KeyboardInterrupt:
        pass
