"""ROS 2 by rclpy: its own client library over rmw_fastrtps. Has no apriltag_msgs, so that features go as PolygonStamped."""

import os

os.environ.update(ROS_AUTOMATIC_DISCOVERY_RANGE="LOCALHOST", RMW_IMPLEMENTATION="rmw_fastrtps_cpp")

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import Point, Point32, PolygonStamped, PoseStamped, Quaternion, TwistStamped, Vector3
from rclpy.qos import QoSProfile, qos_profile_sensor_data, qos_profile_system_default
from sensor_msgs.msg import CameraInfo, JointState
from std_srvs.srv import Trigger
from visualization_msgs.msg import ImageMarker


class Graph:
    """The node's endpoints. Subscribes to the command as MoveIt Servo does, old and new."""

    def __init__(self, ros_domain_id, frames):
        rclpy.init(domain_id=ros_domain_id)
        self.node = node = rclpy.create_node("peer")
        self.points = node.create_publisher(PolygonStamped, "/points", 10)
        self.infos = node.create_publisher(CameraInfo, "/camera/camera_info", qos_profile_sensor_data)
        self.joint_states = node.create_publisher(JointState, "/joint_states", 10)
        self.executed_twists = node.create_publisher(TwistStamped, "/vpcd/executed_twist", qos_profile_sensor_data)
        self.poses = node.create_publisher(PoseStamped, "/tool_pose", 10)
        self.heard, self.too, self.last, self.drawn, self.calls = [], 0, {}, {}, {}
        command = "/servo_node/delta_twist_cmds"
        self.subscriptions = [
            node.create_subscription(TwistStamped, command, self.heard.append, QoSProfile(depth=10)),
            node.create_subscription(TwistStamped, command, self.count, qos_profile_system_default),
            node.create_subscription(DiagnosticArray, "/diagnostics", self.diagnose, 10),
        ]
        for word in ("seen", "goal", "foreseen"):
            draw = lambda marker, word=word: self.drawn.update({word: [[p.x, p.y] for p in marker.points]})
            self.subscriptions.append(node.create_subscription(ImageMarker, f"/vpcd/overlay/{word}", draw, 10))
        self.triggers = {word: node.create_client(Trigger, f"/vpcd/{word}") for word in ("arm", "arm_despite", "disarm", "stop", "teach")}

    def count(self, _):
        self.too += 1

    def diagnose(self, array):
        for status in array.status:
            pairs = {pair.key: pair.value for pair in status.values}
            level = int.from_bytes(status.level, "little")
            self.last[status.name] = {"level": level, "message": status.message, "values": pairs}

    def twists(self):
        for _ in range(20):
            rclpy.spin_once(self.node, timeout_sec=0.0)
        heard, self.heard[:] = list(self.heard), []
        for value in heard:
            v, w, at = value.twist.linear, value.twist.angular, value.header.stamp
            yield value.header.frame_id, [v.x, v.y, v.z, w.x, w.y, w.z], at.sec * 10**9 + at.nanosec

    def joints(self, head, names, q, dq):
        self.joint_states.publish(headed(JointState(name=names, position=q, velocity=dq), head))

    def executed(self, head, twist):
        message = headed(TwistStamped(), head)
        x, y, z, wx, wy, wz = twist
        message.twist.linear, message.twist.angular = Vector3(x=x, y=y, z=z), Vector3(x=wx, y=wy, z=wz)
        self.executed_twists.publish(message)

    def pose(self, head, at, turn):
        message = headed(PoseStamped(), head)
        message.pose.position = Point(x=at[0], y=at[1], z=at[2])
        message.pose.orientation = Quaternion(x=turn[0], y=turn[1], z=turn[2], w=turn[3])
        self.poses.publish(message)

    def info(self, head, c, d):
        k = [c["fx"], 0.0, c["cx"], 0.0, c["fy"], c["cy"], 0.0, 0.0, 1.0]
        p = [*k[:3], 0.0, *k[3:6], 0.0, *k[6:], 0.0]
        size = {"height": int(c["height"]), "width": int(c["width"])}
        self.infos.publish(headed(CameraInfo(**size, distortion_model="plumb_bob", d=d, k=k, p=p), head))

    def features(self, head, tags):
        message = headed(PolygonStamped(), head)
        message.polygon.points = [Point32(x=u, y=v, z=0.0) for _, (u, v) in tags]
        self.points.publish(message)

    def ready(self, name):
        return self.triggers[name].service_is_ready()

    def send(self, name):
        self.calls[name] = self.triggers[name].call_async(Trigger.Request())

    def reply(self, name):
        call = self.calls[name]
        return (call.result().success, call.result().message) if call.done() else None

    def state(self):
        """Of vpcd, as /diagnostics has it."""
        return self.last.get("/vpcd: vpcd", {}).get("message", "")

    def told(self):
        commands = self.node.get_publishers_info_by_topic("/servo_node/delta_twist_cmds")
        nodes = [f"{namespace.rstrip('/')}/{name}" for name, namespace in self.node.get_node_names_and_namespaces()]
        count = {"points": self.points, "infos": self.infos, "joint_states": self.joint_states}
        matches = {name: publisher.get_subscription_count() > 0 for name, publisher in count.items()}
        told = {"diagnostics": self.last, "overlay": self.drawn, "best_effort_twists": self.too, "matched": matches}
        return {**told, "nodes": nodes, "commanders": [each.node_name for each in commands]}


def headed(message, head):
    message.header.frame_id = head["frame_id"]
    message.header.stamp.sec, message.header.stamp.nanosec = head["stamp"]["sec"], head["stamp"]["nanosec"]
    return message
