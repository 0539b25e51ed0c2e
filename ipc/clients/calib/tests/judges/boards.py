"""The corners of a board in pictures, by OpenCV.

Reads JSON from the file that is named: the keys of a board of vpc-calib, and paths of pictures. Prints a list of pairs of
number and pixel for each picture.
"""

import json
import sys

import cv2
import numpy as np

given = json.load(open(sys.argv[1]))
columns, rows = given["columns"], given["rows"]
dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, given["family"]))
exact = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 100, 1e-4)


def chessboard(picture):
    found, corners = cv2.findChessboardCorners(picture, (columns, rows))
    if not found:
        return []
    return list(enumerate(cv2.cornerSubPix(picture, corners, (5, 5), (-1, -1), exact).reshape(-1, 2).tolist()))


def charuco(picture):
    board = cv2.aruco.CharucoBoard((columns, rows), given["square_size"], given["tag_size"], dictionary)
    board.setLegacyPattern(given["legacy"])
    corners, numbers, _, _ = cv2.aruco.CharucoDetector(board).detectBoard(picture)
    if numbers is None:
        return []
    return list(zip(numbers.ravel().tolist(), corners.reshape(-1, 2).tolist()))


def tags(picture):
    detector = cv2.aruco.ArucoDetector(dictionary)
    parameters = detector.getDetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    detector.setDetectorParameters(parameters)
    corners, numbers, _ = detector.detectMarkers(picture)
    if numbers is None:
        return []
    # AprilTags are upside down for it.
    turned = [np.roll(tag.reshape(4, 2), 2, axis=0).tolist() for tag in corners]
    return [(4 * number + k, tag[k]) for number, tag in zip(numbers.ravel().tolist(), turned) for k in range(4)]


find = {"chessboard": chessboard, "charuco": charuco, "aprilgrid": tags, "tags": tags}[given["kind"]]
print(json.dumps([find(cv2.imread(path, cv2.IMREAD_GRAYSCALE)) for path in given["pictures"]]))
