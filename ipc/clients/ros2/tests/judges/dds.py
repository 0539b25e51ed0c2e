"""ROS 2 by CycloneDDS: names and types as rmw_cyclonedds has them, written by hand. Knows nothing of the gateway."""

import dataclasses
import time
import types

from cyclonedds.core import Policy, Qos
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl import types as t
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

LOOPBACK = """<CycloneDDS><Domain Id="any">
  <General><Interfaces><NetworkInterface address="127.0.0.1"/></Interfaces><AllowMulticast>false</AllowMulticast></General>
  <Discovery><ParticipantIndex>auto</ParticipantIndex><Peers><Peer address="127.0.0.1"/></Peers></Discovery>
</Domain></CycloneDDS>"""


def struct(package, name, /, **fields):
    """A type of ROS 2, `package::msg::dds_::name_`, with fields in their order on the wire."""
    kind = "srv" if name.startswith("Trigger") else "msg"
    typename = f"{package}.{kind}.dds_.{name}_"

    def body(namespace):
        namespace["__annotations__"].update(fields)
        namespace["__module__"] = __name__

    made = dataclasses.dataclass(types.new_class(name, (IdlStruct,), {"typename": typename}, body))
    globals()[name] = made
    return made


f32, f64, i32, u32, u8 = t.float32, t.float64, t.int32, t.uint32, t.uint8
struct("builtin_interfaces", "Time", sec=i32, nanosec=u32)
struct("std_msgs", "Header", stamp=Time, frame_id=str)
struct("std_msgs", "ColorRGBA", r=f32, g=f32, b=f32, a=f32)
struct("geometry_msgs", "Vector3", x=f64, y=f64, z=f64)
struct("geometry_msgs", "Twist", linear=Vector3, angular=Vector3)
struct("geometry_msgs", "TwistStamped", header=Header, twist=Twist)
struct("sensor_msgs", "JointState", header=Header, name=t.sequence[str], position=t.sequence[f64], velocity=t.sequence[f64], effort=t.sequence[f64])
struct("sensor_msgs", "RegionOfInterest", x_offset=u32, y_offset=u32, height=u32, width=u32, do_rectify=bool)
struct(
    "sensor_msgs", "CameraInfo", header=Header, height=u32, width=u32, distortion_model=str, d=t.sequence[f64],
    k=t.array[f64, 9], r=t.array[f64, 9], p=t.array[f64, 12], binning_x=u32, binning_y=u32, roi=RegionOfInterest,
)  # fmt: skip
ImagePoint = struct("apriltag_msgs", "Point", x=f64, y=f64)
Point = struct("geometry_msgs", "Point", x=f64, y=f64, z=f64)
struct("geometry_msgs", "Quaternion", x=f64, y=f64, z=f64, w=f64)
struct("geometry_msgs", "Pose", position=Point, orientation=Quaternion)
struct("geometry_msgs", "PoseStamped", header=Header, pose=Pose)
struct(
    "apriltag_msgs", "AprilTagDetection", family=str, id=i32, hamming=i32, goodness=f32, decision_margin=f32,
    centre=ImagePoint, corners=t.array[ImagePoint, 4], homography=t.array[f64, 9],
)  # fmt: skip
struct("apriltag_msgs", "AprilTagDetectionArray", header=Header, detections=t.sequence[AprilTagDetection])
struct("diagnostic_msgs", "KeyValue", key=str, value=str)
struct("diagnostic_msgs", "DiagnosticStatus", level=u8, name=str, message=str, hardware_id=str, values=t.sequence[KeyValue])
struct("diagnostic_msgs", "DiagnosticArray", header=Header, status=t.sequence[DiagnosticStatus])
struct(
    "visualization_msgs", "ImageMarker", header=Header, ns=str, id=i32, type=i32, action=i32, position=Point, scale=f32,
    outline_color=ColorRGBA, filled=u8, fill_color=ColorRGBA, lifetime=Time, points=t.sequence[Point],
    outline_colors=t.sequence[ColorRGBA],
)  # fmt: skip
# rmw_cyclonedds writes who asks, and its number, before the message.
struct("std_srvs", "Trigger_Request", client=t.uint64, number=t.int64, structure_needs_at_least_one_member=u8)
struct("std_srvs", "Trigger_Response", client=t.uint64, number=t.int64, success=bool, message=str)



class Garbage(IdlStruct, typename="apriltag_msgs.msg.dds_.AprilTagDetectionArray_"):
    """Not what its name says: a frame_id and a sequence that claim to be 4 GB long."""

    numbers: t.array[u32, 24]


Garbage = dataclasses.dataclass(Garbage)


class Bare(IdlStruct, typename="std_srvs.srv.dds_.Trigger_Request_"):
    """A request without the header that rmw_cyclonedds writes."""

    structure_needs_at_least_one_member: u8


Bare = dataclasses.dataclass(Bare)

CDR1 = Policy.DataRepresentation(use_cdrv0_representation=True)
RELIABLE = Policy.Reliability.Reliable(duration(seconds=1))


class Graph:
    """The node's endpoints. Subscribes to the command twice, as both kinds of receivers do."""

    def __init__(self, ros_domain_id, frames):
        self.domain = Domain(ros_domain_id, LOOPBACK)
        self.participant = DomainParticipant(ros_domain_id)
        self.tags = self.writer("rt/detections", AprilTagDetectionArray)
        self.infos = self.writer("rt/camera/camera_info", CameraInfo, reliable=False)
        self.joint_states = self.writer("rt/joint_states", JointState)
        self.executed_twists = self.writer("rt/vpcd/executed_twist", TwistStamped, reliable=False)
        self.poses = self.writer("rt/tool_pose", PoseStamped)
        self.wishes = self.writer("rt/wish", TwistStamped)
        self.commands = self.reader("rt/servo_node/delta_twist_cmds", TwistStamped)
        self.commands_too = self.reader("rt/servo_node/delta_twist_cmds", TwistStamped, reliable=False)
        self.diagnostics = self.reader("rt/diagnostics", DiagnosticArray)
        self.overlays = {word: self.reader(f"rt/vpcd/overlay/{word}", ImageMarker) for word in ("seen", "goal", "foreseen")}
        self.triggers = {word: Trigger(self, f"/vpcd/{word}") for word in ("arm", "arm_despite", "disarm", "stop", "teach")}
        self.last, self.drawn = {}, {}
        self.too = 0

    def writer(self, topic, kind, reliable=True):
        qos = Qos(RELIABLE if reliable else Policy.Reliability.BestEffort, Policy.History.KeepLast(10), CDR1)
        return DataWriter(self.participant, Topic(self.participant, topic, kind), qos)

    def reader(self, topic, kind, reliable=True):
        qos = Qos(RELIABLE if reliable else Policy.Reliability.BestEffort, Policy.History.KeepLast(10), CDR1)
        return DataReader(self.participant, Topic(self.participant, topic, kind), qos)

    def twists(self):
        self.too += len(values(self.commands_too))
        for value in values(self.commands):
            v, w, at = value.twist.linear, value.twist.angular, value.header.stamp
            yield value.header.frame_id, [v.x, v.y, v.z, w.x, w.y, w.z], at.sec * 10**9 + at.nanosec

    def joints(self, head, names, q, dq):
        self.joint_states.write(JointState(header(head), names, q, dq, []))

    def executed(self, head, twist):
        self.executed_twists.write(TwistStamped(header(head), Twist(Vector3(*twist[:3]), Vector3(*twist[3:]))))

    def wish(self, head, twist):
        self.wishes.write(TwistStamped(header(head), Twist(Vector3(*twist[:3]), Vector3(*twist[3:]))))

    def pose(self, head, at, turn):
        self.poses.write(PoseStamped(header(head), Pose(Point(*at), Quaternion(*turn))))

    def info(self, head, c, d):
        k = [c["fx"], 0.0, c["cx"], 0.0, c["fy"], c["cy"], 0.0, 0.0, 1.0]
        p = [*k[:3], 0.0, *k[3:6], 0.0, *k[6:], 0.0]
        one = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
        roi = RegionOfInterest(0, 0, 0, 0, False)
        self.infos.write(CameraInfo(header(head), int(c["height"]), int(c["width"]), "plumb_bob", d, k, one, p, 0, 0, roi))

    def features(self, head, tags):
        # The AprilTag library has the centre of the first pixel at (0.5, 0.5).
        def tag(number, pair):
            u, v = pair[0] + 0.5, pair[1] + 0.5
            corners = [ImagePoint(u + x, v + y) for x, y in ((-9, 9), (9, 9), (9, -9), (-9, -9))]
            return AprilTagDetection("tag36h11", number, 0, 0.0, 60.0, ImagePoint(u, v), corners, [0.0] * 9)

        self.tags.write(AprilTagDetectionArray(header(head), [tag(*each) for each in tags]))

    def raw(self):
        writer = DataWriter(self.participant, Topic(self.participant, "rt/detections", Garbage), Qos(RELIABLE, CDR1))
        for number in (0, 7, 2**31, 2**32 - 1):
            time.sleep(0.3)
            writer.write(Garbage([number] * 24))

    def raw_stop(self):
        """As rmw_fastrtps asks: without a header."""
        writer = DataWriter(self.participant, Topic(self.participant, "rq/vpcd/stopRequest", Bare), Qos(RELIABLE, CDR1))
        deadline = time.monotonic() + 5.0
        while not matched(writer) and time.monotonic() < deadline:
            time.sleep(0.01)
        writer.write(Bare(0))
        self.bare = writer

    def ready(self, name):
        trigger = self.triggers[name]
        return matched(trigger.requests) and matched(trigger.replies)

    def send(self, name):
        self.triggers[name].send()

    def reply(self, name):
        return self.triggers[name].reply()

    def state(self):
        """Of vpcd, as /diagnostics has it."""
        self.told()
        return self.last.get("/vpcd: vpcd", {}).get("message", "")

    def told(self):
        for value in values(self.diagnostics):
            for status in value.status:
                pairs = {pair.key: pair.value for pair in status.values}
                self.last[status.name] = {"level": status.level, "message": status.message, "values": pairs}
        for word, reader in self.overlays.items():
            for marker in values(reader):
                self.drawn[word] = [[p.x, p.y] for p in marker.points]
        endpoints = (self.tags, self.infos, self.joint_states, self.executed_twists, self.commands, self.commands_too, self.diagnostics)
        names = ("tags", "infos", "joint_states", "executed_twists", "commands", "commands_too", "diagnostics")
        matches = {name: matched(endpoint) for name, endpoint in zip(names, endpoints)}
        return {"diagnostics": self.last, "overlay": self.drawn, "matched": matches, "best_effort_twists": self.too}


def header(head):
    return Header(Time(**head["stamp"]), head["frame_id"])


def values(reader):
    """What came, without the notes that a writer is gone."""
    return [sample for sample in reader.take(N=1000) if sample.sample_info.valid_data]


class Trigger:
    """A client of std_srvs/Trigger, as rmw_cyclonedds is one."""

    def __init__(self, graph, name):
        self.requests = graph.writer(f"rq{name}Request", Trigger_Request)
        self.replies = graph.reader(f"rr{name}Reply", Trigger_Response)
        self.client, self.number = time.monotonic_ns(), 0

    def send(self):
        self.number += 1
        self.requests.write(Trigger_Request(self.client, self.number, 0))

    def reply(self):
        for reply in values(self.replies):
            if (reply.client, reply.number) == (self.client, self.number):
                return reply.success, reply.message
        return None


def matched(endpoint):
    if isinstance(endpoint, DataWriter):
        return len(endpoint.get_matched_subscriptions()) > 0
    return len(endpoint.get_matched_publications()) > 0
