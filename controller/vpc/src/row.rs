//! A linear bound on a command, g v <= b.

use crate::{DOF, Twist};

/// Pixels that 1 rad/s, m/s or 1/s of a row counts as: above what the same motion moves in the
/// image.
const PX: f64 = 1000.0;

/// By how much a command is beyond the worst of these rows, px; 0 where it is within all.
pub(crate) fn beyond_px(rows: impl Iterator<Item = Row>, twist: &Twist) -> f64 {
    rows.fold(0.0, |most, row| most.max(row.violation_px(twist)))
}

/// A row g v <= b of a command.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Row {
    /// g.
    pub gradient: Twist,
    /// b: rad/s, m/s or 1/s.
    pub most: f64,
}

impl Row {
    /// How far a command is within it, px; negative beyond it.
    pub(crate) fn clearance_px(&self, twist: &Twist) -> f64 {
        let pairs = self.gradient.iter().zip(twist);
        PX * (self.most - pairs.map(|(g, v)| g * v).sum::<f64>())
    }

    /// How far a command is beyond it, px.
    pub(crate) fn violation_px(&self, twist: &Twist) -> f64 {
        (-self.clearance_px(twist)).max(0.0)
    }

    /// The derivative of [`Row::clearance_px`] by the command.
    pub(crate) fn slope(&self) -> [f64; DOF] {
        self.gradient.map(|g| -PX * g)
    }
}
