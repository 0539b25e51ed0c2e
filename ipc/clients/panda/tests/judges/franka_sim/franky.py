"""franky-sim at an address of its own; SIGTERM ends it.

    franky.py ADDRESS Q1 ... Q7
"""

import os
import signal
import struct
import sys

import franky_sim
from franky_sim import franka_server
from franky_sim.mujoco_simulator import MujocoSimulator


class Packed:
    """Its answer to a connection has a status of two bytes; libfranka's has one."""

    def __getattr__(self, name):
        return getattr(struct, name)

    def pack(self, form, *values):
        return struct.pack("<BH5x" if form == "<HH4x" else form, *values)


def main():
    try:
        # Below the bridge's 85: who sends states late, or takes commands late, counts them as lost.
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(60))
    except PermissionError:
        pass
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))
    franka_server.struct = Packed()
    address, q = sys.argv[1], [float(q) for q in sys.argv[2:9]]
    with MujocoSimulator(enable_visualization=False) as simulator:
        simulator.add_robot(initial_q=q)
        with franky_sim.SimulationServer(simulator, hostname_candidates=[address]) as server:
            print("Server ready for new client connection", flush=True)
            server.run_forever()


main()
