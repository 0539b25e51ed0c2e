"""Finds tags in images by OpenCV, DICTIONARY FILE...: for each file a line "number u v u v u v u v ..." of corners, px."""

import sys

import cv2

detector = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, sys.argv[1])))
for path in sys.argv[2:]:
    image = cv2.imread(path, cv2.IMREAD_GRAYSCALE)
    found, numbers, _ = detector.detectMarkers(image)
    for number, corners in zip([] if numbers is None else numbers.ravel(), found, strict=True):
        corners = cv2.cornerSubPix(image, corners.reshape(-1, 1, 2), (2, 2), (-1, -1), (3, 50, 1e-3))
        print(number, *(f"{x:.4f}" for x in corners.ravel()), end=" ")
    print()
