//! The description of an arm that carries a camera.

use nalgebra::{Matrix3, Rotation3, RowVector3, Translation3, Vector3};

use crate::kinematics::{Chain, JOINTS, Pose, Screw};
use crate::limits::{JointLimits, Limits};

/// Most walls of a workspace.
pub const MAX_WALLS: usize = scene::MAX_WALLS;
/// Most points that keep off them: the camera's origin and the scene's.
pub const MAX_POINTS: usize = scene::MAX_WALL_POINTS + 1;
const _: () = assert!(JOINTS == scene::MAX_JOINTS);

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
    /// Where its points may be.
    pub walls: heapless::Vec<Wall, MAX_WALLS>,
    /// Points that keep off the walls, along camera axes from the camera, m.
    pub points: heapless::Vec<[f64; 3], MAX_POINTS>,
}

impl From<&scene::Arm> for Arm {
    fn from(arm: &scene::Arm) -> Self {
        let screws = arm.joints.iter().map(|joint| Screw {
            axis: joint.axis.into(),
            point: joint.point.into(),
            slides: joint.slides,
        });
        let screws: heapless::Vec<Screw, JOINTS> = screws.collect();
        let rows = arm.rotation.map(RowVector3::from);
        let rotation = Rotation3::from_matrix_unchecked(Matrix3::from_rows(&rows));
        let camera = Pose::from_parts(Translation3::from(arm.translation), rotation);
        let mut limits = [JointLimits::NONE; JOINTS];
        for (to, from) in limits.iter_mut().zip(&arm.joints) {
            *to = JointLimits::new(from.range, from.velocity, from.acceleration);
        }
        let walls = arm.walls.iter().map(|wall| Wall {
            normal: wall.normal,
            offset: wall.offset,
        });
        let points = core::iter::once([0.0; 3]).chain(arm.points.iter().copied());
        Self {
            chain: Chain::new(&screws, camera),
            shaped: Chain::new(&screws, Translation3::from(arm.end_effector).into()),
            limits: Limits(limits),
            margin: arm.margin,
            speed: arm.speed,
            strain: arm.strain,
            walls: walls.collect(),
            points: points.collect(),
        }
    }
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
