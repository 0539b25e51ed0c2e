#!/usr/bin/env python3
"""A world of PyBullet: the Panda of its wheel, moved by its inverse kinematics and motors; its renderer's light and shadows.

    pip install -r ipc/clients/python/requirements-worlds.txt
    S=ipc/scene/scenes
    vpc-camera tags $S/tags-robot.toml -o tags.svg
    vpc-memory build $S/tags-robot.toml -o tags.vpcmem
    vpcd --config controller/vpcd-tags.toml --memory tags.vpcmem --clock lockstep &
    vpc-camera --config ipc/clients/camera/vpc-camera.toml --clock lockstep &
    python3 ipc/clients/python/worlds/pybullet_world.py --scene $S/tags-robot.toml --starts $S/tags-robot-starts.csv \\
        --tags tags.svg --count 2

mujoco_world.py takes the same flags.
"""

import math
import pathlib
import tempfile
from xml.etree import ElementTree

import lockstep
import numpy as np
import pybullet
import pybullet_data
from PIL import Image, ImageFilter

JOINTS, FINGERS, FLANGE = range(7), (9, 10), 7
# From here the solver looks for a start, rad: the arm's usual posture.
READY = (0.0, -0.4, 0.0, -2.2, 0.0, 1.9, math.pi / 4)
# What the inverse kinematics may leave at a start, m and rad.
PLACED = 1e-4
# Blur of lens and pixels, px. The renderer samples one point of each pixel, so an edge along a row is up to half a pixel off for
# long. Without the blurs vpc-camera takes such a tag for one that is partly hidden, and as the pictures have no noise, for ever.
BLUR_PX = 0.45
# Blur of the texture, its pixels: about a third of a camera's pixel at the distances of the starts, as a pixel's area has it.
TEXTURE_BLUR = 2.0
NEAR, FAR = 0.01, 3.0
# Where the light comes from: the hand's shadow falls on the tags.
LIGHT = (-0.3, 0.15, 1.0)
# Half sizes of the box, m. It stands alone and of the arm only the hand is drawn: rendering takes most of the time.
HALF_BOX = (0.095, 0.08, 0.02)
HIDDEN = [f"panda_link{number}" for number in range(7)]


def matrix(position, orientation):
    found = np.eye(4)
    found[:3, :3] = np.array(pybullet.getMatrixFromQuaternion(orientation)).reshape(3, 3)
    found[:3, 3] = position
    return found


class World:
    STEP_S = 1.0 / 240.0

    def __init__(self, scene, sheet):
        pybullet.connect(pybullet.DIRECT)
        pybullet.setGravity(0.0, 0.0, -9.81)
        pybullet.setTimeStep(self.STEP_S)
        self.arm = self._arm()
        self.sheet = self._box(sheet)
        self.carry(lockstep.BASE_FROM_PATTERN)
        camera = scene["camera"]
        self.width, self.height = int(camera["width"]), int(camera["height"])
        # The renderer samples a pixel at its lower left corner, not in its middle.
        left, right = -camera["cx"] / camera["fx"], (self.width - camera["cx"]) / camera["fx"]
        top, bottom = (-1.0 - camera["cy"]) / camera["fy"], (self.height - 1.0 - camera["cy"]) / camera["fy"]
        edges = [NEAR * edge for edge in (left, right, -bottom, -top)]
        self.projection = pybullet.computeProjectionMatrix(*edges, NEAR, FAR)

    @staticmethod
    def _arm():
        folder = pathlib.Path(pybullet_data.getDataPath()) / "franka_panda"
        urdf = ElementTree.parse(folder / "panda.urdf")
        for link in urdf.iterfind("link"):
            for visual in link.findall("visual") if link.get("name") in HIDDEN else []:
                link.remove(visual)
        for mesh in urdf.iter("mesh"):
            mesh.set("filename", mesh.get("filename").replace("package://", f"{folder}/"))
        with tempfile.TemporaryDirectory() as directory:
            file = pathlib.Path(directory) / "panda.urdf"
            urdf.write(file)
            return pybullet.loadURDF(str(file), useFixedBase=True)

    def _box(self, sheet):
        """A box and the sheet on it; returns the sheet's body, in the frame of the pattern."""
        box = pybullet.createVisualShape(pybullet.GEOM_BOX, halfExtents=HALF_BOX, rgbaColor=(0.55, 0.4, 0.3, 1.0))
        self.box = pybullet.createMultiBody(0.0, -1, box)
        left, top, right, bottom = sheet.box
        corners = [[left, top, 0], [right, top, 0], [right, bottom, 0], [left, bottom, 0]]
        paper = pybullet.createVisualShape(
            pybullet.GEOM_MESH,
            vertices=corners,
            indices=[0, 2, 1, 0, 3, 2],
            uvs=[[0, 1], [1, 1], [1, 0], [0, 0]],
            normals=[[0, 0, -1]] * 4,
        )
        body = pybullet.createMultiBody(0.0, -1, paper)
        with tempfile.TemporaryDirectory() as directory:
            file = str(pathlib.Path(directory) / "tags.png")
            sheet.image.filter(ImageFilter.GaussianBlur(TEXTURE_BLUR)).save(file)
            pybullet.changeVisualShape(body, -1, textureUniqueId=pybullet.loadTexture(file))
        return body

    def _solved(self, base_from_camera, **keys):
        flange = base_from_camera @ lockstep.inverse(lockstep.FLANGE_FROM_CAMERA)
        found = pybullet.calculateInverseKinematics(self.arm, FLANGE, flange[:3, 3], lockstep.quaternion(flange), **keys)
        return found[:7]

    def carry(self, base_from_pattern):
        at, turned = base_from_pattern[:3, 3], lockstep.quaternion(base_from_pattern)
        pybullet.resetBasePositionAndOrientation(self.sheet, at, turned)
        under = at + base_from_pattern[:3, 2] * (HALF_BOX[2] + 2e-4)
        pybullet.resetBasePositionAndOrientation(self.box, under, turned)

    def place(self, base_from_camera):
        for joint, angle in zip(JOINTS, READY):
            pybullet.resetJointState(self.arm, joint, angle)
        for _ in range(200):
            for joint, angle in zip(JOINTS, self._solved(base_from_camera, maxNumIterations=200)):
                pybullet.resetJointState(self.arm, joint, angle)
            apart = lockstep.inverse(base_from_camera) @ self.camera()
            if max(np.abs(apart[:3, 3]).max(), np.abs(lockstep.rotation_vector(apart[:3, :3])).max()) < PLACED:
                break
        else:
            raise ValueError(f"this start is out of the arm's reach: {apart[:3, 3]} m away")
        for joint, (low, high) in zip(JOINTS, (pybullet.getJointInfo(self.arm, joint)[8:10] for joint in JOINTS)):
            if not low < pybullet.getJointState(self.arm, joint)[0] < high:
                raise ValueError(f"this start is out of the range of joint {joint + 1}")

    def step(self, base_from_camera):
        angles = self._solved(base_from_camera, maxNumIterations=20, residualThreshold=1e-7)
        forces = [pybullet.getJointInfo(self.arm, joint)[10] for joint in JOINTS]
        pybullet.setJointMotorControlArray(
            self.arm, JOINTS, pybullet.POSITION_CONTROL, targetPositions=angles, forces=forces
        )
        pybullet.stepSimulation()

    def camera(self):
        at, turned = pybullet.getLinkState(self.arm, FLANGE, computeForwardKinematics=True)[4:6]
        return matrix(at, turned) @ lockstep.FLANGE_FROM_CAMERA

    def pattern(self):
        return matrix(*pybullet.getBasePositionAndOrientation(self.sheet))

    def twist(self):
        state = pybullet.getLinkState(self.arm, FLANGE, computeLinkVelocity=True, computeForwardKinematics=True)
        # Of the link's centre of mass, which is not where its frame is.
        velocity, turn = np.array(state[6]), np.array(state[7])
        camera = self.camera()
        velocity = velocity + np.cross(turn, camera[:3, 3] - np.array(state[0]))
        return [*(camera[:3, :3].T @ velocity), *(camera[:3, :3].T @ turn)]

    def joints(self):
        states = pybullet.getJointStates(self.arm, JOINTS)
        return [state[0] for state in states], [state[1] for state in states]

    def render(self):
        camera = self.camera()
        # As OpenGL has it: y up, z backwards.
        view = lockstep.inverse(camera @ np.diag([1.0, -1.0, -1.0, 1.0])).T.ravel()
        _, _, colours, *_ = pybullet.getCameraImage(
            self.width,
            self.height,
            view,
            self.projection,
            lightDirection=LIGHT,
            shadow=1,
            flags=pybullet.ER_NO_SEGMENTATION_MASK,
            renderer=pybullet.ER_TINY_RENDERER,
        )
        rgb = np.asarray(colours, np.uint8).reshape(self.height, self.width, 4)[..., :3]
        return np.asarray(Image.fromarray(rgb).convert("L").filter(ImageFilter.GaussianBlur(BLUR_PX)))


if __name__ == "__main__":
    lockstep.program("pybullet", World, __doc__)
