//! The checked scene. Units: px, m, s, rad.

use heapless::{String, Vec};

use crate::mask::{Area, Mask};

/// Fewest points of a pattern: four coplanar points fix a pose by homography.
pub const MIN_POINTS: usize = 4;
/// Most points of a pattern.
pub const MAX_POINTS: usize = 8;
/// Most occlusions of a scene.
pub const MAX_OCCLUSIONS: usize = 12;
/// Most parts of one occlusion.
pub const MAX_PARTS: usize = 8;

/// A name of at most 32 bytes.
pub type Name = String<32>;

/// A checked scene: made by [`Scene::parse`] or [`Scene::read`] only, so that one that exists is valid.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct Scene {
    /// The camera.
    pub camera: Camera,
    /// Points of the pattern in the object frame, m, in the order in which features are stacked; all on z = 0.
    pub pattern: Vec<[f64; 3], MAX_POINTS>,
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
}

/// A pinhole camera without distortion; u to the right, v down, z forward. The centre of the first pixel, in the upper left
/// corner of the image, is (0, 0), as in OpenCV and ViSP: their calibrations count as they are.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Camera {
    /// Image width, px.
    pub width: f64,
    /// Image height, px.
    pub height: f64,
    /// Focal length along u, px.
    pub fx: f64,
    /// Focal length along v, px.
    pub fy: f64,
    /// Principal point, u, px.
    pub cx: f64,
    /// Principal point, v, px.
    pub cy: f64,
    /// Frame rate, Hz; the reciprocal of the sampling time.
    pub rate_hz: f64,
}

/// A pose of the object in the camera frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose {
    /// Translation, m.
    pub translation: [f64; 3],
    /// Rotation vector (axis times angle), rad.
    pub rotation: [f64; 3],
}

/// Limits on the size of each component of the camera velocity.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    /// Each linear component, m/s.
    pub linear: f64,
    /// Each angular component, rad/s.
    pub angular: f64,
}

/// Weights of the cost.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cost {
    /// Weight of the squared image error, 1/px^2: Q = k_q I.
    pub k_q: f64,
    /// Diagonal of R, the weight of the squared camera velocity (vx vy vz wx wy wz).
    pub r: [f64; 6],
}

/// What counts as success.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Success {
    /// A point deeper than this (Euclidean distance to the border) in an occlusion or outside the image is a
    /// violation, px.
    pub violation_px: f64,
    /// Largest component of s - s* that counts as arrived, px.
    pub convergence_px: f64,
    /// Time allowed for arriving, s.
    pub time_s: f64,
}

/// Where random starts are drawn from.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StartRegion {
    /// Least translation of the object in the camera frame, m.
    pub translation_min: [f64; 3],
    /// Greatest translation of the object in the camera frame, m.
    pub translation_max: [f64; 3],
    /// Greatest size of the rotation vector's x and y, rad; this rotation is applied first.
    pub tilt_max: f64,
    /// Greatest roll about the optical axis, rad; applied second.
    pub roll_max: f64,
    /// Least distance of every point from the image border and from every occlusion, px.
    pub clearance_px: f64,
    /// Least mean distance of the points from their goals, px.
    pub min_error_px: f64,
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
}

/// A part covers the points with (|u-c_u|/h_u)^p + (|v-c_v|/h_v)^p < 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Part {
    /// Centre (u, v), px.
    pub center: [f64; 2],
    /// Half sizes (u, v), px.
    pub half: [f64; 2],
    /// Exponent, 1 to 64: 2 an ellipse, 8 nearly a rectangle.
    pub p: f64,
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

    /// The sampling time, s.
    pub fn sampling_time(&self) -> f64 {
        1.0 / self.camera.rate_hz
    }
}
