//! The description of an arm that carries a camera.

use nalgebra::{Matrix3, Rotation3, RowVector3, Translation3, Vector3};

use crate::capsule::{Capsule, Cuboid};
use crate::kinematics::{Chain, JOINTS, Pose, Screw};
use crate::limits::{JointLimits, Limits};

/// Most walls of a workspace.
pub const MAX_WALLS: usize = scene::MAX_WALLS;
/// Most points that keep off them: the camera's origin and the scene's.
pub const MAX_POINTS: usize = scene::MAX_WALL_POINTS + 1;
/// Most capsules of an arm.
pub const MAX_CAPSULES: usize = scene::MAX_SHAPES;
/// Most boxes about it.
pub const MAX_BOXES: usize = scene::MAX_BOXES;
/// Most pairs whose distances are kept.
pub const MAX_PAIRS: usize = scene::MAX_PAIRS;
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
    /// Whether the elbow of seven joints turns by the rule of [`elbow`](crate::elbow), not held.
    pub is_elbow_free: bool,
    /// Where its points may be.
    pub walls: heapless::Vec<Wall, MAX_WALLS>,
    /// Points that keep off the walls, along camera axes from the camera, m.
    pub points: heapless::Vec<[f64; 3], MAX_POINTS>,
    /// Links that keep off each other, boxes and walls.
    pub shapes: Shapes,
}

impl From<&scene::Arm> for Arm {
    fn from(arm: &scene::Arm) -> Self {
        let screws = arm.joints.iter().map(|joint| Screw {
            axis: joint.axis.into(),
            point: joint.point.into(),
            slides: joint.slides,
        });
        let screws: heapless::Vec<Screw, JOINTS> = screws.collect();
        let camera = Pose::from_parts(Translation3::from(arm.translation), rotation(&arm.rotation));
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
            is_elbow_free: arm.is_elbow_free,
            walls: walls.collect(),
            points: points.collect(),
            shapes: shapes(arm),
        }
    }
}

/// Its links' shapes, what is about it, and which of them keep apart.
fn shapes(arm: &scene::Arm) -> Shapes {
    let capsules = arm.shapes.iter().map(|shape| Capsule {
        ends: shape.ends.map(Vector3::from),
        radius: shape.radius,
        joints: shape.joints,
    });
    let boxes = arm.boxes.iter().map(|known| Cuboid {
        center: known.center.into(),
        rotation: rotation(&known.rotation),
        half: known.half.into(),
    });
    let pairs = arm.pairs.iter().map(|pair| Pair {
        shape: pair.shape,
        other: match pair.other {
            scene::Other::Link(index) => Other::Link(index),
            scene::Other::Box(index) => Other::Box(index),
            scene::Other::Wall(index) => Other::Wall(index),
        },
    });
    Shapes {
        capsules: capsules.collect(),
        boxes: boxes.collect(),
        pairs: pairs.collect(),
        clearance: arm.clearance,
    }
}

fn rotation(rows: &[[f64; 3]; 3]) -> Rotation3<f64> {
    let rows = rows.map(RowVector3::from);
    Rotation3::from_matrix_unchecked(Matrix3::from_rows(&rows))
}

/// What a capsule keeps off.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Other {
    /// The capsule of this index, which fewer joints move.
    Link(u8),
    /// The box of this index.
    Box(u8),
    /// The wall of this index.
    Wall(u8),
}

/// Two bodies that keep apart.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Pair {
    /// Index of a capsule.
    pub shape: u8,
    /// The other body.
    pub other: Other,
}

/// The shapes of an arm's links and of what is about it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Shapes {
    /// Of the links.
    pub capsules: heapless::Vec<Capsule, MAX_CAPSULES>,
    /// That do not move.
    pub boxes: heapless::Vec<Cuboid, MAX_BOXES>,
    /// Which of them keep apart.
    pub pairs: heapless::Vec<Pair, MAX_PAIRS>,
    /// Least distance of each pair, m.
    pub clearance: f64,
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
