"""The Python side of mod.rs: `peer.py layout`, or `peer.py exchange DOMAIN`. Finds contract.py by PYTHONPATH."""

import ctypes
import sys

import contract


def layout():
    """Every message as `name size alignment`, its fields as `name.field offset size`, services with their queues."""
    for service, (message, *queues) in contract.SERVICES.items():
        print(service, message.type_name(), *queues)
    for message in (contract.Stamp, *(message for message, *_ in contract.SERVICES.values())):
        print(message.__name__, ctypes.sizeof(message), ctypes.alignment(message))
        for name, _ in message._fields_:
            field = getattr(message, name)
            print(f"{message.__name__}.{name}", field.offset, field.size)


def exchange(directory):
    """Sends features and a robot's state, receives a twist and a cycle's record, and prints what came."""
    domain = contract.Domain(directory)
    camera = contract.CameraPorts(domain)
    robot = domain.publisher("vpc/robot")
    cycles = domain.subscriber("vpc/cycles", 1024)

    state = contract.RobotState()
    state.stamp.sequence, state.stamp.published_ns, state.stamp.data_ns = 1, contract.now_ns(), 77
    state.features_sequence, state.mode, state.faults, state.joints = 5, 1, 2, 7
    for field in ("translation", "rotation", "twist", "q", "dq", "room"):
        numbers = getattr(state, field)
        offset = getattr(contract.RobotState, field).offset
        numbers[:] = [offset + i / 8 for i in range(len(numbers))]
    robot.send_copy(state)

    points = [(0.1, 2.25), (640.5, -3.75), (1e-3, 4.0), (5.0, 6.0), (7.0, 1 / 3)]
    sent = camera.publish(points, data_ns=123_456_789, exposure_ns=4_000_000, visible=0b10111)
    twist, code = camera.wait_for_answer(sent)
    print("twist", code, *map(repr, twist), flush=True)
    while (sample := cycles.receive()) is None:
        pass
    record = contract.CycleRecord.from_buffer_copy(sample.payload().contents)
    print("cycle", record.cycle, record.lost_records, record.np, record.state, end=" ")
    print(*map(repr, [*record.points, *record.way_point, *record.twist]), end=" ")
    print(repr(record.cost), repr(record.violation_px), repr(record.clearance_px), repr(record.error_px))

    reply = contract.OperatorPorts(domain).ask("strategy", "knn", 5, patience_s=contract.PATIENCE_S)
    print("reply", reply.stamp.data_ns, reply.action, reply.outcome, reply.state, reply.hold, reply.strategy, end=" ")
    print(reply.neighbours, flush=True)


if __name__ == "__main__":
    {"layout": layout, "exchange": exchange}[sys.argv[1]](*sys.argv[2:])
