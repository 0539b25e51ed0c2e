"""What the peers share: a scene as arrays, the pattern in the camera, and its clearances. With NumPy and SciPy."""

import numpy
from scipy.ndimage import distance_transform_edt

# Pixels of a field beyond the image's border.
BEYOND = 32
# How the distances from the image's sides change with a point.
SIDES = numpy.concatenate([numpy.eye(2), -numpy.eye(2)])


def rotation(vector):
    """The matrix of a rotation vector (Rodrigues)."""
    angle = numpy.linalg.norm(vector)
    if angle < 1e-12:
        return numpy.eye(3)
    x, y, z = vector / angle
    cross = numpy.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return numpy.eye(3) + numpy.sin(angle) * cross + (1.0 - numpy.cos(angle)) * cross @ cross


def moved(points, twist, dt):
    """Points (n, 3) in the camera after dt under its twist, exactly to second order."""
    rate = lambda points: -twist[:3] - numpy.cross(twist[3:], points)
    return points + dt * rate(points + 0.5 * dt * rate(points))


class Scene:
    """The table of the first line as arrays."""

    def __init__(self, table):
        camera, cost = table["camera"], table["cost"]
        self.table, self.period = table, table["period"]
        self.focal = numpy.array([camera["fx"], camera["fy"]])
        self.centre = numpy.array([camera["cx"], camera["cy"]])
        self.size = numpy.array([camera["width"], camera["height"]])
        self.pattern = numpy.array(table["pattern"])
        self.goal = numpy.array(table["goal"]["features"])
        turn = rotation(numpy.array(table["goal"]["rotation"]))
        self.goal_points = self.pattern @ turn.T + table["goal"]["translation"]
        self.limits = numpy.array(table["limits"])
        self.k_q, self.r = cost["k_q"], numpy.array(cost["r"])
        # l(v) / Np by which a run is judged: R counts Np - 1 times.
        self.effort = self.r * (cost["np"] - 1) / cost["np"]
        self.parts = [part for one in table["occlusions"] for part in one["parts"]]
        # Signed distances (occlusions, height, width) and their gradients, px.
        self.fields = numpy.array([self.field(one) for one in table["occlusions"]])
        self.slopes = numpy.stack(numpy.gradient(self.fields, axis=(2, 1)), axis=-1)

    def field(self, occlusion):
        """The signed distance of each pixel from an occlusion, px; negative inside."""
        width, height = (self.size + 2 * BEYOND).astype(int)
        v, u = numpy.mgrid[:height, :width] - BEYOND
        inside = numpy.zeros((height, width), bool)
        for part in occlusion["parts"]:
            (cu, cv), (hu, hv), p = part["center"], part["half"], part["p"]
            inside |= (abs(u - cu) / hu) ** p + (abs(v - cv) / hv) ** p < 1.0
        for left, right, top, bottom in occlusion["rectangles"]:
            inside[top + BEYOND : bottom + BEYOND, left + BEYOND : right + BEYOND] = True
        return distance_transform_edt(~inside) - distance_transform_edt(inside)

    def pixels(self, points):
        return self.centre + self.focal * points[..., :2] / points[..., 2:]

    def share(self, pixels):
        """How much R counts: it falls toward the goal."""
        mean = ((pixels - self.goal) ** 2).sum(axis=(-2, -1)) / len(self.goal)
        return numpy.minimum(mean / (0.25 * self.size[0]) ** 2, 1.0)

    def at(self, pixels, axis):
        """The index along u (axis 0) or v (1) in a field."""
        return numpy.clip(numpy.rint(pixels).astype(int), -BEYOND, int(self.size[axis]) + BEYOND - 1) + BEYOND

    def barriers(self, pixels):
        """Distances (n, 4 + occlusions) of points (n, 2) from the image's sides and from each occlusion, px, and
        their gradients (n, 4 + occlusions, 2)."""
        row, column = self.at(pixels[:, 1], 1), self.at(pixels[:, 0], 0)
        slopes = self.slopes[:, row, column].swapaxes(0, 1)
        beside = pixels - numpy.stack([column, row], axis=-1) + BEYOND
        fields = self.fields[:, row, column].T + (slopes @ beside[..., None])[..., 0]
        sides = numpy.broadcast_to(SIDES, (len(pixels), 4, 2))
        values = numpy.concatenate([pixels, self.size - pixels, fields], axis=1)
        return values, numpy.concatenate([sides, slopes], axis=1)

    def interaction(self, points):
        """How normalized coordinates (2n) of points in the camera change with its twist."""
        z = points[:, 2]
        x, y = points[:, 0] / z, points[:, 1] / z
        zero = numpy.zeros_like(z)
        rows = [
            [-1.0 / z, zero, x / z, x * y, -(1.0 + x * x), y],
            [zero, -1.0 / z, y / z, 1.0 + y * y, -x * y, -x],
        ]
        return numpy.array(rows).transpose(2, 0, 1).reshape(-1, 6)

    def normalized(self, pixels):
        return (pixels - self.centre) / self.focal


class Tracker:
    """The pattern in the camera (n, 3) by virtual visual servoing from the last pose, at first from a homography."""

    def __init__(self, scene):
        self.scene, self.points = scene, None

    def reset(self):
        self.points = None

    def __call__(self, pixels):
        scene, seen = self.scene, self.scene.normalized(pixels)
        if self.points is None:
            self.points = self.first(seen)
        for _ in range(8):
            error = (seen - self.points[:, :2] / self.points[:, 2:]).ravel()
            twist = numpy.linalg.lstsq(scene.interaction(self.points), error, rcond=None)[0]
            turn = rotation(-twist[3:])
            self.points = (self.points - twist[:3]) @ turn.T
            if abs(twist).max() < 1e-10:
                break
        return self.points

    def predict(self, twist):
        """The camera moves by this twist until the next frame."""
        self.points = moved(self.points, numpy.asarray(twist), self.scene.period)

    def first(self, seen):
        rows, flat = [], self.scene.pattern
        for (x, y), (X, Y, _) in zip(seen, flat):
            rows += [[X, Y, 1, 0, 0, 0, -x * X, -x * Y, -x], [0, 0, 0, X, Y, 1, -y * X, -y * Y, -y]]
        h = numpy.linalg.svd(numpy.array(rows))[2][-1].reshape(3, 3)
        h *= numpy.sign(h[2, 2]) / numpy.sqrt(numpy.linalg.norm(h[:, 0]) * numpy.linalg.norm(h[:, 1]))
        turn = numpy.column_stack([h[:, 0], h[:, 1], numpy.cross(h[:, 0], h[:, 1])])
        left, _, right = numpy.linalg.svd(turn)
        return flat @ (left @ right).T + h[:, 2]


class Peer:
    """A method that knows the pattern in the camera: `plan(points, pixels)` gives the twist."""

    def __init__(self, table):
        self.scene = Scene(table)
        self.track = Tracker(self.scene)

    def reset(self):
        self.track.reset()

    def step(self, pixels):
        pixels = numpy.array(pixels)
        points = self.track(pixels)
        twist = self.limited(self.plan(points, pixels))
        self.track.predict(twist)
        return twist

    def limited(self, twist):
        return twist / max(1.0, (abs(twist) / self.scene.limits).max())
