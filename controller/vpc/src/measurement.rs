//! Measured features, and why they may be refused.

use crate::{MAX_POINTS, Points};

/// Measured features, px, in the order of the pattern.
#[derive(Clone, Debug, PartialEq)]
pub struct Measurement {
    /// The points (u, v); one that was not seen may have any value.
    pub points: Points,
    /// Bit i is set if point i was seen.
    pub visible: u32,
    /// When they were exposed, ns.
    pub exposed_ns: u64,
    /// When the command that answers them takes effect, on the same clock, ns.
    pub effective_ns: u64,
}

impl Measurement {
    /// A measurement of these points, of this very instant; those past [`MAX_POINTS`] are left out,
    /// and the gate then refuses the count.
    pub fn from_points(points: &[[f64; 2]]) -> Self {
        Self {
            points: points.iter().copied().take(MAX_POINTS).collect(),
            visible: u32::MAX,
            exposed_ns: 0,
            effective_ns: 0,
        }
    }

    /// The same points, exposed at `exposed_ns`, for a command that takes effect at `effective_ns`.
    /// An exposure after that counts as one of that instant.
    pub fn taken(mut self, exposed_ns: u64, effective_ns: u64) -> Self {
        (self.exposed_ns, self.effective_ns) = (exposed_ns.min(effective_ns), effective_ns);
        self
    }

    /// The same, of which only the points of these bits were seen.
    pub fn seeing(mut self, visible: u32) -> Self {
        self.visible = visible;
        self
    }

    /// Whether this point was seen.
    pub fn sees(&self, point: usize) -> bool {
        self.visible >> point & 1 == 1
    }

    /// Whether every point was seen.
    pub fn is_whole(&self) -> bool {
        (0..self.points.len()).all(|point| self.sees(point))
    }

    /// Time from the exposure to the command's effect, ns.
    pub fn age_ns(&self) -> u64 {
        self.effective_ns.saturating_sub(self.exposed_ns)
    }
}

/// Why a measurement was refused; the command for such a cycle is zero. Points are counted from 0.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[allow(missing_docs)] // the messages say it
pub enum Refusal {
    #[error("features: {found} points; allowed: the pattern's {expected}")]
    Count { found: usize, expected: usize },
    /// It would be steered on without some points, but no longer.
    #[error(
        "features: points are hidden, for {blind_s:.2} s of late, and known to {deviation_px:.1} px; allowed: {most_s:.2} s and {most_px:.1} px"
    )]
    Hidden {
        blind_s: f64,
        most_s: f64,
        deviation_px: f64,
        most_px: f64,
    },
    #[error("features: point {point} is not finite; allowed: finite pixels")]
    NotFinite { point: usize },
    /// By more than the scene's tolerance.
    #[error("features: point {point} = ({:.1}, {:.1}) px; allowed: inside the image", .pixel[0], .pixel[1])]
    OffImage { point: usize, pixel: [f64; 2] },
    #[error(
        "features: points {} and {} are swapped; allowed: the order of the pattern",
        .points[0], .points[1]
    )]
    Mixed { points: [usize; 2] },
    #[error(
        "features: point {point} is {by_px:.0} px from where the motion of the others would put it; allowed: a few times their motion"
    )]
    Leap { point: usize, by_px: f64 },
    #[error("features: points {} and {} coincide; allowed: a view of the pattern", .points[0], .points[1])]
    Coincident { points: [usize; 2] },
    #[error(
        "features: all points lie on a line, within {height_px:.2} px; allowed: a view of the pattern"
    )]
    Flat { height_px: f64 },
    #[error(
        "features: no bit changed while {expected_px:.1} px of motion were commanded; allowed: an image that moves"
    )]
    Frozen { expected_px: f64 },
    #[error(
        "features: {seen_px:.1} px of motion along the {commanded_px:.1} px that were commanded; allowed: a third or more"
    )]
    NotFollowing { commanded_px: f64, seen_px: f64 },
    #[error(
        "features: {seen_px:.1} px of motion along the {commanded_px:.1} px that were commanded; allowed: twice as much"
    )]
    Exceeding { commanded_px: f64, seen_px: f64 },
    #[error("features: the image moves {lag_s:.2} s after the commands; allowed: {most_s} s")]
    Lagging { lag_s: f64, most_s: f64 },
    #[error(
        "features: {by_px:.0} px from where the commands since the last ones would put them; allowed: {most_px:.0} px"
    )]
    Elsewhere { by_px: f64, most_px: f64 },
    /// The command takes effect `age_ns` after the exposure, and the commands are known for the
    /// last `known_ns` only: where the features are by then is unknown.
    #[error(
        "features: exposed {:.1} ms ago; allowed: {:.1} ms, for which the commands are known",
        ms(.age_ns), ms(.known_ns)
    )]
    Late { age_ns: u64, known_ns: u64 },
    #[error("arm: no positions of the joints; allowed: those of every joint, not older than 0.5 s")]
    NoJoints,
    /// By the commands sent since the exposure, the pattern is behind the camera now.
    #[error(
        "features: the commands since the exposure put the pattern behind the camera; allowed: in front of it"
    )]
    Lost,
}

fn ms(ns: &u64) -> f64 {
    *ns as f64 * 1e-6
}
