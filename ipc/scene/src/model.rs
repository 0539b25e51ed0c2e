//! The checked scene. Units: px, m, s, rad.

#[cfg(feature = "file")]
use core::f64::consts::PI;

use heapless::{String, Vec};
use mask::{Area, Mask};

/// Fewest points of a pattern: four coplanar points fix a pose by homography.
pub const MIN_POINTS: usize = 4;
/// Most points of a pattern.
pub const MAX_POINTS: usize = 8;
/// Most occlusions of a scene.
pub const MAX_OCCLUSIONS: usize = 12;
/// Most parts of one occlusion.
pub const MAX_PARTS: usize = 8;

/// Most joints of an arm.
pub const MAX_JOINTS: usize = 7;
/// Most walls of its workspace.
pub const MAX_WALLS: usize = 8;
/// Most points that keep behind them, beside the camera.
pub const MAX_WALL_POINTS: usize = 3;

/// Most collision shapes of its links.
pub const MAX_SHAPES: usize = 16;
/// Most boxes about it.
pub const MAX_BOXES: usize = 8;
/// Most pairs of a link and a link, box or wall that keep apart.
pub const MAX_PAIRS: usize = 128;

/// A name of at most 32 bytes.
pub type Name = String<32>;

/// A checked scene: made by [`Scene::parse`] or [`Scene::read`] only, so that one that exists is
/// valid.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct Scene {
    /// The camera.
    pub camera: Camera,
    /// Points of the pattern in the object frame, m, in the order in which features are stacked;
    /// all on z = 0.
    pub pattern: Vec<[f64; 3], MAX_POINTS>,
    /// Side of the square round each point that must stay in sight, m, in the plane of the pattern;
    /// 0: only the points themselves.
    pub marker_size: f64,
    /// Whether the file gives that size: without it, 0 only means that it is unknown.
    pub has_marker_size: bool,
    /// The object in the camera frame at the goal.
    pub goal: Pose,
    /// Limits of the camera velocity.
    pub limits: Limits,
    /// Weights of the cost.
    pub cost: Cost,
    /// What counts as success.
    pub success: Success,
    /// Where random starts are drawn from.
    pub starts: StartRegion,
    /// Areas of the image in which no feature may be.
    pub occlusions: Vec<Occlusion, MAX_OCCLUSIONS>,
    /// The arm that carries the camera, where it is known.
    pub arm: Option<Arm>,
}

/// The arm that carries the camera, where all its joints stand at zero, in the frame of its base.
#[derive(Clone, Debug, PartialEq)]
pub struct Arm {
    /// Base to camera.
    pub joints: Vec<ArmJoint, MAX_JOINTS>,
    /// The camera's origin, m.
    pub translation: [f64; 3],
    /// Rows of the rotation from the camera's axes (x right, y down, z forward) to the base's.
    pub rotation: [[f64; 3]; 3],
    /// The point whose velocity the robot's bridge shapes, m.
    pub end_effector: [f64; 3],
    /// Distance that joints keep from the ends of their ranges, rad, or m of those that slide.
    pub margin: f64,
    /// Greatest share of a joint's speed limit, 0 to 1.
    pub speed: f64,
    /// Greatest share of a joint's acceleration that the end effector's may take, 0 to 1.
    pub strain: f64,
    /// Whether joint 3 of seven, the elbow, turns away from the ends of the joints' ranges; else it
    /// is held.
    pub is_elbow_free: bool,
    /// Joint positions at which the camera sees the goal, rad; empty where they are not known.
    pub goal: Vec<f64, MAX_JOINTS>,
    /// Names of the joints in the URDF; empty where one is longer than a [`Name`].
    pub joint_names: Vec<Name, MAX_JOINTS>,
    /// Walls of its workspace.
    pub walls: Vec<Wall, MAX_WALLS>,
    /// Names of the walls; empty where the file gives none.
    pub wall_names: Vec<Name, MAX_WALLS>,
    /// Points that keep behind the walls beside the camera's origin, along camera axes, m.
    pub points: Vec<[f64; 3], MAX_WALL_POINTS>,
    /// Least distance of each pair, m.
    pub clearance: f64,
    /// Collision shapes of the links.
    pub shapes: Vec<Shape, MAX_SHAPES>,
    /// Names of their links in the URDF; empty where one is longer than a [`Name`].
    pub shape_links: Vec<Name, MAX_SHAPES>,
    /// Boxes about it.
    pub boxes: Vec<Cuboid, MAX_BOXES>,
    /// Names of the boxes; empty where the file gives none.
    pub box_names: Vec<Name, MAX_BOXES>,
    /// Which of them keep apart.
    pub pairs: Vec<Pair, MAX_PAIRS>,
}

impl Arm {
    /// The names of its joints, walls, collision shapes and boxes.
    pub fn names(&self) -> [&[Name]; 4] {
        [
            &self.joint_names,
            &self.wall_names,
            &self.shape_links,
            &self.box_names,
        ]
    }
}

/// A collision shape of a link: all that is no farther than a radius from a segment (a capsule).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shape {
    /// The ends of the segment, m; of a sphere the same.
    pub ends: [[f64; 3]; 2],
    /// m.
    pub radius: f64,
    /// How many joints move the link: 0 is the base's.
    pub joints: usize,
}

/// A box that does not move.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cuboid {
    /// Its middle, m.
    pub center: [f64; 3],
    /// Rows of the rotation from its axes to the base's.
    pub rotation: [[f64; 3]; 3],
    /// Half its edges, m.
    pub half: [f64; 3],
}

/// A shape, by its index, and what it keeps off.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Pair {
    /// Of the shapes.
    pub shape: u8,
    /// The other one.
    pub other: Other,
}

/// What a shape keeps off, by its index.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Other {
    /// A shape that fewer joints move.
    Link(u8),
    /// A box.
    Box(u8),
    /// A wall.
    Wall(u8),
}

/// A joint of an arm; m in place of rad where it slides.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ArmJoint {
    /// The direction about which it turns, or along which it slides, of length 1.
    pub axis: [f64; 3],
    /// A point on the axis, m.
    pub point: [f64; 3],
    /// Whether it slides.
    pub slides: bool,
    /// Least and greatest position, rad.
    pub range: [f64; 2],
    /// rad/s.
    pub velocity: f64,
    /// rad/s^2.
    pub acceleration: f64,
}

/// A wall: points stay on the side that its normal shows to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Wall {
    /// Of length 1.
    pub normal: [f64; 3],
    /// How far the wall is from the base's origin along the normal, m.
    pub offset: f64,
}

/// A table of the scene file: a struct that is read from TOML and has a JSON Schema with the
/// feature `file`. `#[key(..)]` is `#[schemars(..)]` then, and nothing without the feature.
macro_rules! table {
    ($(#[$meta:meta])* pub struct $name:ident {
        $($(#[doc = $text:literal])+ #[key($($schema:tt)*)] pub $field:ident: $type:ty,)+
    }) => {
        $(#[$meta])*
        #[derive(Clone, Copy, Debug, PartialEq)]
        #[cfg_attr(feature = "file", derive(serde::Deserialize, schemars::JsonSchema))]
        #[cfg_attr(feature = "file", serde(deny_unknown_fields))]
        pub struct $name {
            $($(#[doc = $text])+ #[cfg_attr(feature = "file", schemars($($schema)*))] pub $field: $type,)+
        }
    };
}

table! {
    /// A pinhole camera without distortion; u right, v down, z forward. The center of the upper
    /// left pixel is (0, 0), as in OpenCV and ViSP.
    pub struct Camera {
        /// Width of the image.
        #[key(range(min = 16, max = 16384), extend("multipleOf" = 1, "x-unit" = "px"))]
        pub width: f64,
        /// Height of the image.
        #[key(range(min = 16, max = 16384), extend("multipleOf" = 1, "x-unit" = "px"))]
        pub height: f64,
        /// Focal length along u.
        #[key(range(min = 10, max = 1e5), extend("x-unit" = "px"))]
        pub fx: f64,
        /// Focal length along v.
        #[key(range(min = 10, max = 1e5), extend("x-unit" = "px"))]
        pub fy: f64,
        /// Principal point, u; in the image.
        #[key(range(min = 0, max = 16384), extend("x-unit" = "px"))]
        pub cx: f64,
        /// Principal point, v; in the image.
        #[key(range(min = 0, max = 16384), extend("x-unit" = "px"))]
        pub cy: f64,
        /// Frame rate; its reciprocal is the control period.
        #[key(range(min = 1, max = 1000), extend("x-unit" = "Hz"))]
        pub rate_hz: f64,
    }
}

table! {
    /// A pose of the object in the camera frame (x right, y down, z forward).
    pub struct Pose {
        /// Translation; z from 0.001 m.
        #[key(inner(range(min = -100, max = 100)), extend("x-unit" = "m"))]
        pub translation: [f64; 3],
        /// Rotation vector: axis times angle.
        #[key(inner(range(min = -PI, max = PI)), extend("x-unit" = "rad"))]
        pub rotation: [f64; 3],
    }
}

table! {
    /// Limits of the camera's motion.
    pub struct Limits {
        /// Largest magnitude of each linear component.
        #[key(range(min = 1e-6, max = 10), extend("x-unit" = "m/s"))]
        pub linear: f64,
        /// Largest magnitude of each angular component.
        #[key(range(min = 1e-6, max = 30), extend("x-unit" = "rad/s"))]
        pub angular: f64,
        /// Largest acceleration of each linear component; none: no limit. A stop must take at most
        /// 5 s.
        #[key(range(min = 1e-6, max = 1e4), extend("x-unit" = "m/s^2"))]
        pub linear_acceleration: Option<f64>,
        /// Largest acceleration of each angular component; likewise.
        #[key(range(min = 1e-6, max = 1e4), extend("x-unit" = "rad/s^2"))]
        pub angular_acceleration: Option<f64>,
    }
}

impl Limits {
    /// The largest magnitude of each component: vx, vy, vz in m/s, wx, wy, wz in rad/s.
    pub fn velocity(&self) -> [f64; 6] {
        each(self.linear, self.angular)
    }

    /// The most change of each in a second, m/s^2 and rad/s^2; infinite where none is given.
    pub fn acceleration(&self) -> [f64; 6] {
        let [linear, angular] = [self.linear_acceleration, self.angular_acceleration];
        each(
            linear.unwrap_or(f64::INFINITY),
            angular.unwrap_or(f64::INFINITY),
        )
    }
}

fn each(linear: f64, angular: f64) -> [f64; 6] {
    core::array::from_fn(|k| if k < 3 { linear } else { angular })
}

table! {
    /// Weights of the cost.
    pub struct Cost {
        /// Weight of the squared image error: Q = k_q I.
        #[key(range(min = 1e-12, max = 1e6), extend("x-unit" = "1/px^2"))]
        pub k_q: f64,
        /// Diagonal of R, the weight of the squared camera velocity (vx vy vz wx wy wz), s^2/m^2
        /// and s^2/rad^2; the law lowers it toward the goal.
        #[key(inner(range(min = 0, max = 1e9)))]
        pub r: [f64; 6],
    }
}

table! {
    /// What counts as success.
    pub struct Success {
        /// A point deeper than this in an occlusion, or farther outside the image, is a violation.
        #[key(range(min = 0, max = 1e4), extend("x-unit" = "px"))]
        pub violation_px: f64,
        /// Largest component of s - s* that counts as arrived.
        #[key(range(min = 1e-6, max = 1e4), extend("x-unit" = "px"))]
        pub convergence_px: f64,
        /// Time limit for the arrival.
        #[key(range(min = 0.1, max = 3600), extend("x-unit" = "s"))]
        pub time_s: f64,
    }
}

table! {
    /// The region that random starts are drawn from.
    pub struct StartRegion {
        /// Least translation of the object in the camera frame; z from 0.001 m.
        #[key(inner(range(min = -100, max = 100)), extend("x-unit" = "m"))]
        pub translation_min: [f64; 3],
        /// Greatest translation.
        #[key(inner(range(min = -100, max = 100)), extend("x-unit" = "m"))]
        pub translation_max: [f64; 3],
        /// Greatest magnitude of the rotation vector's x and y, applied first.
        #[key(range(min = 0, max = 1.5), extend("x-unit" = "rad"))]
        pub tilt_max: f64,
        /// Greatest roll about the optical axis, applied second.
        #[key(range(min = 0, max = PI), extend("x-unit" = "rad"))]
        pub roll_max: f64,
        /// Least distance of every point, or of a sized marker's edge, from the image border and
        /// every occlusion.
        #[key(range(min = 0, max = 1e4), extend("x-unit" = "px"))]
        pub clearance_px: f64,
        /// Least mean distance of the points from the goal.
        #[key(range(min = 0, max = 1e4), extend("x-unit" = "px"))]
        pub min_error_px: f64,
    }
}

/// An area of the image in which no feature may be: the union of its parts and its mask.
#[derive(Clone, Debug, PartialEq)]
pub struct Occlusion {
    /// Its name, for messages.
    pub name: Name,
    /// At least one part, where there is no mask.
    pub parts: Vec<Part, MAX_PARTS>,
    /// Painted pixels.
    pub mask: Option<Mask>,
    /// Whether it is the object in the gripper, which leaves the view when it is released.
    pub grasped: bool,
    /// Whether it is dirt on the lens, which blurs what lies behind; else it hides that.
    pub on_lens: bool,
    /// Whether the law may take points behind it for a short time.
    pub crossable: bool,
}

table! {
    /// A part covers the points with (|u-c_u|/h_u)^p + (|v-c_v|/h_v)^p < 1.
    pub struct Part {
        /// Center (u, v).
        #[key(inner(range(min = -1e5, max = 1e5)), extend("x-unit" = "px"))]
        pub center: [f64; 2],
        /// Half sizes (u, v).
        #[key(inner(range(min = 1e-3, max = 1e5)), extend("x-unit" = "px"))]
        pub half: [f64; 2],
        /// Exponent: 2 is an ellipse, 8 nearly a rectangle.
        #[key(range(min = 1, max = 64))]
        pub p: f64,
    }
}

impl Camera {
    /// All its numbers, in the order of the fields.
    pub const fn numbers(&self) -> [f64; 7] {
        let [width, height] = [self.width, self.height];
        [
            width,
            height,
            self.fx,
            self.fy,
            self.cx,
            self.cy,
            self.rate_hz,
        ]
    }
}

impl Scene {
    /// Every part of every occlusion, in the order of the file.
    pub fn parts(&self) -> impl Iterator<Item = &Part> {
        self.occlusions
            .iter()
            .flat_map(|occlusion| &occlusion.parts)
    }

    /// The mask of every occlusion that has one, in the order of the file.
    pub fn masks(&self) -> impl Iterator<Item = &Mask> {
        self.occlusions
            .iter()
            .filter_map(|occlusion| occlusion.mask.as_ref())
    }

    /// Every area of every mask, in the order of the file: at most [`crate::MAX_AREAS`].
    pub fn areas(&self) -> impl Iterator<Item = &'static Area> {
        self.masks().flat_map(|mask| mask.areas())
    }

    /// Whether an occlusion may be crossed.
    pub fn is_crossable(&self) -> bool {
        self.occlusions.iter().any(|occlusion| occlusion.crossable)
    }

    /// The sampling time, s.
    pub fn sampling_time(&self) -> f64 {
        1.0 / self.camera.rate_hz
    }
}
