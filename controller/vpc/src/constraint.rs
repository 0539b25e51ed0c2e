//! Visibility constraints of the whole task: the image border and the occlusions, as signed
//! clearances in px (negative: violated).
//!
//! An occlusion that is not convex is a union of parts: being outside the union is being outside
//! each.
//!
//! Source: paper, Eqs. (visibility_const_a) and (visibility_const_b).

use scene::Camera;

use crate::clearance::Clearance;
use crate::task::Task;

/// Clearances of a pixel from the four sides of the image: left, top, right, bottom.
pub fn border(camera: &Camera, [u, v]: [f64; 2]) -> [Clearance; 4] {
    let side = |distance, normal| Clearance { distance, normal };
    [
        side(u, [1.0, 0.0]),
        side(v, [0.0, 1.0]),
        side(camera.width - u, [-1.0, 0.0]),
        side(camera.height - v, [0.0, -1.0]),
    ]
}

/// The sum of all violations of a pixel, px, where every border is moved inwards by `margin` px.
pub fn violation(task: &Task, pixel: [f64; 2], margin: f64) -> f64 {
    let sides = border(&task.camera, pixel);
    let sides: f64 = sides
        .iter()
        .map(|side| (margin - side.distance).max(0.0))
        .sum();
    let obstacles = task
        .obstacles()
        .filter(|obstacle| obstacle.outside_box(pixel) < margin);
    sides
        + obstacles
            .map(|obstacle| (margin - obstacle.clearance(pixel).distance).max(0.0))
            .sum::<f64>()
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

/// The least clearance of a pixel from the image border, px.
pub fn border_clearance(task: &Task, pixel: [f64; 2]) -> f64 {
    border(&task.camera, pixel)
        .iter()
        .map(|side| side.distance)
        .fold(f64::INFINITY, f64::min)
}
