//! The robot's measured motion as a function of time.

use vision_calibration_core::Iso3;

use crate::pose_file::flange;

/// Joints of the arm.
const JOINTS: usize = 7;
/// Two samples further apart have lost what was between them, s.
const GAP: f64 = 0.05;
/// The same, of poses that were recorded by others.
const TRACK_GAP: f64 = 0.15;

/// Measured joints at an instant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// s, of the monotonic clock.
    pub time: f64,
    /// Positions, rad.
    pub q: [f64; JOINTS],
    /// Velocities, rad/s.
    pub dq: [f64; JOINTS],
}

/// Samples in the order of time.
#[derive(Clone, Debug, Default)]
pub struct Trajectory {
    samples: Vec<Sample>,
}

impl Trajectory {
    /// Adds a sample; drops one that is not later than the last, or not finite.
    pub fn push(&mut self, sample: Sample) {
        let is_later = self
            .samples
            .last()
            .is_none_or(|last| sample.time > last.time);
        let numbers = sample.q.iter().chain(&sample.dq);
        if is_later && numbers.into_iter().all(|x| x.is_finite()) {
            self.samples.push(sample);
        }
    }

    /// First and last instant, s.
    pub fn span(&self) -> Option<[f64; 2]> {
        Some([self.samples.first()?.time, self.samples.last()?.time])
    }

    /// The joints at an instant, by the cubic through positions and velocities of its neighbours;
    /// `None` outside, and where samples are missing.
    pub fn joints(&self, time: f64) -> Option<[f64; JOINTS]> {
        let after = self.samples.partition_point(|sample| sample.time <= time);
        let from = self.samples.get(after.checked_sub(1)?)?;
        let Some(to) = self.samples.get(after) else {
            return (time == from.time).then_some(from.q);
        };
        let step = to.time - from.time;
        let s = (time - from.time) / step;
        if step > GAP {
            return None;
        }
        // Hermite's basis.
        let (a, b) = (1.0 + s * s * (2.0 * s - 3.0), s * s * (3.0 - 2.0 * s));
        let (c, d) = (s * (1.0 - s) * (1.0 - s) * step, s * s * (s - 1.0) * step);
        let at = |k: usize| a * from.q[k] + b * to.q[k] + c * from.dq[k] + d * to.dq[k];
        Some(std::array::from_fn(at))
    }

    /// The flange in the base at an instant.
    pub fn flange(&self, time: f64) -> Option<Iso3> {
        self.joints(time).map(flange)
    }
}

/// Poses in the order of time.
#[derive(Clone, Debug, Default)]
pub struct Track(Vec<(f64, Iso3)>);

impl From<Vec<(f64, Iso3)>> for Track {
    /// Poses at instants, s, each later than the one before.
    fn from(poses: Vec<(f64, Iso3)>) -> Self {
        Self(poses)
    }
}

impl Track {
    /// The pose at an instant, on the straight line between its neighbours; `None` outside, and
    /// where poses are missing.
    pub fn at(&self, time: f64) -> Option<Iso3> {
        let after = self.0.partition_point(|(known, _)| *known <= time);
        let (before, from) = self.0.get(after.checked_sub(1)?)?;
        let Some((next, to)) = self.0.get(after) else {
            return (time == *before).then_some(*from);
        };
        let step = next - before;
        if step > TRACK_GAP {
            return None;
        }
        from.try_lerp_slerp(to, (time - before) / step, 1e-9)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn between_poses_the_motion_is_straight_and_in_a_gap_it_is_not_known() {
        let pose = |k: f64| {
            let axes = vision_calibration_core::Vec3::new(0.0, 0.0, k);
            Iso3::new(axes, axes)
        };
        let track = Track::from(vec![(1.0, pose(0.0)), (1.1, pose(0.2)), (1.5, pose(0.3))]);
        let apart = pose(0.05).inverse() * track.at(1.025).unwrap();
        assert!(apart.translation.vector.norm() < 1e-9 && apart.rotation.angle() < 1e-9);
        assert_eq!(track.at(1.5), Some(pose(0.3)));
        for time in [0.9, 1.3, 1.6] {
            assert!(track.at(time).is_none(), "{time}");
        }
    }

    fn sample(time: f64) -> Sample {
        let q = |k: usize| (0.3 + 0.1 * k as f64) * (2.0 * time + k as f64).sin();
        let dq = |k: usize| 2.0 * (0.3 + 0.1 * k as f64) * (2.0 * time + k as f64).cos();
        Sample {
            time,
            q: std::array::from_fn(q),
            dq: std::array::from_fn(dq),
        }
    }

    #[test]
    fn between_samples_the_motion_is_known_and_outside_it_is_not() {
        let mut trajectory = Trajectory::default();
        for k in (0..40).filter(|k| !(20..24).contains(k)) {
            trajectory.push(sample(0.02 * f64::from(k)));
        }
        trajectory.push(sample(0.1));
        for time in [0.0, 0.013, 0.399 - 0.03, 0.777] {
            let found = trajectory.joints(time).unwrap();
            for (found, expected) in found.iter().zip(sample(time).q) {
                assert!((found - expected).abs() < 1e-7, "{time}");
            }
        }
        assert_eq!(trajectory.span(), Some([0.0, 0.78]));
        for time in [-0.01, 0.79, 0.43] {
            assert!(trajectory.joints(time).is_none(), "{time}");
        }
    }
}
