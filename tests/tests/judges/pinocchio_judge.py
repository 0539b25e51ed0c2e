"""The camera of an arm file at given joint positions, by Pinocchio.

    pinocchio_judge.py ARM.toml < POSTURES.json

Reads a list of joint positions; prints for each the pose of the camera in the base (3 rows of 4),
its Jacobian and that of the end effector's origin (6 rows, base axes).
"""

import json
import sys
import tomllib
from pathlib import Path

import numpy as np
import pinocchio as pin

path = Path(sys.argv[1])
arm = tomllib.loads(path.read_text())
model = pin.buildModelFromUrdf(str(path.parent / arm["urdf"]))
tip = model.frames[model.getFrameId(arm["tip"])]


def add(name, rotation, translation):
    placement = tip.placement * pin.SE3(rotation, np.array(translation))
    return model.addFrame(pin.Frame(name, tip.parentJoint, placement, pin.FrameType.OP_FRAME))


camera = add("judged camera", pin.exp3(np.array(arm["camera"]["rotation"])), arm["camera"]["translation"])
end_effector = add("judged end effector", np.eye(3), arm.get("end_effector", [0.0, 0.0, 0.0]))
base = model.getFrameId(arm["base"])
data = model.createData()


def jacobian(frame):
    axes = data.oMf[base].rotation.T
    found = pin.getFrameJacobian(model, data, frame, pin.LOCAL_WORLD_ALIGNED)
    return np.vstack([axes @ found[:3], axes @ found[3:]]).tolist()


answers = []
for q in json.load(sys.stdin):
    pin.computeJointJacobians(model, data, np.array(q))
    pin.updateFramePlacements(model, data)
    pose = data.oMf[base].actInv(data.oMf[camera]).homogeneous[:3]
    answers.append({"pose": pose.tolist(), "camera": jacobian(camera), "end_effector": jacobian(end_effector)})
json.dump(answers, sys.stdout)
