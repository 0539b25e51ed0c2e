//! What the camera saw.

use crate::field::Stamp;
use crate::message::{Qos, message};

/// Most points that one message carries.
pub const MAX_POINTS: usize = 8;

message! {
    /// Image features of one frame.
    Features {
        /// Head; `data_ns` is the middle of the exposure.
        stamp: Stamp,
        /// Length of the exposure; 0 if unknown.
        exposure_ns: u64 ["ns"],
        /// Points in this message, in the order of the scene's pattern.
        count: u32 [range(1, MAX_POINTS)],
        /// Bit i is set if point i was measured in this frame. Nobody reads the others: the
        /// controller goes on for `safety.blind_s` with those that it believes.
        visible: u32,
        /// Image points u1 v1 u2 v2 ...; u right, v down, origin at the center of the upper left
        /// pixel. The first `2 * count` are finite, the rest zero.
        points: [f64; 2 * MAX_POINTS] ["px" finite_pairs],
    }
    // A history of one: a controller that comes late finds the message that a lockstep camera waits
    // on.
    "vpc/features" from "camera": Qos { history: 1, buffer: 64, subscribers: 8, publishers: 1 }
}

impl Features {
    /// A message with these points (px, all visible), exposed at `data_ns`. Points past the eighth
    /// are left out of the array but counted, so that the receiver refuses the message instead of
    /// using a part of it.
    pub fn new(points: &[[f64; 2]], data_ns: u64) -> Self {
        let mut features = Self {
            count: u32::try_from(points.len()).unwrap_or(u32::MAX),
            visible: all_of(points.len()),
            ..Self::default()
        };
        features.stamp.data_ns = data_ns;
        for (pair, point) in features.points.chunks_exact_mut(2).zip(points) {
            pair.copy_from_slice(point);
        }
        features
    }

    /// The points (u, v), px: at most eight.
    pub fn pairs(&self) -> impl Iterator<Item = [f64; 2]> + '_ {
        pairs(&self.points, self.count)
    }

    /// Whether every point was measured in this frame.
    pub fn all_visible(&self) -> bool {
        let all = all_of(self.count as usize);
        self.visible & all == all
    }
}

/// The first `count` pairs of u1 v1 u2 v2 ....
pub(crate) fn pairs(stacked: &[f64], count: u32) -> impl Iterator<Item = [f64; 2]> + '_ {
    let count = (count as usize).min(MAX_POINTS);
    stacked.chunks_exact(2).take(count).map(|p| [p[0], p[1]])
}

/// The mask of the first `count` bits.
fn all_of(count: usize) -> u32 {
    match count {
        0..=31 => (1_u32 << count) - 1,
        _ => u32::MAX,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::message::Message;

    fn square() -> Features {
        let mut features = Features::new(&[[1.0, 2.0], [3.0, 4.0], [5.0, 6.0], [7.0, 8.0]], 9);
        features.stamp.sequence = 1;
        features
    }

    #[test]
    fn points_go_in_and_come_out() {
        let features = square();
        assert_eq!(features.check(), Ok(()));
        assert_eq!(features.visible, 0b1111);
        assert!(
            features
                .pairs()
                .eq([[1.0, 2.0], [3.0, 4.0], [5.0, 6.0], [7.0, 8.0]])
        );
    }

    #[test]
    fn a_nan_is_named_with_its_place() {
        let mut features = square();
        features.points[5] = f64::NAN;
        let message = features.check().unwrap_err().to_string();
        assert_eq!(
            message,
            "vpc/features: points[5] = NaN; allowed: finite numbers"
        );
    }

    #[test]
    fn a_nan_past_the_count_does_not_matter() {
        let mut features = square();
        features.points[8] = f64::NAN;
        assert_eq!(features.check(), Ok(()));
    }

    #[test]
    fn no_points_and_too_many_are_refused() {
        for count in [0, 9] {
            let mut features = Features::new(&vec![[1.0, 1.0]; count], 0);
            features.stamp.sequence = 1;
            let message = features.check().unwrap_err().to_string();
            assert_eq!(
                message,
                format!("vpc/features: count = {count}; allowed: 1 to 8")
            );
            assert!(features.pairs().count() <= 8);
        }
    }

    #[test]
    fn a_hidden_point_is_seen_to_be_hidden() {
        let mut features = square();
        assert!(features.all_visible());
        features.visible = 0b1011;
        assert!(!features.all_visible());
    }
}
