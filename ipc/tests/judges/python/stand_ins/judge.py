"""Judges a stand-in's log: `judge.py LOG HAND_EYE VX VY VZ WX WY WZ`, the twist along camera axes that it was
to follow."""

import json
import sys
import tomllib

import numpy as np
import stand_in

with open(sys.argv[1]) as file:
    lines = [json.loads(line) for line in file]
with open(sys.argv[2], "rb") as file:
    hand_eye = tomllib.load(file)
asked = np.array([float(word) for word in sys.argv[3:]])

# The camera in the tool: by homogeneous matrices, not by the sums of the bridge.
flange_from_camera, flange_from_tool = np.eye(4), np.eye(4)
flange_from_camera[:3, :3] = stand_in.exp(np.radians(hand_eye["rotation_deg"]))
flange_from_camera[:3, 3] = hand_eye["translation"]
flange_from_tool[:3, :3], flange_from_tool[:3, 3] = stand_in.from_rpy(*stand_in.OFFSET_RPY), stand_in.OFFSET
tool_from_camera = np.linalg.inv(flange_from_tool) @ flange_from_camera


def tool(line):
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = line["turn"], line["place"]
    return pose


def twist(line):
    """Of the camera along its own axes."""
    base_from_camera = tool(line) @ tool_from_camera
    velocity, turn = np.split(np.array(line["twist"]), 2)
    velocity = velocity + np.cross(turn, base_from_camera[:3, 3] - line["place"])
    return np.concatenate((base_from_camera[:3, :3].T @ velocity, base_from_camera[:3, :3].T @ turn))


def exp(motion):
    """Exact motion by a constant twist within a second, in 10 000 steps of a screw."""
    step = np.eye(4)
    step[:3, :3], step[:3, 3] = stand_in.exp(motion[3:] / 1e4), motion[:3] / 1e4
    return np.linalg.matrix_power(step, 10_000)


commands = [line for line in lines if "twist" in line]
moved = np.linalg.inv(tool(lines[0]) @ tool_from_camera) @ tool(lines[-1]) @ tool_from_camera
turned = stand_in.log(moved[:3, :3])
# How long it moved so: by the angle, or where nothing turns, by the way.
about, axis = (turned, asked[3:]) if np.any(asked[3:]) else (moved[:3, 3], asked[:3])
seconds = float(about @ axis / (axis @ axis))
off = np.linalg.inv(exp(asked * seconds)) @ moved
print("seconds", seconds)
print("off", np.linalg.norm(off[:3, 3]), np.linalg.norm(stand_in.log(off[:3, :3])))
print("way", *(np.array(lines[-1]["place"]) - lines[0]["place"]))
speeds = np.array([twist(line) for line in commands])
print("fastest", np.linalg.norm(speeds[:, :3], axis=1).max(), np.linalg.norm(speeds[:, 3:], axis=1).max())
jumps = np.diff([line["twist"] for line in commands], axis=0)
print("jump", np.linalg.norm(jumps[:, :3], axis=1).max(), np.linalg.norm(jumps[:, 3:], axis=1).max())
print("last twist", *commands[-1]["twist"])
moving = [line["at_ns"] for line in commands if np.any(line["twist"])]
print("moved until", moving[-1] if moving else 0)
print("calls", *dict.fromkeys(line["call"] for line in lines))
