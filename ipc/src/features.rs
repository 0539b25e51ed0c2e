//! What the camera saw.

use core::mem::{offset_of, size_of};

use iceoryx2::prelude::ZeroCopySend;

use crate::MAX_POINTS;
use crate::message::{self, Invalid, Message, Qos, Stamp};

/// Image features of one frame; service `vpc/features`.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, ZeroCopySend)]
#[type_name("vpc/Features/1")]
pub struct Features {
    /// Head; `data_ns` is the middle of the exposure.
    pub stamp: Stamp,
    /// Length of the exposure, ns; 0 where unknown.
    pub exposure_ns: u64,
    /// Points in this message, 1 to 8, in the order of the pattern.
    pub count: u32,
    /// Bit i is set where point i was measured in this frame; a point that was not carries the tracker's guess.
    pub visible: u32,
    /// Image points u1 v1 u2 v2 ..., px; u to the right, v down, origin at the centre of the upper left pixel. The first
    /// `2 * count` are finite; the rest is zero.
    pub points: [f64; 2 * MAX_POINTS],
}

const _: () = {
    assert!(size_of::<Features>() == 168);
    assert!(offset_of!(Features, stamp) == 0);
    assert!(offset_of!(Features, exposure_ns) == 24);
    assert!(offset_of!(Features, count) == 32);
    assert!(offset_of!(Features, visible) == 36);
    assert!(offset_of!(Features, points) == 40);
};

impl Features {
    /// A message with these points (px, all visible), exposed at `data_ns`. Points past the eighth are left out of
    /// the array but counted, so that the reception refuses the message instead of believing a part of it.
    pub fn new(points: &[[f64; 2]], data_ns: u64) -> Self {
        let mut stacked = [0.0; 2 * MAX_POINTS];
        for (pair, point) in stacked.chunks_exact_mut(2).zip(points) {
            pair.copy_from_slice(point);
        }
        Self {
            stamp: Stamp {
                data_ns,
                ..Stamp::default()
            },
            exposure_ns: 0,
            count: u32::try_from(points.len()).unwrap_or(u32::MAX),
            visible: all_of(points.len()),
            points: stacked,
        }
    }

    /// The points (u, v), px: at most eight.
    pub fn pairs(&self) -> impl Iterator<Item = [f64; 2]> + '_ {
        let count = (self.count as usize).min(MAX_POINTS);
        self.points
            .chunks_exact(2)
            .take(count)
            .map(|p| [p[0], p[1]])
    }

    /// Whether every point was measured in this frame.
    pub fn all_visible(&self) -> bool {
        let all = all_of(self.count as usize);
        self.visible & all == all
    }
}

/// The mask of the first `count` bits.
fn all_of(count: usize) -> u32 {
    match count {
        0..=31 => (1_u32 << count) - 1,
        _ => u32::MAX,
    }
}

impl Message for Features {
    const SERVICE: &'static str = "vpc/features";
    /// A history of one, so that a controller that comes late finds the message that a lockstep camera waits on.
    const QOS: Qos = Qos {
        history: 1,
        buffer: 64,
        subscribers: 8,
        publishers: 1,
    };

    message::carried_by!(features);

    fn check(&self) -> Result<(), Invalid> {
        message::check_stamp(Self::SERVICE, &self.stamp)?;
        message::check_count(Self::SERVICE, "count", self.count, 1..=MAX_POINTS)?;
        let count = self.count as usize;
        message::check_finite(Self::SERVICE, "points", &self.points[..2 * count])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
