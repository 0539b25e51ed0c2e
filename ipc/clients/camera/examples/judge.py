"""What other detectors find in the pictures of a folder: judge.py FOLDER DICTIONARY

Prints a JSON object for each detector: for each picture, in the order of the names, the milliseconds
it took on one thread, and the centres of the tags by number, px; the centre of the upper left pixel
is (0, 0).
"""

import json
import sys
import time
from pathlib import Path

import cv2
from pupil_apriltags import Detector

cv2.setNumThreads(1)
pictures = sorted(path for path in Path(sys.argv[1]).iterdir() if path.suffix in (".png", ".pgm"))
_, _, family = sys.argv[2].partition("DICT_APRILTAG_")
apriltag = Detector(families=f"tag{family}", nthreads=1, quad_decimate=1.0) if family else None
parameters = cv2.aruco.DetectorParameters()
parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, sys.argv[2]))
aruco = cv2.aruco.ArucoDetector(dictionary, parameters)


def by_apriltag(image):
    # Its origin is the corner of the first pixel.
    return {tag.tag_id: [x - 0.5 for x in tag.center] for tag in apriltag.detect(image) if tag.hamming == 0}


def crossing(a, b, c, d):
    """Where the diagonals meet."""
    (ex, ey), (fx, fy) = c - a, d - b
    share = ((b[0] - a[0]) * fy - (b[1] - a[1]) * fx) / (ex * fy - ey * fx)
    return [float(a[0] + share * ex), float(a[1] + share * ey)]


def by_aruco(image):
    corners, numbers, _ = aruco.detectMarkers(image)
    if numbers is None:
        return {}
    return {int(n): crossing(*c.reshape(4, 2).astype(float)) for n, c in zip(numbers.ravel(), corners)}


detectors = [("OpenCV ArUco", by_aruco)]
if apriltag:
    detectors.insert(0, ("AprilTag 3", by_apriltag))
for name, detect in detectors:
    frames = []
    for path in pictures:
        image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        begin = time.perf_counter()
        tags = detect(image)
        frames.append({"ms": 1e3 * (time.perf_counter() - begin), "tags": tags})
    print(json.dumps({"detector": name, "frames": frames}))
if apriltag:
    # Its destructor frees the families and then reads them, which ends some runs with SIGSEGV.
    apriltag.tag_detector_ptr = None
