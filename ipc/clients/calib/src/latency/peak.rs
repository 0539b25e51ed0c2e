//! The correlation of seen and measured motion over shifts of the stamps.

use nalgebra::SVector;
use vision_calibration_core::Iso3;

use super::{Frame, Setup};
use crate::trajectory::Trajectory;

/// Shifts that are tried: to both sides, and the step, s.
pub(super) const WINDOW: f64 = 0.5;
const STEP: f64 = 0.005;
/// Two frames that are further apart give no velocity, s.
const FRAME: f64 = 0.2;
/// Fewest pairs of frames of a correlation.
const COMMON: usize = 30;
/// Another peak is this far away, s.
pub(super) const OTHER: f64 = 0.06;

/// The highest peak of the correlation.
#[derive(Clone, Copy, Debug)]
pub(super) struct Peak {
    /// s.
    pub shift: f64,
    /// Of at most 1.
    pub height: f64,
    /// The next one, of it.
    pub other: f64,
}

impl Peak {
    /// Tries every shift; `None` where too little is known to tell.
    pub fn find(correlation: impl Fn(f64) -> Option<f64>) -> Self {
        let count = (2.0 * WINDOW / STEP).round() as usize;
        let shifts: Vec<f64> = (0..=count).map(|k| k as f64 * STEP - WINDOW).collect();
        let heights: Vec<f64> = shifts
            .iter()
            .map(|shift| correlation(*shift).unwrap_or(0.0))
            .collect();
        let highest = (0..=count).max_by(|a, b| heights[*a].total_cmp(&heights[*b]));
        let highest = highest.unwrap_or(0);
        let is_peak = |k: &usize| {
            let sides = [k.checked_sub(1), Some(k + 1)];
            sides
                .iter()
                .flatten()
                .all(|j| heights.get(*j).is_none_or(|side| *side <= heights[*k]))
        };
        let others = (0..=count).filter(is_peak);
        let others = others.filter(|k| (shifts[*k] - shifts[highest]).abs() > OTHER);
        let other = others.map(|k| heights[k]).fold(0.0, f64::max);
        // The top of the parabola through three heights.
        let around = |k: usize| heights.get(k).copied().unwrap_or(heights[highest]);
        let (before, at, after) = (
            around(highest.wrapping_sub(1)),
            heights[highest],
            around(highest + 1),
        );
        let bend = before - 2.0 * at + after;
        let top = if bend < 0.0 {
            0.5 * (before - after) / bend
        } else {
            0.0
        };
        Self {
            shift: shifts[highest] + top * STEP,
            height: at,
            other: other / at.max(1e-9),
        }
    }
}

/// Of the velocities that images show and that the arm has.
pub(super) fn correlation(
    seen: &[(Frame, Iso3)],
    arm: &Trajectory,
    setup: &Setup,
    shift: f64,
) -> Option<f64> {
    let (mut product, mut squares, mut count) = (0.0, [0.0; 2], 0);
    for pair in seen.windows(2) {
        let [(Frame { time: a, .. }, from), (Frame { time: b, .. }, to)] = pair else {
            continue;
        };
        let ends = arm.flange(a + shift).zip(arm.flange(b + shift));
        let Some((start, end)) = ends.filter(|_| b - a < FRAME) else {
            continue;
        };
        let far = from.translation.vector.norm();
        let seen = velocity(&(from * to.inverse()), b - a, far);
        let moved = (start * setup.mount).inverse() * end * setup.mount;
        let measured = velocity(&moved, b - a, far);
        product += seen.dot(&measured);
        squares[0] += seen.norm_squared();
        squares[1] += measured.norm_squared();
        count += 1;
    }
    let is_enough = count >= COMMON && squares[0] * squares[1] > 0.0;
    is_enough.then(|| product / (squares[0] * squares[1]).sqrt())
}

/// A camera's velocity over a motion, as a point this far before it moves in the image.
fn velocity(moved: &Iso3, time: f64, far: f64) -> SVector<f64, 6> {
    let (linear, angular) = (moved.translation.vector, moved.rotation.scaled_axis());
    let [x, y, z] = (linear / (far * time)).into();
    let [a, b, c] = (angular / time).into();
    SVector::from([x, y, z, a, b, c])
}
