//! The description of an arm that carries a camera.

use nalgebra::Vector3;

use crate::collision::Shapes;
use crate::kinematics::Chain;
use crate::limits::Limits;

/// Most walls of a workspace.
pub const MAX_WALLS: usize = 8;
/// Most points that keep off them.
pub const MAX_POINTS: usize = 4;

/// An arm that carries a camera.
#[derive(Clone, Debug, PartialEq)]
pub struct Arm {
    /// From its base to the camera, which is the end effector: x right, y down, z forward.
    pub chain: Chain,
    /// From its base to the end effector, whose velocity the bridge shapes.
    pub shaped: Chain,
    /// Limits of the joints.
    pub limits: Limits,
    /// Distance that joints keep from the ends of their ranges, rad, or m of those that slide.
    pub margin: f64,
    /// Greatest share of a joint's speed limit, 0 to 1.
    pub speed: f64,
    /// Greatest share of a joint's acceleration that the end effector's may take, 0 to 1: the
    /// nearness to a singular posture.
    pub strain: f64,
    /// Whether the elbow of seven joints turns by the rule of [`elbow`](crate::elbow), not held.
    pub is_elbow_free: bool,
    /// Where its points may be.
    pub walls: heapless::Vec<Wall, MAX_WALLS>,
    /// Points that keep off the walls, along camera axes from the camera, m.
    pub points: heapless::Vec<[f64; 3], MAX_POINTS>,
    /// Links that keep off each other, boxes and walls.
    pub shapes: Shapes,
}

/// A wall: points stay on the side that its normal shows to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Wall {
    /// Of length 1, base axes.
    pub normal: [f64; 3],
    /// How far the wall is from the base's origin along the normal, m.
    pub offset: f64,
}

impl Wall {
    /// How far a point in the base is on its side, m; negative beyond it.
    pub fn distance(&self, point: &Vector3<f64>) -> f64 {
        Vector3::from(self.normal).dot(point) - self.offset
    }
}
