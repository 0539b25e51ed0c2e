//! A time that depends on a command, as that of braking does, and its derivatives.

use crate::{DOF, Twist};

/// A time that may depend on a command, and its derivatives by the command's components.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Span {
    /// s.
    pub seconds: f64,
    /// s per m/s and rad/s.
    pub slope: Twist,
}

impl Span {
    /// The same time for all commands.
    pub fn fixed(seconds: f64) -> Self {
        let slope = [0.0; DOF];
        Self { seconds, slope }
    }

    /// Whether it is the same for all commands.
    pub(crate) fn is_fixed(&self) -> bool {
        self.slope == [0.0; DOF]
    }

    /// The longer one.
    pub(crate) fn max(self, other: Self) -> Self {
        match other.seconds > self.seconds {
            true => other,
            false => self,
        }
    }

    /// Adds to the derivatives of something by commands, the first of which this depends on, what
    /// the longer time does. It depends on products of a time and `relative`, the commands against
    /// the pattern, alone: so its rate is the derivative along these, by the time.
    pub(crate) fn lengthen<const N: usize>(&self, gradient: &mut [f64; N], relative: &[f64; N]) {
        if self.is_fixed() {
            return;
        }
        let along: f64 = gradient.iter().zip(relative).map(|(g, v)| g * v).sum();
        let rate = along / self.seconds;
        let pairs = gradient.iter_mut().zip(self.slope);
        pairs.for_each(|(g, slope)| *g += rate * slope);
    }
}
