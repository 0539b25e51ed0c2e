//! The messages of ROS 2 that the gateway speaks, field by field as their packages have them, which
//! is how they are laid out on the wire (CDR).

use serde::{Deserialize, Serialize};

/// Declares messages: the package, then each struct with its fields in the order of the package.
macro_rules! messages {
    ($($(#[doc = $doc:literal])+ $name:ident($package:literal, $type_name:literal) {
        $($field:ident: $type:ty,)*
    })+) => {$(
        $(#[doc = $doc])+
        #[allow(missing_docs)]
        #[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
        pub struct $name {
            $(pub $field: $type,)*
        }

        impl Named for $name {
            const PACKAGE: &'static str = $package;
            const TYPE: &'static str = $type_name;
        }
    )+};
}

/// Package and name of a type.
pub trait Named {
    /// The package, such as `geometry_msgs`.
    const PACKAGE: &'static str;
    /// The name in it, such as `TwistStamped`.
    const TYPE: &'static str;
}

messages! {
    /// An instant, or a duration.
    Time("builtin_interfaces", "Time") { sec: i32, nanosec: u32, }
    /// When, and in which frame.
    Header("std_msgs", "Header") { stamp: Time, frame_id: String, }
    /// A colour, 0 to 1.
    ColorRGBA("std_msgs", "ColorRGBA") { r: f32, g: f32, b: f32, a: f32, }
    /// A vector, m or rad.
    Vector3("geometry_msgs", "Vector3") { x: f64, y: f64, z: f64, }
    /// A point, m.
    Point("geometry_msgs", "Point") { x: f64, y: f64, z: f64, }
    /// A point; here px.
    Point32("geometry_msgs", "Point32") { x: f32, y: f32, z: f32, }
    /// A rotation.
    Quaternion("geometry_msgs", "Quaternion") { x: f64, y: f64, z: f64, w: f64, }
    /// A pose.
    Pose("geometry_msgs", "Pose") { position: Point, orientation: Quaternion, }
    /// A pose with its head.
    PoseStamped("geometry_msgs", "PoseStamped") { header: Header, pose: Pose, }
    /// Points in order.
    Polygon("geometry_msgs", "Polygon") { points: Vec<Point32>, }
    /// Points in order, with their head.
    PolygonStamped("geometry_msgs", "PolygonStamped") { header: Header, polygon: Polygon, }
    /// A velocity, m/s and rad/s.
    Twist("geometry_msgs", "Twist") { linear: Vector3, angular: Vector3, }
    /// A velocity with its head.
    TwistStamped("geometry_msgs", "TwistStamped") { header: Header, twist: Twist, }
    /// Joints by name.
    JointState("sensor_msgs", "JointState") {
        header: Header,
        name: Vec<String>,
        position: Vec<f64>,
        velocity: Vec<f64>,
        effort: Vec<f64>,
    }
    /// A part of an image.
    RegionOfInterest("sensor_msgs", "RegionOfInterest") {
        x_offset: u32, y_offset: u32, height: u32, width: u32, do_rectify: bool,
    }
    /// A camera's size, lens and rectified pinhole.
    CameraInfo("sensor_msgs", "CameraInfo") {
        header: Header,
        height: u32,
        width: u32,
        distortion_model: String,
        d: Vec<f64>,
        k: [f64; 9],
        r: [f64; 9],
        p: [f64; 12],
        binning_x: u32,
        binning_y: u32,
        roi: RegionOfInterest,
    }
    /// A point of an image, px.
    ImagePoint("apriltag_msgs", "Point") { x: f64, y: f64, }
    /// A tag. Corners as the AprilTag library has them: lower left, lower right, upper right, upper
    /// left of the upright tag.
    AprilTagDetection("apriltag_msgs", "AprilTagDetection") {
        family: String,
        id: i32,
        hamming: i32,
        goodness: f32,
        decision_margin: f32,
        centre: ImagePoint,
        corners: [ImagePoint; 4],
        homography: [f64; 9],
    }
    /// The tags of an image.
    AprilTagDetectionArray("apriltag_msgs", "AprilTagDetectionArray") {
        header: Header,
        detections: Vec<AprilTagDetection>,
    }
    /// A name and a value.
    KeyValue("diagnostic_msgs", "KeyValue") { key: String, value: String, }
    /// How something is: level 0 ok, 1 warning, 2 error, 3 stale.
    DiagnosticStatus("diagnostic_msgs", "DiagnosticStatus") {
        level: u8,
        name: String,
        message: String,
        hardware_id: String,
        values: Vec<KeyValue>,
    }
    /// How things are.
    DiagnosticArray("diagnostic_msgs", "DiagnosticArray") {
        header: Header,
        status: Vec<DiagnosticStatus>,
    }
    /// A drawing over an image.
    ImageMarker("visualization_msgs", "ImageMarker") {
        header: Header,
        ns: String,
        id: i32,
        // LINE_LIST 2, POINTS 4 and so on.
        r#type: i32,
        action: i32,
        position: Point,
        scale: f32,
        outline_color: ColorRGBA,
        filled: u8,
        fill_color: ColorRGBA,
        lifetime: Time,
        points: Vec<Point>,
        outline_colors: Vec<ColorRGBA>,
    }
    /// Nothing: on the wire a struct has one byte at least.
    TriggerRequest("std_srvs", "Trigger") { structure_needs_at_least_one_member: u8, }
    /// What became of it.
    TriggerResponse("std_srvs", "Trigger") { success: bool, message: String, }
}

impl ros2_client::Message for TriggerRequest {}
impl ros2_client::Message for TriggerResponse {}

impl Twist {
    /// From vx vy vz wx wy wz.
    pub fn from_array([x, y, z, wx, wy, wz]: [f64; 6]) -> Self {
        Self {
            linear: Vector3 { x, y, z },
            angular: Vector3 {
                x: wx,
                y: wy,
                z: wz,
            },
        }
    }

    /// As vx vy vz wx wy wz.
    pub fn array(&self) -> [f64; 6] {
        let (v, w) = (&self.linear, &self.angular);
        [v.x, v.y, v.z, w.x, w.y, w.z]
    }
}
