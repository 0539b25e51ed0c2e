//! The gate: measured features that cannot be trusted go no further.

use crate::task::Task;
use crate::{Points, plausible};

/// Measured features, px, in the order of the pattern.
#[derive(Clone, Debug, PartialEq)]
pub struct Measurement {
    /// The points (u, v).
    pub points: Points,
    /// When they were exposed, ns.
    pub exposed_ns: u64,
    /// When the command that answers them takes effect, on the same clock, ns.
    pub effective_ns: u64,
}

impl Measurement {
    /// A measurement of these points, of this very instant; those past [`crate::MAX_POINTS`] are left out, and the gate
    /// then refuses the count.
    pub fn from_points(points: &[[f64; 2]]) -> Self {
        Self {
            points: points.iter().copied().take(crate::MAX_POINTS).collect(),
            exposed_ns: 0,
            effective_ns: 0,
        }
    }

    /// The same points, exposed at `exposed_ns`, for a command that takes effect at `effective_ns`. An exposure after
    /// that counts as one of that instant.
    pub fn taken(mut self, exposed_ns: u64, effective_ns: u64) -> Self {
        (self.exposed_ns, self.effective_ns) = (exposed_ns.min(effective_ns), effective_ns);
        self
    }

    /// Time from the exposure to the command's effect, ns.
    pub fn age_ns(&self) -> u64 {
        self.effective_ns.saturating_sub(self.exposed_ns)
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
    /// Points lie in each other's places.
    Mixed {
        /// Indices of two of them.
        points: [usize; 2],
    },
    /// A point lies far from where it is expected, and the others do not.
    Leap {
        /// Index of the point.
        point: usize,
        /// How far, px.
        by_px: f64,
    },
    /// Points lie in one place.
    Coincident {
        /// Indices of two of them.
        points: [usize; 2],
    },
    /// All points lie on a line.
    Flat {
        /// Largest height of a triangle of them, px.
        height_px: f64,
    },
    /// Not one bit of them changed, though the camera was commanded to move.
    Frozen {
        /// How far the image should have moved, px.
        expected_px: f64,
    },
    /// They were exposed before the commands that are remembered: where they are now cannot be told.
    Late {
        /// Time from the exposure to the command's effect, ns.
        age_ns: u64,
        /// How far back the commands are known, ns.
        known_ns: u64,
    },
    /// By the commands sent since the exposure, the pattern is out of every camera's sight now.
    Lost,
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
            Self::Mixed { points: [i, j] } => {
                write!(
                    f,
                    "features: points {i} and {j} lie in each other's places; allowed: the order of the pattern"
                )
            }
            Self::Leap { point, by_px } => {
                write!(
                    f,
                    "features: point {point} lies {by_px:.0} px from where the motion of the others leads; allowed: a few times theirs"
                )
            }
            Self::Coincident { points: [i, j] } => {
                write!(
                    f,
                    "features: points {i} and {j} lie in one place; allowed: a view of the pattern"
                )
            }
            Self::Flat { height_px } => {
                write!(
                    f,
                    "features: all points lie on a line, within {height_px:.2} px; allowed: a view of the pattern"
                )
            }
            Self::Frozen { expected_px } => {
                write!(
                    f,
                    "features: unchanged to the last bit where {expected_px:.1} px of motion were commanded; allowed: an image that moves"
                )
            }
            Self::Late { age_ns, known_ns } => {
                write!(
                    f,
                    "features: exposed {:.1} ms ago; allowed: {:.1} ms, since when the commands are known",
                    *age_ns as f64 * 1e-6,
                    *known_ns as f64 * 1e-6
                )
            }
            Self::Lost => {
                write!(
                    f,
                    "features: the pattern is out of sight by the commands since the exposure; allowed: in front of the camera"
                )
            }
        }
    }
}

/// Lets a measurement pass that has the pattern's count of finite points, none further outside the image than
/// `tolerance` px, none in one place, not all on a line, and in the pattern's sense of rotation.
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
    plausible::check_shape(task, points)?;
    plausible::check_sense(task, points)?;
    Ok(points)
}
