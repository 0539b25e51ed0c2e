//! What a posture leaves of all that an arm keeps to.

use nalgebra::Point3;

use crate::damper;
use crate::description::Arm;
use crate::kinematics::Joints;

/// What a posture leaves; negative beyond what the arm keeps to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Slack {
    /// Of the joint that is nearest to an end of its range, beyond the margin, rad or m.
    pub joints: f64,
    /// To the greatest strain of singular postures, a share of a joint's acceleration.
    pub strain: f64,
    /// Of the point nearest to a wall, and of the nearest pair of bodies beyond its clearance, m.
    pub space: f64,
}

impl Slack {
    /// At `q`, where the camera may change its velocity by `accelerations`, m/s^2 and rad/s^2.
    pub fn at(arm: &Arm, q: &Joints, accelerations: &[f64; 6]) -> Self {
        let joints = arm.limits.0.iter().zip(q.iter()).take(arm.chain.count());
        let rooms = joints.flat_map(|(joint, q)| joint.room(*q));
        let strain = match accelerations.iter().all(|a| a.is_finite()) {
            true => damper::strain(arm, q, accelerations),
            false => 0.0,
        };
        let camera = arm.chain.pose(q);
        let points = arm.points.iter().map(|point| camera * Point3::from(*point));
        let walls = points.flat_map(|point| {
            let walls = arm.walls.iter();
            walls.map(move |wall| wall.distance(&point.coords))
        });
        let pairs = arm
            .distances(q)
            .map(|(_, distance)| distance - arm.shapes.clearance);
        Self {
            joints: rooms.fold(f64::INFINITY, f64::min) - arm.margin,
            strain: arm.strain - strain,
            space: walls.chain(pairs).fold(f64::INFINITY, f64::min),
        }
    }

    /// Whether each is at least that of `least`.
    pub fn is_at_least(&self, least: &Self) -> bool {
        self.joints >= least.joints && self.strain >= least.strain && self.space >= least.space
    }

    /// The lesser of each.
    pub fn min(&self, other: &Self) -> Self {
        Self {
            joints: self.joints.min(other.joints),
            strain: self.strain.min(other.strain),
            space: self.space.min(other.space),
        }
    }
}
