//! The way back: a camera that has lost the pattern returns along its own way, slowly.

use serde::{Deserialize, Serialize};

/// Longest leg, s, and how many are kept: so far back it goes at most, and less where the twist
/// bends often.
const LEG_S: f32 = 0.2;
const LEGS: usize = 16;
/// Change of the twist with which a new leg begins, as a share of its greater size.
const BEND: f64 = 0.2;
/// Share of the speed at which it came.
const SHARE: f64 = 0.25;

/// A part of the way. Plain data.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
struct Leg {
    /// Mean twist, m/s and rad/s, camera frame.
    twist: [f32; 6],
    /// How long it took, s.
    seconds: f32,
}

impl Leg {
    /// Whether a twist differs from the leg's mean by more than [`BEND`], in its linear or its
    /// angular part.
    fn bends(&self, twist: &[f64; 6]) -> bool {
        let mean = self.twist.map(f64::from);
        let size = |v: &[f64]| v.iter().map(|v| v * v).sum::<f64>();
        let away: [f64; 6] = core::array::from_fn(|k| twist[k] - mean[k]);
        let parts = away.chunks(3).zip(twist.chunks(3).zip(mean.chunks(3)));
        let mut parts = parts.map(|(away, (v, mean))| (size(away), size(v).max(size(mean))));
        self.seconds > 0.0 && parts.any(|(away, most)| away > BEND * BEND * most)
    }
}

/// The last few seconds of a camera's way. Plain data.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Way {
    /// The newest first; where it took no time there is none.
    legs: [Leg; LEGS],
    /// Whether this cycle goes back.
    goes_back: bool,
    /// Whether one did since the law last answered an image.
    pub(crate) went_back: bool,
}

impl Way {
    /// Adds a cycle's twist that is in force for `seconds`, unless it goes back or has gone back
    /// since the law last answered an image.
    pub fn add(&mut self, twist: &[f64; 6], seconds: f64, has_answered: bool) {
        let goes_back = core::mem::take(&mut self.goes_back);
        self.went_back = goes_back || (self.went_back && !has_answered);
        if self.went_back || *twist == [0.0; 6] {
            return;
        }
        if self.legs[0].seconds >= LEG_S || self.legs[0].bends(twist) {
            self.legs.rotate_right(1);
            self.legs[0] = Leg::default();
        }
        let leg = &mut self.legs[0];
        leg.seconds += seconds as f32;
        let share = seconds as f32 / leg.seconds;
        for (mean, v) in leg.twist.iter_mut().zip(twist) {
            *mean += share * (*v as f32 - *mean);
        }
    }

    /// The twist that goes back for `seconds`; `None` where the way begins. Counts that part of the
    /// way as gone, also if another twist is sent.
    pub fn back(&mut self, seconds: f64) -> Option<[f64; 6]> {
        let whole = (SHARE * seconds) as f32;
        let mut left = whole;
        let mut way = [0.0; 6];
        for _ in 0..LEGS {
            let leg = &mut self.legs[0];
            let part = leg.seconds.min(left);
            for (sum, v) in way.iter_mut().zip(leg.twist) {
                *sum += f64::from(part * v);
            }
            (leg.seconds, left) = (leg.seconds - part, left - part);
            if left <= 0.0 {
                break;
            }
            *leg = Leg::default();
            self.legs.rotate_left(1);
        }
        self.goes_back = left < whole;
        self.goes_back.then(|| way.map(|x| -x / seconds))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_way_back_is_the_way_there_and_slower() {
        let mut way = Way::default();
        assert_eq!(way.back(0.03), None);
        let there = |k: usize| [0.1 * k as f64, 0.0, -0.2, 0.0, 0.0, 0.3];
        (0..60).for_each(|k| way.add(&there(k / 30), 0.033, true));
        let (mut went, mut seconds) = ([0.0; 6], 0.0_f64);
        // But for the last cycle, in which less may be left.
        while let Some(twist) = way.back(0.033) {
            let is_last = way.legs[0].seconds <= 0.0;
            assert!((twist[2] - 0.05).abs() < 1e-6 || is_last, "{twist:?}");
            went.iter_mut()
                .zip(twist)
                .for_each(|(x, v)| *x += 0.033 * v);
            seconds += 0.033;
        }
        // All of it, as it is no longer than what is kept; four times as slowly.
        assert!((seconds - 4.0 * 60.0 * 0.033).abs() < 0.5, "{seconds}");
        for (went, there) in went.iter().zip([0.099_f64, 0.0, -0.396, 0.0, 0.0, 0.594]) {
            assert!((went + there).abs() < 1e-4, "{went} {there}");
        }
    }
}
