//! What keeps a guarded camera in front of the pattern: seen from the side, its points come to lie
//! on a line, and no detector finds them.
//!
//! | Symbol | Here | Meaning |
//! |---|---|---|
//! | n | `normal` | the normal of the pattern's plane in the camera frame |
//! | x | `middle` | the mean of its points, m |
//! | s = n'x / abs(x) | `sine` | of the angle between the line of sight to it and the plane |
//! | d abs(s)/dt = g v | `slope` | by the camera's velocity against the pattern; turning it changes nothing |

use nalgebra::Vector3;

use crate::Twist;
use crate::motion::Motion;
use crate::prediction::InitialState;
use crate::row::Row;
use crate::task::Task;

/// The least sine: of 15 degrees.
const LEAST: f64 = 0.259;
/// Least time in which what is left of it may be used up, s: some periods.
const LEAST_S: f64 = 0.15;
/// Share of the camera's deceleration with which it nears that.
const SHARE: f64 = 0.5;

/// The bound on the command of a period; `None` where the pattern's pose is not known. The view is
/// that of the middle of the period under the command in force: a camera that turns goes elsewhere
/// than where it looks at first.
pub(crate) fn bound(task: &Task, initial: &InitialState, standing: &Twist) -> Option<Row> {
    let pose = initial.pose(task)?;
    let half = Motion::of_camera(&initial.relative(standing), 0.5 * task.period);
    let normal = half.rotation * pose.normal();
    let points = task.pattern.iter().map(|p| half.apply(&pose.apply(p)));
    let middle = points.sum::<Vector3<f64>>() / task.pattern.len() as f64;
    let away = middle.norm();
    let sine = normal.dot(&middle) / away;
    let slope = (normal - middle * (sine / away)) * (-sine.signum() / away);
    let [x, y, z, ..] = task.acceleration;
    let deceleration = SHARE * x.min(y).min(z) / away;
    let left = (sine.abs() - LEAST).max(0.0);
    let nearing = libm::sqrt(2.0 * deceleration * left);
    let [x, y, z, ..] = initial.drift.twist;
    let by_itself = slope.dot(&Vector3::new(x, y, z));
    Some(Row {
        gradient: [-slope.x, -slope.y, -slope.z, 0.0, 0.0, 0.0],
        // Without a limit of acceleration, 0 of it is no number: the other counts.
        most: nearing.min(left / LEAST_S) - by_itself,
    })
}
