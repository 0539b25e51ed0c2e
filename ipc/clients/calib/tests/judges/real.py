"""What others make of recordings of real arms: the poses in them, and the answers of published methods.

hand-eye FOLDER   Poses of the flange in the base and of the board in the camera, from pictures (chessboard, tag) or as
                  recorded, and how far the board scatters under OpenCV's hand-eye calibrations (m, RMS).
time FOLDER       Poses at instants, and what is to be added to the camera's stamps (s) by F. Furrer et al.,
                  "Evaluation of combined time-offset estimation and hand-eye calibration on robotic datasets" (2017): to
                  one sample by correlation of filtered angular velocities, then by a joint fit with the deviations and the
                  loss of their configuration (github.com/ethz-asl/hand_eye_calibration). Written from the paper, on
                  numpy; their batch estimator has a spline where this has straight lines.

Prints JSON. Poses are 4 x 4 matrices.
"""

import io
import json
import re
import sys
import xml.etree.ElementTree
import zipfile
from pathlib import Path

import cv2
import numpy as np

METHODS = ("TSAI", "PARK", "DANIILIDIS")


def pose(turn, place):
    matrix = np.eye(4)
    matrix[:3, :3] = cv2.Rodrigues(np.array(turn, float).reshape(3))[0]
    matrix[:3, 3] = np.ravel(place)
    return matrix


def recorded(folder):
    """Readings of an arm's interface, with the board as their author found it."""
    for file in sorted(folder.glob("captured-data/*/data.json")):
        reading = json.loads(file.read_text())
        flange = np.array(reading["O_T_EE"]).reshape(4, 4)
        left, _, right = np.linalg.svd(flange[:3, :3])
        flange[:3, :3] = left @ right
        yield flange, pose(reading["T_cam_target_rvec"], reading["T_cam_target_tvec"])


def lens(folder):
    model = xml.etree.ElementTree.parse(folder / "franka_camera.xml").find(".//model")
    return [float(model.find(key).text) for key in ("px", "py", "u0", "v0")]


def pictured(folder, find, points, flags):
    """Pictures with poses of the flange in files beside them."""
    px, py, u, v = lens(folder)
    camera = np.array([[px, 0, u], [0, py, v], [0, 0, 1]])
    for number in range(1, 9):
        text = (folder / f"franka_pose_rPe_{number}.yaml").read_text()
        numbers = [float(word) for word in re.findall(r"\[\s*([-+0-9.e]+)\s*\]", text)]
        corners = find(cv2.imread(str(folder / f"franka_image-{number}.png"), cv2.IMREAD_GRAYSCALE))
        _, turn, place = cv2.solvePnP(points, corners, camera, None, flags=flags)
        turn, place = cv2.solvePnPRefineLM(points, corners, camera, None, turn, place)
        yield pose(numbers[3:], numbers[:3]), pose(turn, place)


def chessboard(picture):
    found, corners = cv2.findChessboardCornersSB(picture, (9, 6), flags=cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY)
    assert found
    return corners


def tag(picture):
    detector = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11))
    parameters = detector.getDetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    detector.setDetectorParameters(parameters)
    return detector.detectMarkers(picture)[0][0].reshape(-1, 1, 2)


def scatter(robots, mount, boards):
    places = np.array([(robot @ mount @ board)[:3, 3] for robot, board in zip(robots, boards)])
    return float(np.sqrt(((places - places.mean(0)) ** 2).sum(1).mean()))


def hand_eye(folder):
    squares = np.array([[0.0236 * x, 0.0236 * y, 0] for y in range(6) for x in range(9)], np.float32)
    side = 0.024 * np.array([[-1, 1, 0], [1, 1, 0], [1, -1, 0], [-1, -1, 0]], np.float32)
    sets = {
        "franka": recorded(folder / "franka"),
        "eye in hand": pictured(folder / "hand-eye/data-eye-in-hand", chessboard, squares, cv2.SOLVEPNP_ITERATIVE),
        "eye to hand": pictured(folder / "hand-eye/data-eye-to-hand", tag, side, cv2.SOLVEPNP_IPPE_SQUARE),
    }
    for name, poses in sets.items():
        flanges, boards = zip(*poses)
        robots = [np.linalg.inv(flange) for flange in flanges] if name == "eye to hand" else flanges
        scatters = {}
        for method in METHODS:
            turn, place = cv2.calibrateHandEye(
                [robot[:3, :3] for robot in robots],
                [robot[:3, 3] for robot in robots],
                [board[:3, :3] for board in boards],
                [board[:3, 3] for board in boards],
                method=getattr(cv2, f"CALIB_HAND_EYE_{method}"),
            )
            scatters[method] = scatter(robots, pose(cv2.Rodrigues(turn)[0], place), boards)
        yield {
            "name": name,
            "poses": [[flange.tolist(), board.tolist()] for flange, board in zip(flanges, boards)],
            "scatter": scatters,
            "camera": None if name == "franka" else lens(folder / f"hand-eye/data-{name.replace(' ', '-')}"),
        }


def turns(vectors):
    """Rotation matrices of rotation vectors."""
    angle = np.linalg.norm(vectors, axis=-1)[..., None, None]
    x, y, z = np.moveaxis(vectors, -1, 0)
    o = np.zeros_like(x)
    cross = np.stack([np.stack([o, -z, y], -1), np.stack([z, o, -x], -1), np.stack([-y, x, o], -1)], -2)
    return np.eye(3) + np.sinc(angle / np.pi) * cross + 0.5 * np.sinc(angle / 2 / np.pi) ** 2 * cross @ cross


def vectors(matrices):
    """Rotation vectors of turns below a half."""
    skew = matrices - np.swapaxes(matrices, -1, -2)
    sine = 0.5 * np.stack([skew[..., 2, 1], skew[..., 0, 2], skew[..., 1, 0]], -1)
    length = np.linalg.norm(sine, axis=-1)
    angle = np.arctan2(length, 0.5 * (np.trace(matrices, axis1=-2, axis2=-1) - 1))
    return sine * (angle / np.maximum(length, 1e-300))[..., None]


class Track:
    def __init__(self, rows):
        self.times, self.places = rows[:, 0], rows[:, 1:4]
        x, y, z, w = rows[:, 4:].T
        axis, sine = np.stack([x, y, z], -1), np.sqrt(x * x + y * y + z * z)
        self.turns = turns(axis * (2 * np.arctan2(sine, w) / np.maximum(sine, 1e-300))[:, None])
        self.steps = vectors(np.swapaxes(self.turns[:-1], 1, 2) @ self.turns[1:])

    def at(self, times):
        k = np.clip(np.searchsorted(self.times, times, side="right") - 1, 0, len(self.times) - 2)
        share = ((times - self.times[k]) / (self.times[k + 1] - self.times[k]))[:, None]
        return self.turns[k] @ turns(self.steps[k] * share), self.places[k] + share * (self.places[k + 1] - self.places[k])

    def speeds(self, step, clip):
        times = np.arange(self.times[0], self.times[-1], step)
        matrices, _ = self.at(times)
        velocity = vectors(np.swapaxes(matrices[:-1], 1, 2) @ matrices[1:]) / step
        most = np.percentile(velocity, clip)
        kernel = np.ones(25) / 25
        smooth = [np.convolve(axis, kernel, "same") for axis in np.clip(velocity, -most, most).T]
        return np.linalg.norm(smooth, axis=0)


def time(folder):
    files = {}
    with zipfile.ZipFile(folder / "time/robot_arm_w_color_camera_real.zip") as archive:
        for name in archive.namelist():
            files["target" in name] = np.loadtxt(io.BytesIO(archive.read(name)), delimiter=",")
    arm, camera = files[False], files[True]
    begin = arm[0, 0]
    arm[:, 0] -= begin
    camera[:, 0] -= begin
    robot, eye = Track(arm), Track(camera)
    step = max(np.diff(arm[:, 0]).mean(), np.diff(camera[:, 0]).mean())
    one, other = robot.speeds(step, 99.5), eye.speeds(step, 99.0)
    lag = int(np.correlate(other, one, "full").argmax()) - (len(one) - 1)
    coarse = -(step * lag + eye.times[0] - robot.times[0])

    inner = (eye.times > robot.times[0] + 0.2) & (eye.times < robot.times[-1] - 0.2)
    times, turned = eye.times[inner], np.swapaxes(eye.turns[inner], 1, 2)
    placed = -np.einsum("nij,nj->ni", turned, eye.places[inner])

    def misses(state):
        shift, mount, target = state
        matrices, places = robot.at(times + shift)
        turn = target[:3, :3].T @ matrices @ mount[:3, :3] @ turned
        place = np.einsum("nij,nj->ni", matrices, placed @ mount[:3, :3].T + mount[:3, 3]) + places
        return np.hstack([(place - target[:3, 3]) @ target[:3, :3], vectors(turn)]) / 0.01

    def moved(state, by):
        shift, mount, target = state
        return shift + by[0], mount @ pose(by[4:7], by[1:4]), target @ pose(by[10:13], by[7:10])

    every = slice(None, None, 40)
    matrices, places = robot.at(times[every] + coarse)
    turn, place = cv2.calibrateHandEye(
        list(matrices), list(places), list(turned[every]), list(placed[every]), method=cv2.CALIB_HAND_EYE_DANIILIDIS
    )
    mount = pose(cv2.Rodrigues(turn)[0], place)
    first, board = np.eye(4), np.eye(4)
    first[:3, :3], first[:3, 3] = matrices[0], places[0]
    board[:3, :3], board[:3, 3] = turned[0], placed[0]
    state = (coarse, mount, first @ mount @ board)
    for _ in range(20):
        now = misses(state)
        derivative = np.empty((*now.shape, 13))
        for k in range(13):
            by = np.zeros(13)
            by[k] = 1e-4
            derivative[..., k] = (misses(moved(state, by)) - misses(moved(state, -by))) / 2e-4
        weight = 1 / (1 + (now**2).sum(1) / 10)
        normal = np.einsum("nik,n,nil->kl", derivative, weight, derivative)
        state = moved(state, -np.linalg.solve(normal, np.einsum("nik,n,ni->k", derivative, weight, now)))


    def rows(track, is_inverse):
        for moment, turn, place in zip(track.times.tolist(), track.turns, track.places):
            matrix = np.eye(4)
            matrix[:3, :3], matrix[:3, 3] = turn, place
            yield [moment, (np.linalg.inv(matrix) if is_inverse else matrix).tolist()]

    return {
        "robot": list(rows(robot, False)),
        "seen": list(rows(eye, True)),
        "step": step,
        "coarse": coarse,
        "joint": state[0],
    }


folder = Path(sys.argv[2])
print(json.dumps(list(hand_eye(folder)) if sys.argv[1] == "hand-eye" else time(folder)))
