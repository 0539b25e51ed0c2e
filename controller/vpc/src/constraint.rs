//! Visibility constraints of the whole task: the image border and the occlusions, as signed
//! clearances in px (negative: violated).
//!
//! An occlusion that is not convex is a union of parts: being outside the union is being outside
//! each.
//!
//! A marker that has a size keeps its whole edge clear: its point keeps the marker's radius more.
//!
//! Source: paper, Eqs. (visibility_const_a) and (visibility_const_b).

use scene::Camera;

use crate::clearance::{Clearance, Place};
use crate::obstacle::Obstacle;
use crate::task::Task;

/// What a feature must not cross.
#[derive(Clone, Copy, Debug)]
pub enum Border<'a> {
    /// A side of the image.
    Image {
        /// The coordinate that it bounds: 0 for u, 1 for v.
        axis: usize,
        /// The coordinate on it, px.
        at: f64,
        /// 1 where the image is at greater coordinates, else -1.
        sign: f64,
    },
    /// An occlusion's.
    Obstacle(Obstacle<'a>),
}

impl Border<'_> {
    /// The clearance of a pixel.
    pub fn clearance(self, pixel: [f64; 2]) -> Clearance {
        match self {
            Self::Image { axis, at, sign } => Clearance {
                distance: sign * (if axis == 0 { pixel[0] } else { pixel[1] } - at),
                normal: if axis == 0 { [sign, 0.0] } else { [0.0, sign] },
            },
            Self::Obstacle(obstacle) => obstacle.clearance(pixel),
        }
    }

    /// The clearance of a point's marker: that of the point, less the radius.
    pub fn clearance_of(self, place: Place) -> Clearance {
        let clearance = self.clearance(place.pixel);
        Clearance {
            distance: clearance.distance - place.radius,
            ..clearance
        }
    }
}

/// Sides of an image.
pub(crate) const SIDES: usize = 4;

/// The sides of the image: left, top, right, bottom.
pub fn sides(camera: &Camera) -> [Border<'static>; SIDES] {
    let side = |axis, at, sign| Border::Image { axis, at, sign };
    [
        side(0, 0.0, 1.0),
        side(1, 0.0, 1.0),
        side(0, camera.width, -1.0),
        side(1, camera.height, -1.0),
    ]
}

/// The border of this index: the sides of the image come first, then the obstacles of the task.
pub(crate) fn border(task: &Task, index: usize) -> Option<Border<'_>> {
    match index.checked_sub(SIDES) {
        Some(index) => task.obstacle(index).map(Border::Obstacle),
        None => sides(&task.camera).get(index).copied(),
    }
}

/// The borders that a pixel between the corners of a box may be less than `margin` px away from,
/// with their indices. Those it is surely further from are left out.
pub(crate) fn borders_near(
    task: &Task,
    [low, high]: [[f64; 2]; 2],
    margin: f64,
) -> impl Iterator<Item = (usize, Border<'_>)> {
    let [width, height] = [task.camera.width, task.camera.height];
    let is_near = [
        low[0] < margin,
        low[1] < margin,
        high[0] > width - margin,
        high[1] > height - margin,
    ];
    let sides = sides(&task.camera).into_iter().enumerate().zip(is_near);
    let sides = sides.filter_map(|(side, is_near)| is_near.then_some(side));
    let obstacles = task.obstacles_near(low, high, margin);
    sides.chain(obstacles.map(|(index, obstacle)| (SIDES + index, Border::Obstacle(obstacle))))
}

/// The sum of all violations of a pixel, px, where every border is moved inwards by `margin` px.
pub fn violation(task: &Task, pixel: [f64; 2], margin: f64) -> f64 {
    let [u, v] = pixel;
    let beyond = |clearance: f64| (margin - clearance).max(0.0);
    let (right, bottom) = (task.camera.width - u, task.camera.height - v);
    let mut sum = beyond(u) + beyond(v) + beyond(right) + beyond(bottom);
    for (_, obstacle) in task.obstacles_near(pixel, pixel, margin) {
        sum += beyond(obstacle.clearance(pixel).distance);
    }
    sum
}

/// The least clearance of a pixel from any occlusion, px; infinite without occlusions.
pub fn least_clearance(task: &Task, pixel: [f64; 2]) -> f64 {
    task.obstacles().fold(f64::INFINITY, |least, obstacle| {
        if obstacle.at_least(pixel) < least {
            least.min(obstacle.clearance(pixel).distance)
        } else {
            least
        }
    })
}

/// Most steps of [`moved_out`]: as many occlusions may overlap.
const STEPS_OUT: usize = 4;

/// The pixel moved out of the occlusions that it is inside of, each by the shortest way; as it is
/// where there is none.
pub fn moved_out(task: &Task, mut pixel: [f64; 2]) -> [f64; 2] {
    for _ in 0..STEPS_OUT {
        let near = task.obstacles_near(pixel, pixel, 0.0);
        let clearances = near.map(|(_, obstacle)| obstacle.clearance(pixel));
        let Some(deepest) = clearances.min_by(|a, b| a.distance.total_cmp(&b.distance)) else {
            break;
        };
        if deepest.distance >= 0.0 {
            break;
        }
        let [a, b] = deepest.normal;
        pixel = [
            pixel[0] - deepest.distance * a,
            pixel[1] - deepest.distance * b,
        ];
    }
    pixel
}

/// The least clearance of a pixel from the image border, px.
pub fn border_clearance(task: &Task, pixel: [f64; 2]) -> f64 {
    sides(&task.camera)
        .iter()
        .map(|side| side.clearance(pixel).distance)
        .fold(f64::INFINITY, f64::min)
}
