//! The keys of the configuration file.

use std::path::PathBuf;

use clap::{Args, ValueEnum};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use smart_default::SmartDefault;

/// Paths are relative to the file. Some keys have a flag, which wins.
#[derive(Args, Clone, Debug, SmartDefault, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
#[schemars(title = "vpc-ros2", extend("required" = ["scene"]))]
pub struct Keys {
    /// The scene of vpcd.
    #[arg(long)]
    #[schemars(extend("x-allowed" = "a file; also by --scene"))]
    pub scene: Option<PathBuf>,
    /// Directory of the domain.
    #[arg(long)]
    #[schemars(extend("x-default" = "/tmp/vpc-UID"))]
    pub domain: Option<PathBuf>,
    /// ROS_DOMAIN_ID; the environment's is not read.
    #[arg(long, default_value_t = 0)]
    #[schemars(range(max = 232))]
    pub ros_domain_id: u16,
    /// Network interfaces to use, such as 127.0.0.1; none: all.
    #[arg(long, value_delimiter = ',')]
    #[schemars(extend("x-allowed" = "addresses of this machine"))]
    pub interfaces: Vec<String>,
    /// Name of the node; its services and overlays are below it, such as /vpcd/arm.
    #[arg(long, default_value = "/vpcd")]
    #[default = "/vpcd"]
    #[schemars(extend("x-allowed" = "an absolute name"))]
    pub node: String,
    /// Middleware of ROS, which decides how service requests are numbered.
    #[arg(long, value_enum, default_value_t)]
    pub services: Services,
    /// Greatest age of a stamp; older messages are refused.
    #[arg(skip = 200.0)]
    #[default = 200.0]
    #[schemars(range(min = 1, max = 10000), extend("x-unit" = "ms"))]
    pub max_age_ms: f64,
    #[arg(skip)]
    #[allow(missing_docs)]
    pub camera: CameraKeys,
    #[arg(skip)]
    #[allow(missing_docs)]
    pub robot: RobotKeys,
    #[arg(skip)]
    #[allow(missing_docs)]
    pub policy: PolicyKeys,
    #[arg(skip)]
    #[allow(missing_docs)]
    pub mount: Mount,
}

/// Where features come from.
#[derive(Clone, Debug, SmartDefault, PartialEq, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct CameraKeys {
    /// What `topic` carries.
    pub features: FeaturesKind,
    /// Topic of the features.
    #[default = "/detections"]
    pub topic: String,
    /// sensor_msgs/CameraInfo, which must agree with the scene before anything is published; empty:
    /// no check.
    #[default = "/camera/camera_info"]
    pub info: String,
    /// Whether points are in rectified images, as in apriltag_ros: then P of CameraInfo counts, and
    /// `frame` and `mount` are of the rectified image (a stereo pair's R turns it); else K counts,
    /// and a distortion is refused.
    #[default = true]
    pub rectified: bool,
    /// Greatest difference of CameraInfo from the scene, in focal lengths and principal point.
    #[default = 2.0]
    #[schemars(range(min = 0, max = 100), extend("x-unit" = "px"))]
    pub tolerance_px: f64,
    /// Required `frame_id` of the camera's messages: x right, y down, z forward.
    #[default = "camera_optical_frame"]
    #[schemars(length(min = 1))]
    pub frame: String,
    /// Numbers of the tags at the points of the pattern, in its order.
    #[schemars(length(max = 8), inner(range(max = 65535)), extend("x-default" = "0, 1, ..."))]
    pub tags: Option<Vec<u32>>,
    /// Number of the one tag with corners that are the pattern's points: upper left, upper right,
    /// lower right, lower left.
    #[schemars(range(max = 65535), extend("x-default" = "none"))]
    pub corners_of: Option<u32>,
    /// The sender's coordinate of the upper left pixel's center; it is 0 in the scene.
    #[schemars(range(min = 0, max = 0.5), extend("x-unit" = "px", "x-default" = "0.5 for tags, 0 for points"))]
    pub pixel_centre: Option<f64>,
    /// Offset of each stamp, as `vpc-calib` measures it.
    #[schemars(range(min = -1000, max = 1000), extend("x-unit" = "ms"))]
    pub stamp_offset_ms: f64,
    /// Reliability requested of senders; `best_effort` matches both kinds.
    pub reliability: Reliability,
}

/// How the robot is commanded, and what it reports.
#[derive(Clone, Debug, SmartDefault, PartialEq, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct RobotKeys {
    /// How the robot reports its executed velocity.
    pub executed: Executed,
    /// geometry_msgs/TwistStamped: the executed twist, in the frame of camera, tool or base.
    #[default = "/vpcd/executed_twist"]
    pub twist: String,
    /// geometry_msgs/PoseStamped of the tool in the base; needed with `executed = "pose"` and for
    /// twists in the base's frame.
    pub pose: String,
    /// sensor_msgs/JointState.
    #[default = "/joint_states"]
    pub joint_states: String,
    /// Joints reported in `vpc/robot`, base first; none: JointState is not read.
    #[schemars(length(max = 7), extend("x-allowed" = "at most 7 names"))]
    pub joints: Vec<String>,
    /// geometry_msgs/TwistStamped, the command, as MoveIt Servo takes it.
    #[default = "/servo_node/delta_twist_cmds"]
    pub command: String,
    /// Frame of the commanded velocity.
    pub command_frame: CommandFrame,
    /// `frame_id` of the tool.
    #[default = "tool0"]
    #[schemars(length(min = 1))]
    pub tool: String,
    /// `frame_id` of the robot's base.
    #[default = "base_link"]
    #[schemars(length(min = 1))]
    pub base: String,
    /// Time of zero twists after the last command of vpcd; then silence.
    #[default = 500.0]
    #[schemars(range(min = 100, max = 10000), extend("x-unit" = "ms"))]
    pub zeros_ms: f64,
    /// Reliability offered for commands; `reliable` matches both kinds of receivers.
    #[default(Reliability::Reliable)]
    pub command_reliability: Reliability,
    /// Reliability requested of senders; `best_effort` matches both kinds.
    pub reliability: Reliability,
}

/// What another program wants of the camera, for `law.strategy = "follow"` of vpcd.
#[derive(Clone, Debug, SmartDefault, PartialEq, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct PolicyKeys {
    /// geometry_msgs/TwistStamped, in the frame of camera, tool or base; empty: none.
    pub desired: String,
    /// For how long a twist counts after its stamp.
    #[default = 200.0]
    #[schemars(range(min = 1, max = 500), extend("x-unit" = "ms"))]
    pub valid_ms: f64,
    /// Reliability requested of senders; `best_effort` matches both kinds.
    pub reliability: Reliability,
}

/// The hand-eye calibration: the camera on the tool; zeros if both are one frame.
#[derive(Clone, Copy, Debug, PartialEq, SmartDefault, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Mount {
    /// Origin of the camera in the tool's frame.
    #[schemars(inner(range(min = -2, max = 2)), extend("x-unit" = "m"))]
    pub translation: [f64; 3],
    /// Rotation of the camera in the tool's frame: axis times angle.
    #[schemars(inner(range(min = -360, max = 360)), extend("x-unit" = "deg"))]
    pub rotation_deg: [f64; 3],
}

/// Declares a choice of the configuration.
macro_rules! choices {
    ($($(#[doc = $doc:literal])+ $name:ident { $($(#[doc = $value_doc:literal])+ $(#[$default:ident])? $value:ident,)+ })+) => {$(
        $(#[doc = $doc])+
        #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum, Deserialize, Serialize, JsonSchema)]
        #[serde(rename_all = "snake_case")]
        #[value(rename_all = "snake_case")]
        pub enum $name {
            $($(#[doc = $value_doc])+ $(#[$default])? $value,)+
        }
    )+};
}

choices! {
    /// What features are made from.
    FeaturesKind {
        /// apriltag_msgs/AprilTagDetectionArray.
        #[default]
        Tags,
        /// geometry_msgs/PolygonStamped: points in the pattern's order, px.
        Points,
        /// Nothing: another program is the camera.
        None,
    }
    /// How the robot tells what it carries out.
    Executed {
        /// By `twist`.
        #[default]
        Twist,
        /// By the change of `pose`.
        Pose,
        /// Not at all: another program is the robot, and nothing is commanded.
        None,
    }
    /// Frame of the commanded twist.
    CommandFrame {
        /// Camera's velocity and axes.
        #[default]
        Camera,
        /// Tool's velocity and axes.
        Tool,
        /// Tool's velocity in the base's axes.
        Base,
    }
    /// Quality of service.
    Reliability {
        /// As for sensor data.
        #[default]
        BestEffort,
        /// Lost messages are sent again.
        Reliable,
    }
    /// How requests of services are numbered.
    Services {
        /// rmw_fastrtps (the default of ROS 2) and rmw_connextdds.
        #[default]
        Fastdds,
        /// rmw_cyclonedds.
        Cyclonedds,
    }
}
