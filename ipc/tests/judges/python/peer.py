"""The Python side of mod.rs: `peer.py layout`, or `peer.py exchange DOMAIN`. Finds vpc_client by PYTHONPATH."""

import ctypes
import sys

import vpc_client


def layout():
    """Every message as `name size alignment`, its fields as `name.field offset size`, services with their queues."""
    for service, (message, *queues) in vpc_client.SERVICES.items():
        print(service, message.type_name(), *queues)
    for message in (vpc_client.Stamp, *(service.message for service in vpc_client.SERVICES.values())):
        print(message.__name__, ctypes.sizeof(message), ctypes.alignment(message))
        for name, _ in message._fields_:
            field = getattr(message, name)
            print(f"{message.__name__}.{name}", field.offset, field.size)


def codes():
    """The numbers up to 99 that each field of codes may have."""
    from vpc_client.messages import CHECKS
    from vpc_client.ports import check

    def is_taken(kind, field, number):
        message = kind()
        for counted, rule in CHECKS[kind].items():
            if isinstance(rule, tuple):
                setattr(message, counted, rule[0])
        setattr(message, field, number)
        try:
            check("service", message, sequenced=False)
        except vpc_client.BadMessage as error:
            assert f" {field} = " in str(error), error
            return False
        return True

    for kind in {service.message for service in vpc_client.SERVICES.values()}:
        for field, rule in CHECKS[kind].items():
            if isinstance(rule, type):
                print(f"{kind.__name__}.{field}", *(number for number in range(100) if is_taken(kind, field, number)))


def exchange(directory):
    """Sends features and a robot's state, receives a twist and a cycle's record, and prints what came."""
    with vpc_client.Domain(directory) as domain:
        camera = domain.camera()
        robot = domain.publisher("vpc/robot")
        cycles = domain.subscribe("vpc/cycles")

        state = vpc_client.RobotState()
        state.stamp.data_ns = 77
        state.features_sequence, state.mode, state.faults, state.joints = 5, vpc_client.RobotMode.MOVING, 2, 7
        for field in ("translation", "rotation", "twist", "q", "dq"):
            numbers = getattr(state, field)
            offset = getattr(vpc_client.RobotState, field).offset
            numbers[:] = [offset + i / 8 for i in range(len(numbers))]
        state.commands_in_time = vpc_client.RobotState.commands_in_time.offset
        robot.publish(state)

        points = [(0.1, 2.25), (640.5, -3.75), (1e-3, 4.0), (5.0, 6.0), (7.0, 1 / 3)]
        sent = camera.publish_features(points, data_ns=123_456_789, exposure_ns=4_000_000, visible=0b10111)
        command = camera.wait_for_answer(sent)
        print("twist", command.state, *map(repr, command.twist), flush=True)
        record = next(cycles.messages(count=1, seconds=10))
        print("cycle", record.cycle, record.lost_records, record.np, record.state, end=" ")
        print(*map(repr, [*record.points, *record.way_point, *record.twist]), end=" ")
        print(repr(record.cost), repr(record.violation_px), repr(record.clearance_px), repr(record.error_px))

        with domain.operator() as operator:
            try:
                operator.strategy("knn", 5, patience_s=10.0)
            except vpc_client.Refused as refusal:
                print("refused", refusal, flush=True)
                reply = refusal.reply
            print("armed", operator.arm(patience_s=10.0, veto=7).veto, flush=True)
        print("reply", reply.stamp.data_ns, reply.action, reply.outcome, reply.state, reply.hold, end=" ")
        print(reply.strategy, reply.neighbours, flush=True)


def refusals(directory):
    """What is refused, in the words of the exception; and that everything is gone after the end of a `with`."""
    import numpy as np

    def refused(action, head=""):
        try:
            action()
        except vpc_client.VpcError as error:
            print(f"{head}{error}")

    square = np.ones((4, 2))
    with vpc_client.Domain(directory) as domain:
        with domain.camera() as camera:
            for points in ([], [(1.0, float("nan"))], square.ravel(), square.reshape(4, 1, 2)):
                refused(lambda: camera.publish_features(points))
            refused(lambda: camera.publish_features(square, data_ns=-1))
            refused(domain.camera, "taken: ")
            refused(lambda: camera.wait_for_answer(camera.publish_features(square), patience_s=0.01))
        # Its place is free again, also after one that is thrown away.
        domain.camera()
        domain.camera().close()
        refused(lambda: domain.subscribe("vpc/nothing"))
        refused(lambda: domain.subscribe("vpc/twist", buffer=65))
        refused(lambda: domain.operator().arm())
        refused(lambda: camera.publish_features(square))
    refused(lambda: vpc_client.Domain("/dev/null"))


def hears(directory):
    """Receives one command after another until a good one comes."""
    with vpc_client.Domain(directory) as domain, domain.subscribe("vpc/twist") as twists:
        print("listening", flush=True)
        while True:
            try:
                for command in twists:
                    print("good", command.stamp.sequence, flush=True)
                    return
            except vpc_client.BadMessage as error:
                print(error, flush=True)


def images(directory):
    """Sends images, loaned and copied; then looks at images without a copy, and says what it saw and what is refused."""
    import numpy as np

    def refused(action):
        try:
            action()
        except vpc_client.VpcError as error:
            print("refused", error, flush=True)

    def is_shared(array):
        at = array.__array_interface__["data"][0]
        with open("/proc/self/maps") as maps:
            lines = [line.split() for line in maps]
        mapped = [line[-1] for line in lines if int(line[0].split("-")[0], 16) <= at < int(line[0].split("-")[1], 16)]
        return mapped[0].startswith("/dev/shm/vpc_")

    with vpc_client.Domain(directory) as domain:
        go = domain.subscribe("vpc/twist")
        with domain.image_publisher(36) as images:
            image = images.loan(4, 2, vpc_client.Encoding.RGB8, stride=16)
            refused(lambda: images.loan(1, 1))
            filled = image.array
            assert filled.shape == (2, 4, 3) and is_shared(filled)
            filled[:] = np.arange(24).reshape(2, 4, 3)
            image.header.exposure_begin_ns, image.header.exposure_ns = 1_000, 10
            image.header.stamp.data_ns = 990
            refused(lambda: images.send(image))
            image.header.stamp.data_ns = 1_005
            print("sent", *images.send(image), flush=True)
            refused(lambda: images.send(image))
            next(go.messages(count=1))
            images.skip()
            images.publish(np.full((3, 12), 7, np.uint8)[:, ::2], data_ns=5)
            for wrong in (np.ones((3, 3)), np.ones(9, np.uint8), np.ones((3, 3, 4), np.uint8), [[1]]):
                refused(lambda: images.publish(wrong))
            refused(lambda: images.publish(np.ones((1, 37), np.uint8)))
            refused(lambda: domain.image_publisher(1))
        # An array keeps the memory, also when the port is closed.
        assert filled[1, 3, 2] == 23
        refused(lambda: images.publish(np.ones((1, 1), np.uint8)))
        refused(lambda: domain.publisher("vpc/image"))
        refused(lambda: domain.image_publisher(0))

        images = domain.image_subscriber()
        print("watching", flush=True)
        held = []

        def latest():
            while True:
                image = images.latest()
                if image is not None:
                    return image

        def show():
            array = latest().array
            assert is_shared(array) and not array.flags.writeable
            print("image", array.shape, array.strides, array.sum(), flush=True)
            return array

        held.append(show())
        refused(latest)
        first = held[0].copy()
        held += [show(), show()]
        assert (held[0] == first).all()
        refused(latest)
        held.clear()
        image = latest()
        print("newest", image.header.stamp.sequence, vpc_client.Encoding(image.header.encoding).words, bytes(image.data))


def safety(directory, *cases):
    """What the dead man lets a robot do; then a stop."""
    seen = []
    for case in cases:
        sent, valid_until, now = (int(word) for word in case.split(","))
        command = vpc_client.TwistCommand()
        command.stamp.published_ns, command.valid_until_ns = sent, valid_until
        command.twist[:] = [0.5] * 6
        seen.append(vpc_client.twist_in_force(command, now)[5])
    print("in force", *seen)
    assert vpc_client.twist_in_force(None) == [0.0] * 6
    command.twist[3] = float("nan")
    assert vpc_client.twist_in_force(command, sent) == [0.0] * 6
    print("stopped after", vpc_client.stop(directory, patience_s=10.0))


def depths(directory):
    """Depths in a circle, in a near rectangle, and in a white rectangle painted into an image; then verdicts."""
    import numpy as np
    from PIL import Image
    from referee import Mask, Part, Referee

    circle = Part({"center": [850.0, 560.0], "half": [75.0, 75.0], "p": 2.0})
    print(*(round(circle.depth(np.array(p)), 6) for p in [(791.0, 560.0), (850.0, 560.0), (700.0, 560.0)]))
    near = Part({"center": [0.0, 0.0], "half": [150.0, 50.0], "p": 8.0})
    print(*(round(near.depth(np.array(p)), 2) for p in [(0.0, 20.0), (-10.0, 0.0), (0.0, 51.0)]))
    path = f"{directory}/mask.png"
    grey = np.zeros((300, 400), dtype=np.uint8)
    grey[100:200, 50:250] = 255
    Image.fromarray(grey).save(path)
    mask = Mask(path, 15.0)
    print(*(round(mask.depth(np.array(p)), 6) for p in [(59.75, 149.5), (249.0, 149.5), (149.5, 149.5), (39.5, 149.5)]))
    scene = {
        "camera": {"width": 400, "height": 300},
        "success": {"violation_px": 15.0, "convergence_px": 2.0},
        "occlusion": [{"name": "painted", "mask": "mask.png"}],
    }
    referee = Referee(scene, np.array([[10.0, 10.0]]), directory)
    for point in [(12.0, 8.0), (12.1, 8.0), (60.0, 150.0), (70.0, 150.0), (-14.0, 5.0), (-11.0, -11.0), (5.0, np.nan)]:
        pixels = np.array([point])
        print(referee.violation(pixels), referee.arrived(pixels))


if __name__ == "__main__":
    parts = (layout, codes, exchange, refusals, hears, images, safety, depths)
    {part.__name__: part for part in parts}[sys.argv[1]](*sys.argv[2:])
