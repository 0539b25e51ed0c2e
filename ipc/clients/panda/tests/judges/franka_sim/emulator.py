"""franka-sim at an address of its own, with all that it can check; SIGTERM ends it.

    emulator.py ADDRESS Q1 ... Q7

Its own command line binds every address, and begins with a straight elbow.
"""

import logging
import os
import pathlib
import signal
import sys

os.environ["FR3_MJCF"] = str(pathlib.Path(__file__).with_name("fr3.xml"))

import franka_sim.mujoco_franka_sim as mujoco_franka_sim
import numpy
from franka_sim import FrankaSimServer


def main():
    logging.basicConfig(level=logging.INFO, format="%(levelname)s %(name)s: %(message)s")
    try:
        # Below the bridge's 85: who sends states late, or takes commands late, counts them as lost.
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(60))
    except PermissionError:
        pass
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))
    mujoco_franka_sim.ARM_INITIAL_Q = numpy.array([float(q) for q in sys.argv[2:9]])
    server = FrankaSimServer(
        host=sys.argv[1],
        enable_gripper=False,
        enforce_comm_constraints=True,
        enforce_motion_limits=True,
    )
    try:
        server.start()
    finally:
        server.stop()


main()
