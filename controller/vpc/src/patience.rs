//! Patience: the camera stands still while foresight knows no way and nothing improves.
//!
//! A camera that follows the future with the least error may drift for ever, at full speed and with
//! a constant error. So if the error has not fallen by 1 % for [`PATIENCE_S`], the camera stands.
//! It moves again once foresight finds a future that arrives, or the error falls by other means.

use serde::{Deserialize, Serialize};

/// Time without progress after which the camera stands, s.
pub const PATIENCE_S: f64 = 5.0;
/// An error is progress if it is below this share of the least error before.
const PROGRESS: f64 = 0.99;

/// How long nothing has improved. Plain data.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Patience {
    /// Least error since the last progress, px.
    pub least_px: f64,
    /// Time without progress while no way was known, s.
    pub seconds: f64,
}

impl Patience {
    /// Before the first cycle.
    pub const NEW: Self = Self {
        least_px: f64::INFINITY,
        seconds: 0.0,
    };

    /// Lets a period of `seconds` pass at the end of which the features are `error_px` from the
    /// goal. With hope (a way that arrives, or a near goal that the arm reaches) time does not
    /// count.
    pub fn pass(&mut self, error_px: f64, has_hope: bool, seconds: f64) {
        if has_hope || error_px < PROGRESS * self.least_px {
            (self.least_px, self.seconds) = (error_px, 0.0);
        } else {
            self.seconds += seconds;
        }
    }

    /// Whether the camera is to stand.
    pub fn is_over(&self) -> bool {
        self.seconds >= PATIENCE_S
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn five_seconds_without_progress_end_it_until_hope_returns() {
        let mut patience = Patience::NEW;
        let mut cycles = |error_px: f64, has_hope: bool, count: u32| {
            for _ in 0..count {
                patience.pass(error_px, has_hope, 0.1);
            }
            patience.is_over()
        };
        assert!(!cycles(100.0, false, 50));
        assert!(cycles(99.5, false, 2));
        assert!(cycles(120.0, false, 100));
        // Pushed nearer, it tries again.
        assert!(!cycles(98.0, false, 1));
        assert!(cycles(98.0, false, 51));
        assert!(!cycles(98.0, true, 1));
        assert!(!cycles(98.0, false, 49));
    }
}
