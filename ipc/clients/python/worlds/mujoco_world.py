#!/usr/bin/env python3
"""A world of MuJoCo: the FR3 of the wheel franky-sim, moved by MuJoCo's least squares and position servos; OpenGL renders a
spotlight, shadows and filtered textures.

pybullet_world.py tells the commands. MUJOCO_GL=osmesa where there is no EGL, the default here.
"""

import importlib.util
import math
import os
import pathlib
import tempfile

os.environ.setdefault("MUJOCO_GL", "egl")

import lockstep
import mujoco
import mujoco.minimize
import numpy as np

# Of the package only these are needed; to import it takes seconds.
ASSETS = pathlib.Path(importlib.util.find_spec("franky_sim").origin).parent / "assets"
# From here the solver looks for a start, rad: the arm's usual posture.
READY = (0.0, -0.4, 0.0, -2.2, 0.0, 1.9, math.pi / 4)
# What the inverse kinematics may leave at a start, m and rad.
PLACED = 1e-4
# Half sizes of the box, m.
HALF_BOX = (0.13, 0.11, 0.02)
# Light from all sides, from the camera and from the spotlight. Where only the last is shaded, a fifth of the light is missing:
# vpc-camera takes a tag for hidden if the light within it differs by more than a quarter.
AMBIENT, HEADLIGHT, SPOT = ".55 .55 .55", ".2 .2 .2", ".2 .2 .2"
# Of the arm only the wrist is drawn: rendering takes most of the time. Geoms of this group are not.
HIDDEN, UNDRAWN = [f"fr3_link{number}" for number in range(5)], 4
# The hand is turned by an eighth against the flange.
HAND_FROM_CAMERA = lockstep.pose([0, 0, 0, 0, 0, math.pi / 4]) @ lockstep.FLANGE_FROM_CAMERA
# As OpenGL has a camera: y up, z backwards.
OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])


def frame(matrix):
    """Position and orientation as attributes."""
    x, y, z, w = lockstep.quaternion(matrix)
    return f'pos="{" ".join(map(str, matrix[:3, 3]))}" quat="{w} {x} {y} {z}"'


def facing(matrix):
    """The frame of a geom that shows its texture, y up, from that of the sheet, y down."""
    return matrix @ OPENGL


class World:
    STEP_S = 1.0 / 480.0

    def __init__(self, scene, sheet):
        with tempfile.TemporaryDirectory() as directory:
            tags = pathlib.Path(directory) / "tags.png"
            sheet.image.save(tags)
            self.model = mujoco.MjModel.from_xml_string(self._described(scene, sheet, tags))
        self.model.opt.timestep = self.STEP_S
        for link in HIDDEN:
            self.model.geom_group[self.model.geom_bodyid == self.model.body(link).id] = UNDRAWN
        self.data = mujoco.MjData(self.model)
        mujoco.mj_forward(self.model, self.data)
        self.trial = mujoco.MjData(self.model)
        self.renderer = mujoco.Renderer(self.model, int(scene["camera"]["height"]), int(scene["camera"]["width"]))
        self.range = self.model.jnt_range[:7].T

    @staticmethod
    def _described(scene, sheet, tags):
        camera = scene["camera"]
        width, height = int(camera["width"]), int(camera["height"])
        left, top, right, bottom = sheet.box
        half = f"{0.5 * (right - left)} {0.5 * (bottom - top)} 0.0001"
        # From the principal point to the middle of the image, which lies between pixels.
        aside, above = 0.5 * (width - 1) - camera["cx"], 0.5 * (height - 1) - camera["cy"]
        eye = (
            f'<camera name="eye" {frame(HAND_FROM_CAMERA @ OPENGL)} resolution="{width} {height}"'
            f' sensorsize="0.00640 0.00480" focalpixel="{camera["fx"]} {camera["fy"]}" principalpixel="{aside} {above}"/>'
        )
        middle = lockstep.pose([0.5 * (left + right), 0.5 * (top + bottom), 0, 0, 0, 0])
        under = lockstep.pose([0, 0, 3e-4 + HALF_BOX[2], 0, 0, 0])
        half_box = " ".join(map(str, HALF_BOX))
        plain = 'contype="0" conaffinity="0"'
        world = f"""
            <light type="spot" pos="0.2 0.4 1.6" dir="0.3 -0.4 -1.55" cutoff="40" exponent="5" castshadow="true"
             diffuse="{SPOT}" ambient="0 0 0"/>
            <geom type="plane" size="2 2 0.1" pos="0 0 -0.1" material="floor" {plain}/>
            <body name="pattern" mocap="true">
              <geom type="box" size="{half_box}" {frame(under)} rgba=".55 .4 .3 1" {plain}/>
              <geom type="plane" size="{half}" {frame(facing(middle))} material="tags" {plain}/>
            </body>
        """
        assets = f"""
            <texture name="tags" type="2d" file="{tags}"/><material name="tags" texture="tags" specular="0" shininess="0"/>
            <texture name="floor" type="2d" builtin="checker" rgb1=".3 .35 .4" rgb2=".4 .42 .45" width="300" height="300"/>
            <material name="floor" texture="floor" texrepeat="20 20"/>
        """
        visual = '<visual><quality shadowsize="1024" offsamples="4"/><map znear="0.01"/>'
        visual += f'<headlight ambient="{AMBIENT}" diffuse="{HEADLIGHT}" specular="0 0 0"/></visual>'
        text = (ASSETS / "fr3.xml").read_text()
        for old, new in (
            ('meshdir="assets"', f'meshdir="{ASSETS / "meshes"}"'),
            ("<asset>", f"{visual}<asset>{assets}"),
            ("<worldbody>", f"<worldbody>{world}"),
            ('<body name="left_finger"', f'{eye}<body name="left_finger"'),
        ):
            if text.count(old) != 1:
                raise ValueError(f"{ASSETS}/fr3.xml: {text.count(old)} times {old}; allowed: once, as in franky-sim 1.0.4")
            text = text.replace(old, new)
        # The controller of a Franka arm compensates its weight.
        return text.replace("<body name=", '<body gravcomp="1" name=')

    def _eye(self, data):
        found = np.eye(4)
        found[:3, :3] = data.camera("eye").xmat.reshape(3, 3)
        found[:3, 3] = data.camera("eye").xpos
        return found @ OPENGL

    def _solved(self, base_from_camera, q, iterations):
        """The joints nearest to `q` from which the camera is there; what is left, m and rad."""

        def residuals(q):
            columns = []
            for column in np.atleast_2d(q.T):
                self.trial.qpos[:7] = column
                mujoco.mj_kinematics(self.model, self.trial)
                mujoco.mj_camlight(self.model, self.trial)
                apart = lockstep.inverse(base_from_camera) @ self._eye(self.trial)
                vector = lockstep.rotation_vector(apart[:3, :3])
                columns.append([*apart[:3, 3], *vector])
            return np.array(columns).T

        found, _ = mujoco.minimize.least_squares(
            np.array(q), residuals, bounds=list(self.range), max_iter=iterations, verbose=mujoco.minimize.Verbosity.SILENT
        )
        return found, np.abs(residuals(found)).max()

    def carry(self, base_from_pattern):
        x, y, z, w = lockstep.quaternion(base_from_pattern)
        self.data.mocap_pos[0], self.data.mocap_quat[0] = base_from_pattern[:3, 3], (w, x, y, z)
        mujoco.mj_kinematics(self.model, self.data)

    def place(self, base_from_camera):
        q, apart = self._solved(base_from_camera, READY, 100)
        if apart > PLACED:
            raise ValueError(f"this start is out of the arm's reach: {apart} m or rad away")
        pattern = self.pattern()
        mujoco.mj_resetData(self.model, self.data)
        self.carry(pattern)
        self.data.qpos[:7] = self.data.ctrl[:7] = q
        mujoco.mj_forward(self.model, self.data)

    def step(self, base_from_camera):
        self.data.ctrl[:7], _ = self._solved(base_from_camera, self.data.ctrl[:7], 3)
        mujoco.mj_step(self.model, self.data)
        mujoco.mj_forward(self.model, self.data)

    def camera(self):
        return self._eye(self.data)

    def pattern(self):
        found = np.eye(4)
        found[:3, :3] = self.data.body("pattern").xmat.reshape(3, 3)
        found[:3, 3] = self.data.body("pattern").xpos
        return found

    def twist(self):
        velocity, turn = np.zeros((3, self.model.nv)), np.zeros((3, self.model.nv))
        camera = self.camera()
        hand = self.model.body("hand").id
        mujoco.mj_jac(self.model, self.data, velocity, turn, camera[:3, 3], hand)
        return [*(camera[:3, :3].T @ velocity @ self.data.qvel), *(camera[:3, :3].T @ turn @ self.data.qvel)]

    def joints(self):
        return self.data.qpos[:7], self.data.qvel[:7]

    def render(self):
        self.renderer.update_scene(self.data, camera="eye")
        return self.renderer.render() @ np.array([0.299, 0.587, 0.114])


if __name__ == "__main__":
    lockstep.program("mujoco", World, __doc__)
