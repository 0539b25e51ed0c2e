"""The distances of an arm file's links and boxes at given joint positions, by coal; link poses by Pinocchio.

    coal_judge.py ARM.toml < POSTURES.json

Reads a list of joint positions; prints for each the least distance of any shape of each two links, and of each link and box, by
"LINK OTHER" in both orders. A cylinder is a capsule of its axis and radius, a box of a link the capsule about its longest edges.
"""

import json
import sys
import tomllib
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import coal
import numpy as np
import pinocchio as pin

path = Path(sys.argv[1])
arm = tomllib.loads(path.read_text())
urdf = path.parent / arm["urdf"]
model = pin.buildModelFromUrdf(str(urdf))
data = model.createData()


def numbers(words):
    return np.array([float(word) for word in words.split()])


def capsule(geometry):
    """The capsule about a shape, and its rotation in the shape's frame."""
    kind = geometry[0]
    if kind.tag == "sphere":
        return coal.Capsule(float(kind.get("radius")), 0.0), np.eye(3)
    if kind.tag == "cylinder":
        return coal.Capsule(float(kind.get("radius")), float(kind.get("length"))), np.eye(3)
    size = numbers(kind.get("size"))
    longest = int(np.argmax(size))
    across = np.delete(size, longest)
    # Its z axis along the longest edge.
    rotation = np.roll(np.eye(3), longest - 2, axis=0)
    return coal.Capsule(float(np.hypot(*across)) / 2, float(size[longest])), rotation


links = []
for link in ElementTree.parse(urdf).getroot().iter("link"):
    frame = model.getFrameId(link.get("name"))
    for collision in link.iter("collision"):
        origin = collision.find("origin")
        place = pin.SE3(pin.rpy.rpyToMatrix(numbers(origin.get("rpy"))), numbers(origin.get("xyz")))
        shape, rotation = capsule(collision.find("geometry"))
        links.append((link.get("name"), frame, place * pin.SE3(rotation, np.zeros(3)), shape))
boxes = []
for box in arm.get("box", []):
    place = pin.SE3(pin.exp3(np.array(box.get("rotation", [0.0] * 3))), np.array(box["translation"]))
    boxes.append((box["name"], place, coal.Box(*box["size"])))
base = model.getFrameId(arm["base"])


def placed(place):
    return coal.Transform3s(place.rotation, place.translation)


answers = []
request = coal.DistanceRequest(True)
request.gjk_tolerance = 1e-9
for q in json.load(sys.stdin):
    pin.framesForwardKinematics(model, data, np.array(q))
    base_from = data.oMf[base].inverse()
    bodies = [(name, shape, placed(base_from * data.oMf[frame] * place)) for name, frame, place, shape in links]
    bodies += [(name, shape, placed(place)) for name, place, shape in boxes]
    distances = {}
    for i, (one, shape, place) in enumerate(bodies):
        for other, other_shape, other_place in bodies[:i]:
            result = coal.DistanceResult()
            distance = coal.distance(shape, place, other_shape, other_place, request, result)
            for key in (f"{one} {other}", f"{other} {one}"):
                distances[key] = min(distance, distances.get(key, np.inf))
    answers.append(distances)
json.dump(answers, sys.stdout)
