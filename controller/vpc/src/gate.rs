//! The gate: measured features that cannot be trusted go no further.

use crate::Points;
use crate::task::Task;

/// Measured features, px, in the order of the pattern.
#[derive(Clone, Debug, PartialEq)]
pub struct Measurement {
    /// The points (u, v).
    pub points: Points,
}

impl Measurement {
    /// A measurement of these points; those past [`crate::MAX_POINTS`] are left out, and the gate then refuses the
    /// count.
    pub fn from_points(points: &[[f64; 2]]) -> Self {
        Self {
            points: points.iter().copied().take(crate::MAX_POINTS).collect(),
        }
    }
}

/// Why a measurement was refused; the command for such a cycle is zero.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Refusal {
    /// The number of points is not the pattern's.
    Count {
        /// Points received.
        found: usize,
        /// Points of the pattern.
        expected: usize,
    },
    /// A coordinate is NaN or infinite.
    NotFinite {
        /// Index of the point.
        point: usize,
    },
    /// A point lies outside the image by more than the scene's tolerance.
    OffImage {
        /// Index of the point.
        point: usize,
        /// Where it lies, px.
        pixel: [f64; 2],
    },
}

impl core::error::Error for Refusal {}

impl core::fmt::Display for Refusal {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Count { found, expected } => {
                write!(
                    f,
                    "features: {found} points; allowed: the pattern's {expected}"
                )
            }
            Self::NotFinite { point } => {
                write!(
                    f,
                    "features: point {point} is not finite; allowed: finite pixels"
                )
            }
            Self::OffImage {
                point,
                pixel: [u, v],
            } => {
                write!(
                    f,
                    "features: point {point} = ({u:.1}, {v:.1}) px; allowed: inside the image"
                )
            }
        }
    }
}

/// Lets a measurement pass that has the pattern's count of finite points, none further outside the image than
/// `tolerance` px.
///
/// # Errors
/// [`Refusal`] names the first point that is wrong.
pub fn pass<'a>(
    task: &Task,
    measurement: &'a Measurement,
    tolerance: f64,
) -> Result<&'a Points, Refusal> {
    let points = &measurement.points;
    if points.len() != task.goal.len() {
        return Err(Refusal::Count {
            found: points.len(),
            expected: task.goal.len(),
        });
    }
    for (point, &pixel) in points.iter().enumerate() {
        if !pixel.iter().all(|x| x.is_finite()) {
            return Err(Refusal::NotFinite { point });
        }
        if crate::constraint::border_clearance(task, pixel) < -tolerance {
            return Err(Refusal::OffImage { point, pixel });
        }
    }
    Ok(points)
}
