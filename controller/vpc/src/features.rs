//! Visual features: the image points of the pattern, and the area and orientation of their polygon.

use core::f64::consts::PI;

use heapless::Vec;
use libm::{atan2, sqrt};
use serde::{Deserialize, Serialize};

use crate::MAX_POINTS;

/// Image points in px, in the order of the pattern: the paper's s with u and v kept in pairs.
pub type Points = Vec<[f64; 2], MAX_POINTS>;

/// Some points, or none, as plain data: their count and the points, the rest zero.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PlainPoints {
    /// 0 to 8.
    pub count: u32,
    /// (u, v), px.
    pub points: [[f64; 2]; MAX_POINTS],
}

impl PlainPoints {
    /// No points.
    pub const NONE: Self = Self {
        count: 0,
        points: [[0.0; 2]; MAX_POINTS],
    };

    /// The points; `None` if there are none.
    pub fn get(&self) -> Option<Points> {
        let points = self.points.iter().copied();
        (self.count > 0).then(|| points.take(self.count as usize).collect())
    }
}

impl From<&[[f64; 2]]> for PlainPoints {
    fn from(points: &[[f64; 2]]) -> Self {
        let mut plain = Self {
            count: points.len().min(MAX_POINTS) as u32,
            ..Self::NONE
        };
        plain
            .points
            .iter_mut()
            .zip(points)
            .for_each(|(to, from)| *to = *from);
        plain
    }
}

/// Most entries of a recall input x = (s, a, alpha).
pub const MAX_INPUTS: usize = 2 * MAX_POINTS + 2;

/// Area of the polygon whose vertexes are the points, px^2.
pub fn area(points: &[[f64; 2]]) -> f64 {
    signed_area(points).abs()
}

/// The same, negative where the polygon turns the other way round (the shoelace formula).
pub fn signed_area(points: &[[f64; 2]]) -> f64 {
    let next = points.iter().cycle().skip(1);
    let twice: f64 = points
        .iter()
        .zip(next)
        .map(|(p, q)| p[0] * q[1] - q[0] * p[1])
        .sum();
    0.5 * twice
}

/// Orientation of the pattern: the image direction of its first edge, rad, in (-pi, pi].
pub fn angle(points: &[[f64; 2]]) -> f64 {
    match points {
        [p, q, ..] => atan2(q[1] - p[1], q[0] - p[0]),
        _ => 0.0,
    }
}

/// `angle` moved by whole turns into (goal - pi, goal + pi], so that it wraps opposite the
/// goal's orientation, where turning left and turning right are really different.
pub fn unwrap_near(angle: f64, goal: f64) -> f64 {
    let mut unwrapped = angle;
    while unwrapped > goal + PI {
        unwrapped -= 2.0 * PI;
    }
    while unwrapped <= goal - PI {
        unwrapped += 2.0 * PI;
    }
    unwrapped
}

/// The recall input x = (s, a, alpha) of the paper, raw: px, px^2 and rad, alpha unwrapped near
/// `goal_angle`.
///
/// Source: paper, Eq. (reg_feature).
pub fn recall_input(points: &[[f64; 2]], goal_angle: f64) -> Vec<f64, MAX_INPUTS> {
    let tail = [area(points), unwrap_near(angle(points), goal_angle)];
    points
        .iter()
        .flatten()
        .chain(&tail)
        .copied()
        .take(MAX_INPUTS)
        .collect()
}

/// Root mean square distance of corresponding points, px.
pub fn rms_distance(a: &[[f64; 2]], b: &[[f64; 2]]) -> f64 {
    let sum: f64 = a
        .iter()
        .zip(b)
        .map(|(p, q)| square(p[0] - q[0]) + square(p[1] - q[1]))
        .sum();
    sqrt(sum / a.len().max(1) as f64)
}

/// Largest component of s - s*, px.
pub fn largest_error(a: &[[f64; 2]], b: &[[f64; 2]]) -> f64 {
    a.iter()
        .flatten()
        .zip(b.iter().flatten())
        .map(|(p, q)| (p - q).abs())
        .fold(0.0, f64::max)
}

/// Largest distance of a point from its partner, px.
pub fn largest_distance(a: &[[f64; 2]], b: &[[f64; 2]]) -> f64 {
    let pairs = a.iter().zip(b);
    pairs
        .map(|(p, q)| libm::hypot(p[0] - q[0], p[1] - q[1]))
        .fold(0.0, f64::max)
}

fn square(x: f64) -> f64 {
    x * x
}

#[cfg(test)]
mod tests {
    use super::*;

    const SQUARE: [[f64; 2]; 4] = [[0.0, 0.0], [2.0, 0.0], [2.0, 2.0], [0.0, 2.0]];

    #[test]
    fn area_and_angle_of_a_square() {
        assert_eq!(area(&SQUARE), 4.0);
        assert_eq!(angle(&SQUARE), 0.0);
        let quarter_turn = SQUARE.map(|[u, v]| [-v, u]);
        assert!((angle(&quarter_turn) - PI / 2.0).abs() < 1e-15);
    }

    #[test]
    fn the_cut_of_the_angle_is_opposite_the_goal() {
        assert!((unwrap_near(-3.0, 3.0) - (2.0 * PI - 3.0)).abs() < 1e-12);
        assert_eq!(unwrap_near(0.5, 0.0), 0.5);
    }

    #[test]
    fn the_recall_input_is_stacked_points_area_angle() {
        let x = recall_input(&SQUARE, 0.0);
        assert_eq!(
            x.as_slice(),
            [0.0, 0.0, 2.0, 0.0, 2.0, 2.0, 0.0, 2.0, 4.0, 0.0]
        );
    }
}
