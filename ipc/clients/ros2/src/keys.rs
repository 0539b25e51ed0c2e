//! The keys of the configuration file.

use std::path::PathBuf;

use clap::{Args, ValueEnum};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use smart_default::SmartDefault;

/// The path of the scene is relative to the file. Some keys have a flag, which wins.
#[derive(Args, Clone, Debug, SmartDefault, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
#[schemars(title = "vpc-ros2", extend("required" = ["scene"]))]
pub struct Keys {
    /// The scene file of vpcd: its camera, and how many points there are.
    #[arg(long)]
    #[schemars(extend("x-allowed" = "a scene file, by the key `scene` or the flag --scene"))]
    pub scene: Option<PathBuf>,
    /// Directory of the shared memory.
    #[arg(long)]
    #[schemars(extend("x-default" = "/tmp/vpc-UID, the user's number"))]
    pub domain: Option<PathBuf>,
    /// The number that ROS calls ROS_DOMAIN_ID, which is not read from the environment.
    #[arg(long, default_value_t = 0)]
    #[schemars(range(max = 232))]
    pub ros_domain_id: u16,
    /// Addresses of the network interfaces to use, such as 127.0.0.1; none: all.
    #[arg(long, value_delimiter = ',')]
    #[schemars(extend("x-allowed" = "addresses of this machine"))]
    pub interfaces: Vec<String>,
    /// Name of the node, under which its services and overlays are: /vpcd/arm.
    #[arg(long, default_value = "/vpcd")]
    #[default = "/vpcd"]
    #[schemars(extend("x-allowed" = "an absolute name"))]
    pub node: String,
    /// How requests of services are numbered, which differs by the middleware of ROS.
    #[arg(long, value_enum, default_value_t)]
    pub services: Services,
    /// Oldest stamp that is taken.
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
    pub mount: Mount,
}

/// Where features come from.
#[derive(Clone, Debug, SmartDefault, PartialEq, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct CameraKeys {
    /// What is on `topic`; with `none` another program is the camera.
    pub features: FeaturesKind,
    /// apriltag_msgs/AprilTagDetectionArray or geometry_msgs/PolygonStamped.
    #[default = "/detections"]
    pub topic: String,
    /// sensor_msgs/CameraInfo, checked against the scene before anything is published; empty: not
    /// checked.
    #[default = "/camera/camera_info"]
    pub info: String,
    /// Whether points are those of rectified images, as apriltag_ros takes them: then P of
    /// CameraInfo counts, else K, and a distortion is refused. `frame` and `mount` are then those of
    /// the rectified image, which the R of a stereo pair turns.
    #[default = true]
    pub rectified: bool,
    /// Greatest difference of focal lengths and principal point between CameraInfo and scene.
    #[default = 2.0]
    #[schemars(range(min = 0, max = 100), extend("x-unit" = "px"))]
    pub tolerance_px: f64,
    /// `frame_id` that messages of the camera must have: x right, y down, z forward.
    #[default = "camera_optical_frame"]
    #[schemars(length(min = 1))]
    pub frame: String,
    /// Numbers of the tags whose centres are the points of the pattern, in its order.
    #[schemars(length(max = 8), inner(range(max = 65535)), extend("x-default" = "0, 1, ..."))]
    pub tags: Option<Vec<u32>>,
    /// Number of the one tag whose corners are the four points of the pattern: upper left, upper
    /// right, lower right, lower left.
    #[schemars(range(max = 65535), extend("x-default" = "centres of tags"))]
    pub corners_of: Option<u32>,
    /// Where the sender has the centre of the upper left pixel; the scene has it at (0, 0).
    #[schemars(range(min = 0, max = 0.5), extend("x-unit" = "px", "x-default" = "0.5 for tags, as the AprilTag library has it; 0 for points"))]
    pub pixel_centre: Option<f64>,
    /// Added to each stamp, as vpc-calib measures it.
    #[schemars(range(min = -1000, max = 1000), extend("x-unit" = "ms"))]
    pub stamp_offset_ms: f64,
    /// Reliability that is asked of the senders; best_effort takes both kinds.
    pub reliability: Reliability,
}

/// How the robot is commanded, and what it tells.
#[derive(Clone, Debug, SmartDefault, PartialEq, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct RobotKeys {
    /// How the robot tells the velocity that it carries out; with `none` another program is the
    /// robot, and nothing is commanded.
    pub executed: Executed,
    /// geometry_msgs/TwistStamped that is carried out, in the camera's, tool's or base's frame.
    #[default = "/vpcd/executed_twist"]
    pub twist: String,
    /// geometry_msgs/PoseStamped of the tool in the base; empty: none. Needed with `executed =
    /// "pose"`, and for twists in the base's frame.
    pub pose: String,
    /// sensor_msgs/JointState.
    #[default = "/joint_states"]
    pub joint_states: String,
    /// Names of the joints that are told in vpc/robot, base first; none: JointState is not read.
    #[schemars(length(max = 7), extend("x-allowed" = "at most 7 names"))]
    pub joints: Vec<String>,
    /// geometry_msgs/TwistStamped that vpcd commands; as MoveIt Servo subscribes to it.
    #[default = "/servo_node/delta_twist_cmds"]
    pub command: String,
    /// Whose velocity is commanded, along whose axes.
    pub command_frame: CommandFrame,
    /// `frame_id` of the tool.
    #[default = "tool0"]
    #[schemars(length(min = 1))]
    pub tool: String,
    /// `frame_id` of the robot's base.
    #[default = "base_link"]
    #[schemars(length(min = 1))]
    pub base: String,
    /// How long zero twists follow when vpcd's commands stop; then silence.
    #[default = 500.0]
    #[schemars(range(min = 100, max = 10000), extend("x-unit" = "ms"))]
    pub zeros_ms: f64,
    /// Reliability that commands are offered with; reliable matches both kinds of receivers.
    #[default(Reliability::Reliable)]
    pub command_reliability: Reliability,
    /// Reliability that is asked of the senders; best_effort takes both kinds.
    pub reliability: Reliability,
}

/// The camera on the tool, as a hand-eye calibration found it; where both are the same frame, zeros.
#[derive(Clone, Copy, Debug, PartialEq, SmartDefault, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Mount {
    /// The camera's origin in the tool's frame.
    #[schemars(inner(range(min = -2, max = 2)), extend("x-unit" = "m"))]
    pub translation: [f64; 3],
    /// The camera's rotation in it: axis times angle.
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
        /// AprilTags by number: apriltag_msgs/AprilTagDetectionArray.
        #[default]
        Tags,
        /// Points in the order of the pattern: geometry_msgs/PolygonStamped, px.
        Points,
        /// Nothing.
        None,
    }
    /// How the robot tells what it carries out.
    Executed {
        /// By TwistStamped.
        #[default]
        Twist,
        /// By the tool's pose, PoseStamped, whose change is measured.
        Pose,
        /// Not at all.
        None,
    }
    /// Frame of the commanded twist.
    CommandFrame {
        /// The camera's velocity along the camera's axes.
        #[default]
        Camera,
        /// The tool's velocity along the tool's axes.
        Tool,
        /// The tool's velocity along the base's axes.
        Base,
    }
    /// Quality of service.
    Reliability {
        /// As sensor data.
        #[default]
        BestEffort,
        /// Lost messages are sent again.
        Reliable,
    }
    /// How requests of services are numbered.
    Services {
        /// rmw_fastrtps, the default of ROS 2, and rmw_connextdds.
        #[default]
        Fastdds,
        /// rmw_cyclonedds.
        Cyclonedds,
    }
}
