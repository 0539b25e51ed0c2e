"""Calibrations that OpenCV writes, and what OpenCV makes of their pixels: lens.py DIRECTORY, JSON to standard output."""

import json
import sys

import cv2
import numpy as np

SCENE = np.array([[800.0, 0.0, 320.0], [0.0, 790.0, 240.0], [0.0, 0.0, 1.0]])
SIZE = 640, 480
EXACT = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 500, 1e-13)
LENSES = {
    "mild": ([610.0, 612.5, 318.2, 243.9], [-0.05, 0.02, 1e-3, -5e-4, 0.0], False),
    "barrel": ([450.0, 451.0, 325.0, 238.0], [-0.33, 0.14, 1e-3, -2e-3, -0.03], False),
    "pincushion": ([600.0, 600.0, 320.0, 240.0], [0.2, -0.05, 0.0, 1e-3], False),
    "rational": ([480.0, 480.0, 322.0, 236.0], [1.8, 0.6, 2e-4, -1e-4, 0.02, 2.1, 1.2, 0.13], False),
    "fisheye": ([285.0, 286.0, 316.0, 242.0], [-0.007, 0.04, -0.04, 0.008], True),
}


def write(path, camera, coefficients, is_fisheye):
    storage = cv2.FileStorage(path, cv2.FILE_STORAGE_WRITE)
    storage.write("image_width", SIZE[0])
    storage.write("image_height", SIZE[1])
    storage.write("fisheye_model", int(is_fisheye))
    storage.write("camera_matrix", camera)
    storage.write("distortion_coefficients", coefficients)
    storage.release()


def project(points, camera, coefficients, is_fisheye):
    rays = np.dstack([points, np.ones(points.shape[:2])]).reshape(-1, 1, 3)
    still = np.zeros(3)
    if is_fisheye:
        return cv2.fisheye.projectPoints(rays, still, still, camera, coefficients)[0].reshape(-1, 2)
    return cv2.projectPoints(rays, still, still, camera, coefficients)[0].reshape(-1, 2)


def undistort(pixels, camera, coefficients, is_fisheye, to):
    if is_fisheye:
        return cv2.fisheye.undistortPoints(pixels, camera, coefficients, P=to, criteria=EXACT)
    # Its name in OpenCV 4.
    to_the_end = getattr(cv2, "undistortPointsIter", cv2.undistortPoints)
    return to_the_end(pixels, camera, coefficients, R=None, P=to, criteria=EXACT)


def judge(directory, name):
    (fx, fy, cx, cy), coefficients, is_fisheye = LENSES[name]
    camera = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    coefficients = np.array(coefficients)
    write(f"{directory}/{name}.yaml", camera, coefficients.reshape(-1, 1), is_fisheye)
    u, v = np.meshgrid(np.linspace(0, SIZE[0] - 1, 33), np.linspace(0, SIZE[1] - 1, 25))
    pixels = np.dstack([u.ravel(), v.ravel()]).reshape(-1, 1, 2)
    points = undistort(pixels, camera, coefficients, is_fisheye, np.eye(3))
    scene = undistort(pixels, camera, coefficients, is_fisheye, SCENE).reshape(-1, 2)
    # Where OpenCV's iteration ends far from the inverse, it is no judge.
    back = project(points, camera, coefficients, is_fisheye)
    sound = np.linalg.norm(back - pixels.reshape(-1, 2), axis=1) < 1e-6
    return {
        "pixels": pixels.reshape(-1, 2)[sound].tolist(),
        "points": points.reshape(-1, 2)[sound].tolist(),
        "projected": back[sound].tolist(),
        "scene": scene[sound].tolist(),
        "unsound": int((~sound).sum()),
    }


json.dump({name: judge(sys.argv[1], name) for name in LENSES}, sys.stdout)
