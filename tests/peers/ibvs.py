"""Classic visual servoing: v = -gain L^+ (s - s*), with the depths of the pattern's pose and ViSP's adaptive gain.

Tuned: nothing. The gain (4, 0.4, 30) is that of vpAdaptiveGain's documentation, as in visp.cpp.
"""

import numpy

import adapter
from geometry import Peer

AT_ZERO, AT_INFINITY, SLOPE = 4.0, 0.4, 30.0


class Ibvs(Peer):
    def plan(self, points, pixels):
        scene = self.scene
        error = (scene.normalized(pixels) - scene.normalized(scene.goal)).ravel()
        motion = numpy.linalg.lstsq(scene.interaction(points), error, rcond=None)[0]
        spread = AT_ZERO - AT_INFINITY
        gain = spread * numpy.exp(-SLOPE / spread * abs(motion).max()) + AT_INFINITY
        return -gain * motion


if __name__ == "__main__":
    adapter.run(Ibvs)
