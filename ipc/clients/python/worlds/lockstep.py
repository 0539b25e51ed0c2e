"""Closes the loop with vpc-camera and vpcd in lockstep over a simulator's world, start after start, and judges each run by
the simulator's own poses.

A world is a class, made from a scene and a `Sheet`, with

    STEP_S                       its step, s; a frame is due every few of them
    carry(base_from_pattern)     puts the box with the pattern there
    place(base_from_camera)      puts the arm there at rest, by the simulator's inverse kinematics
    step(base_from_camera)       has the arm follow, and lets one step pass
    camera(), pattern()          where they are now, in the base: 4 x 4 matrices
    twist()                      velocity of the camera in its own frame, m/s and rad/s
    joints()                     positions and velocities of the joints
    render()                     what the camera sees: levels (height, width), 0 to 255
"""

import argparse
import collections
import json
import math
import pathlib
import sys
import time

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parent.parent))

try:
    import numpy as np
    import vpc_client
    from picture import Lens, Sheet
    from PIL import Image
    from vpc_client.ports import PATIENCE_S, POLL_S
except ModuleNotFoundError as missing:
    sys.exit(f"{missing.name} is missing; pip install -r ipc/clients/python/requirements-worlds.txt")
from camera import read_scene, read_starts, rotation
from referee import Referee

# From the exposure to the delivery of a frame, s, and the share of frames that are lost: as in hw-sim/hw-sim-tags.toml.
LATENCY_S, DROP = 0.11, 0.01
# How long a command holds, s.
OBEYED_S = 0.1
# How long the pattern stays at the goal before the object is released, and for how long the arm then comes to rest, s.
DWELL_S, REST_S = 0.5, 0.5
# How long the camera stays with a box that moves: all that counts, since an arm at rest loses it.
FOLLOW_S = 3.0
# The pattern in the arm's base: half a metre in front, 5 cm above the foot, facing up; x to the right of the arm, y towards
# it. hw-sim's lies there, too.
BASE_FROM_PATTERN = np.array([[0.0, -1.0, 0.0, 0.5], [-1.0, 0.0, 0.0, 0.0], [0.0, 0.0, -1.0, 0.05], [0.0, 0.0, 0.0, 1.0]])
# The camera on the flange of a Franka arm: ipc/scene/scenes/panda.toml.
FLANGE_FROM_CAMERA = np.eye(4)
FLANGE_FROM_CAMERA[:3, :3] = rotation([0.0, 0.0, math.pi / 4])
FLANGE_FROM_CAMERA[:3, 3] = [0.07 * math.sqrt(0.5), -0.07 * math.sqrt(0.5), 0.04]


def pose(numbers):
    """The matrix of a translation, m, and a rotation vector, rad."""
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = rotation(np.array(numbers[3:])), numbers[:3]
    return matrix


def quaternion(matrix):
    """x, y, z, w of a rotation matrix: the eigenvector of Bar-Itzhack (2000), which knows no bad angles."""
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = matrix[:3, :3]
    rows = [
        [xx - yy - zz, 0, 0, 0],
        [xy + yx, yy - xx - zz, 0, 0],
        [xz + zx, yz + zy, zz - xx - yy, 0],
        [zy - yz, xz - zx, yx - xy, xx + yy + zz],
    ]
    return np.linalg.eigh(np.array(rows))[1][:, -1]


def rotation_vector(matrix):
    """Axis times angle of a rotation matrix."""
    *axis, cosine = quaternion(matrix)
    sine = np.linalg.norm(axis)
    angle = 2.0 * math.atan2(sine, abs(cosine))
    return np.copysign(1.0, cosine) * np.array(axis) * (angle / sine if sine > 1e-12 else 2.0)


def inverse(matrix):
    turned = np.eye(4)
    turned[:3, :3], turned[:3, 3] = matrix[:3, :3].T, -matrix[:3, :3].T @ matrix[:3, 3]
    return turned


class Arrival:
    """Release of the object: once the pattern was at the goal for a while, without a frame elsewhere."""

    def __init__(self, dwell_s):
        self.dwell_s, self.since_s = dwell_s, None

    def is_due(self, is_there, now_s):
        self.since_s = (now_s if self.since_s is None else self.since_s) if is_there else None
        return self.since_s is not None and now_s - self.since_s >= self.dwell_s


class Loop:
    """One domain, and run after run in it."""

    def __init__(self, scene, directory, world, domain, seed):
        self.scene, self.world, self.lens = scene, world, Lens(scene)
        camera = scene["camera"]
        self.rate_hz = camera["rate_hz"]
        self.points = np.array(scene["pattern"]["points"])
        goal = pose(scene["goal"]["translation"] + scene["goal"]["rotation"])
        self.referee = Referee(scene, self.pixels(goal), directory)
        self.domain, self.random = domain, np.random.default_rng(seed)
        self.twist = domain.subscribe("vpc/twist", 4)
        self.found = domain.subscribe("vpc/features")
        self.images = domain.image_publisher(int(camera["width"] * camera["height"]))
        self.robot = domain.publisher("vpc/robot")
        # Measured less true features of each frame that was found, px.
        self.errors = []

    def pixels(self, object_in_camera):
        points = self.points @ object_in_camera[:3, :3].T + object_in_camera[:3, 3]
        camera = self.scene["camera"]
        if (points[:, 2] <= 0.0).any():
            return np.full((len(points), 2), np.inf)
        focal, middle = [camera["fx"], camera["fy"]], [camera["cx"], camera["cy"]]
        return points[:, :2] / points[:, 2:] * focal + middle

    def object(self):
        """The pattern in the camera's frame, by the simulator."""
        return inverse(self.world.camera()) @ self.world.pattern()

    def run(self, start, speed, save=None):
        """What became of a run over a box with this speed, m/s: its verdict, when, and the last error, px."""
        world, period_s = self.world, 1.0 / self.rate_hz
        world.carry(BASE_FROM_PATTERN)
        world.place(world.pattern() @ inverse(pose(start)))
        wanted = world.camera()
        self.images.restart()
        epoch_ns, arrival, self.errors = vpc_client.now_ns(), Arrival(FOLLOW_S if speed else DWELL_S), []
        under_way, command, until_s, begun_s, arrived_s = collections.deque(), np.zeros(6), 0.0, None, None
        truths, frames, steps, verdict = {}, 0, 0, None
        while verdict is None:
            now_s = steps * world.STEP_S
            if now_s >= frames * period_s - 1e-9:
                frames += 1
                seen = self.object()
                pixels = self.pixels(seen)
                error = self.referee.error(pixels)
                verdict = self.judge(pixels, now_s, begun_s)
                self.tell(seen, frames, epoch_ns + round(1e9 * now_s), begun_s is not None)
                if arrived_s is None and error <= self.referee.convergence_px:
                    arrived_s = now_s
                if arrival.is_due(self.referee.arrived(pixels), now_s):
                    return ("arrived", arrived_s, error) if speed else self.release(wanted, arrived_s)
                is_lost = frames > 1 and self.random.random() < DROP
                picture = None if is_lost else self.lens.cover(world.render(), True)
                truths[frames] = pixels
                under_way.append((now_s, picture))
                if save and frames % 100 == 1 and picture is not None:
                    Image.fromarray(picture).save(f"{save}-{frames:04}.png")
            while under_way and now_s >= under_way[0][0] + LATENCY_S - 1e-9:
                exposed_s, picture = under_way.popleft()
                if picture is None:
                    self.images.skip()
                    continue
                answer = self.ask(picture, epoch_ns, exposed_s, now_s)
                command, until_s = np.array(answer.twist), now_s + OBEYED_S
                if begun_s is None and answer.state == vpc_client.TwistState.MOVING:
                    begun_s = now_s
                self.compare(truths)
            if now_s < until_s:
                wanted = wanted @ self.moved(command, world.STEP_S)
            if speed:
                world.carry(BASE_FROM_PATTERN @ pose([speed * now_s, 0.0, 0.0, 0.0, 0.0, 0.0]))
            world.step(wanted)
            steps += 1
        return verdict, now_s, error

    @staticmethod
    def moved(twist, duration_s):
        """The camera's new pose in its old frame. Steps are so short that half of the turn comes before the move."""
        half = pose([0.0, 0.0, 0.0, *(0.5 * duration_s * twist[3:])])
        move = pose([*(duration_s * twist[:3]), 0.0, 0.0, 0.0])
        return half @ move @ half

    def judge(self, pixels, now_s, begun_s):
        violation = self.referee.violation(pixels)
        if violation:
            return f"violation: {violation}"
        if now_s - (begun_s or 0.0) > self.scene["success"]["time_s"]:
            return "time is up"
        return None

    def release(self, wanted, arrived_s):
        """Nobody is obeyed any more: the arm comes to rest. Where it does is what counts."""
        for _ in range(round(REST_S / self.world.STEP_S)):
            self.world.step(wanted)
        pixels = self.pixels(self.object())
        verdict = None if self.referee.arrived(pixels) else "released elsewhere"
        return verdict or self.judge(pixels, 0.0, 0.0) or "arrived", arrived_s, self.referee.error(pixels)

    def ask(self, picture, epoch_ns, exposed_s, now_s):
        """Publishes a frame, and waits for the command that answers it."""
        data_ns, published_ns = (epoch_ns + round(1e9 * at_s) for at_s in (exposed_s, now_s))
        sent = self.images.publish(picture, data_ns=data_ns, published_ns=published_ns)
        end = time.monotonic() + PATIENCE_S
        while time.monotonic() < end:
            command = self.twist.receive()
            if command is None:
                self.images.refresh()
                time.sleep(POLL_S)
            elif (command.features_sequence, command.features_published_ns) == sent:
                return command
        raise vpc_client.NoAnswer(
            f"vpc/twist: no answer to frame {sent.sequence} within {PATIENCE_S} s; do vpc-camera and vpcd run in this"
            " domain, with --clock lockstep?"
        )

    def compare(self, truths):
        while (features := self.found.receive()) is not None:
            truth = truths.get(features.stamp.sequence)
            whole = (1 << features.count) - 1
            if truth is not None and features.visible == whole:
                measured = np.array(features.points[: 2 * features.count]).reshape(-1, 2)
                self.errors.append(measured - truth)

    def found_to(self):
        """How far from the true features the measured ones were, px."""
        errors = np.array(self.errors).reshape(-1, 2)
        if not len(errors):
            return {"frames": 0, "rms_px": math.inf, "mean_px": [math.inf, math.inf]}
        mean = errors.mean(axis=0).round(3).tolist()
        return {"frames": len(self.errors), "rms_px": float(np.sqrt((errors**2).mean())), "mean_px": mean}

    def tell(self, seen, frame, now_ns, is_moving):
        state = vpc_client.RobotState()
        state.stamp.data_ns, state.features_sequence = now_ns, frame
        state.mode = vpc_client.RobotMode.MOVING if is_moving else vpc_client.RobotMode.IDLE
        state.translation[:], state.rotation[:] = seen[:3, 3], rotation_vector(seen[:3, :3])
        state.twist[:] = self.world.twist()
        q, dq = self.world.joints()
        state.joints = len(q)
        state.q[: len(q)], state.dq[: len(q)] = q, dq
        self.robot.publish(state)


def wilson(good, count):
    """The 95 % interval of a share."""
    z = 1.959963984540054
    share, scale = good / count, 1.0 + z * z / count
    half = z * math.sqrt(share * (1.0 - share) / count + z * z / (4.0 * count * count))
    middle = share + z * z / (2.0 * count)
    return (middle - half) / scale, (middle + half) / scale


def main(name, make, words):
    parser = argparse.ArgumentParser(description=words, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scene", required=True, help="scene file (TOML) with tags")
    parser.add_argument("--starts", required=True, help="start poses (CSV: tx,ty,tz,rx,ry,rz)")
    parser.add_argument("--tags", required=True, help="the printed tags: what `vpc-camera tags` drew of the scene (SVG)")
    parser.add_argument("--domain", help=f"directory of the domain [{vpc_client.default_directory()}]")
    parser.add_argument("--first", type=int, default=0, help="index of the first start [%(default)s]")
    parser.add_argument("--count", type=int, help="number of starts [all from there]")
    parser.add_argument("--motion", type=float, default=0.0, metavar="M_PER_S", help="speed of the box, to the right [it stands]")
    parser.add_argument("--json", help="file for the result of each run")
    parser.add_argument("--frames", metavar="PREFIX", help="write every hundredth frame to PREFIX-START-FRAME.png")
    arguments = parser.parse_args()
    scene = read_scene(arguments.scene)
    starts = list(enumerate(read_starts(arguments.starts)))[arguments.first :][: arguments.count]
    if not starts:
        parser.error(f"--first {arguments.first} --count {arguments.count}: no start is there")
    world, runs = make(scene, Sheet(arguments.tags)), []
    with vpc_client.Domain(arguments.domain) as domain:
        domain.wait_for_controller()
        loop = Loop(scene, pathlib.Path(arguments.scene).parent, world, domain, seed=arguments.first)
        for number, start in starts:
            verdict, time_s, error = loop.run(start, arguments.motion, arguments.frames and f"{arguments.frames}-{number}")
            runs.append({"start": number, "verdict": verdict, "time_s": time_s, "error_px": error, **loop.found_to()})
            numbers = "after {time_s:.1f} s, error {error_px:.2f} px; {frames} frames, features to {rms_px:.3f} px RMS"
            print(f"start {number}: {verdict} {numbers.format(**runs[-1])}, mean {runs[-1]['mean_px']}", flush=True)
    if arguments.json:
        pathlib.Path(arguments.json).write_text(json.dumps(runs, indent=1))
    arrived = sum(run["verdict"] == "arrived" for run in runs)
    low, high = (100.0 * share for share in wilson(arrived, len(starts)))
    print(f"{name}: arrived {arrived} of {len(starts)} (95 %: {low:.1f} to {high:.1f} %)")
    return 0 if arrived == len(starts) else 1


def program(name, make, words):
    try:
        sys.exit(main(name, make, words))
    except (vpc_client.VpcError, OSError, ValueError) as error:
        sys.exit(f"{name}: {error}")
