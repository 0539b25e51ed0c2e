"""A user's program: type-checked by mypy against the installed package, then run. Sends an image and features, and
looks at what comes back as NumPy arrays."""

import sys
from typing import assert_type

import numpy as np
import numpy.typing as npt

import vpc_client


def frame(number: int) -> npt.NDArray[np.uint8]:
    return np.full((4, 6), number, dtype=np.uint8)


def main(directory: str) -> None:
    corners = np.array([[312.0, 312.0], [712.0, 312.5], [712.0, 712.0]])
    with (
        vpc_client.Domain(directory) as domain,
        domain.camera() as camera,
        domain.subscribe("vpc/features") as seen,
        domain.image_publisher(24) as images,
        domain.image_subscriber() as frames,
        domain.publisher("vpc/requests") as requests,
    ):
        status = vpc_client.Request()
        status.id, status.action = 1, vpc_client.Action.STATUS
        requests.publish(status)
        images.publish(frame(7))
        image = frames.latest()
        assert image is not None
        assert_type(image.array, npt.NDArray[np.uint8])
        assert np.array_equal(image.array, frame(7))

        sent = camera.publish_features(corners)
        features = seen.receive()
        assert features is not None
        assert_type(features.count, int)
        points = np.asarray(features.points).reshape(-1, 2)[: features.count]
        assert np.array_equal(points, corners)
        assert features.stamp.sequence == sent.sequence

        command = camera.twist.latest()
        assert_type(command, vpc_client.TwistCommand | None)
        assert command is None
        assert vpc_client.twist_in_force(command) == [0.0] * 6
    print(vpc_client.__file__, "works")


if __name__ == "__main__":
    main(sys.argv[1])
