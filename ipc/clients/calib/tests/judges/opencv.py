"""Calibrates with OpenCV what the test wrote: views of a board, and poses of a robot.

Reads JSON from the file that is named: size; views, lists of pairs of a place on the board (m) and a pixel;
flanges, 4 x 4 matrices of the flange in the base. Prints fx fy cx cy, the distortion, the reprojection error, and for
each method of hand-eye calibration the camera in the flange frame.
"""

import json
import sys

import cv2
import numpy as np

given = json.load(open(sys.argv[1]))
places = [np.array([[x, y, 0.0] for (x, y), _ in view], np.float32) for view in given["views"]]
pixels = [np.array([pixel for _, pixel in view], np.float32) for view in given["views"]]
exact = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 200, 1e-12)
rms, camera, distortion, turns, shifts = cv2.calibrateCamera(
    places, pixels, tuple(given["size"]), None, None, flags=cv2.CALIB_FIX_K3, criteria=exact
)
flanges = [np.array(flange) for flange in given["flanges"]]
mounts = {}
for name in ("TSAI", "PARK", "DANIILIDIS"):
    turn, shift = cv2.calibrateHandEye(
        [flange[:3, :3] for flange in flanges],
        [flange[:3, 3] for flange in flanges],
        [cv2.Rodrigues(turn)[0] for turn in turns],
        shifts,
        method=getattr(cv2, f"CALIB_HAND_EYE_{name}"),
    )
    mounts[name] = [*shift.ravel(), *cv2.Rodrigues(turn)[0].ravel()]
print(
    json.dumps(
        {
            "camera": [camera[0, 0], camera[1, 1], camera[0, 2], camera[1, 2]],
            "distortion": distortion.ravel()[:5].tolist(),
            "rms": rms,
            "mounts": mounts,
        }
    )
)
