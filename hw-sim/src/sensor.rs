//! Flaws of the free camera: pixel noise, delay and lost frames, all seeded.

use std::collections::VecDeque;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal};

use crate::camera::Points;

/// Flaws of the camera.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Flaws {
    /// Standard deviation of each pixel coordinate, px.
    pub noise_px: f64,
    /// Frames between exposure and delivery.
    pub delay_frames: usize,
    /// Probability that a frame is lost, 0 to 1.
    pub drop: f64,
    /// Seed of noise and losses.
    pub seed: u64,
}

/// A delivered frame.
#[derive(Clone, Debug, PartialEq)]
pub struct Frame {
    /// Measured features, px.
    pub points: Points,
    /// When they were exposed, ns on the monotonic clock.
    pub exposure_ns: u64,
}

/// The sensor with its frames under way.
#[derive(Clone, Debug)]
pub struct Sensor {
    flaws: Flaws,
    under_way: VecDeque<Frame>,
    random: ChaCha8Rng,
}

impl Sensor {
    /// A sensor with these flaws.
    pub fn new(flaws: Flaws) -> Self {
        let random = ChaCha8Rng::seed_from_u64(flaws.seed);
        Self {
            flaws,
            under_way: VecDeque::with_capacity(flaws.delay_frames + 1),
            random,
        }
    }

    /// Exposes a frame and delivers the one whose time has come, unless it is lost.
    pub fn expose(&mut self, points: &Points, exposure_ns: u64) -> Option<Frame> {
        // Drawn for every frame, so that one flaw does not change the numbers of another.
        let lost = self.random.random::<f64>() < self.flaws.drop;
        let mut points = points.clone();
        if let Ok(noise) = Normal::new(0.0, self.flaws.noise_px) {
            points
                .iter_mut()
                .flatten()
                .for_each(|x| *x += noise.sample(&mut self.random));
        }
        self.under_way.push_back(Frame {
            points,
            exposure_ns,
        });
        let due = self.under_way.len() > self.flaws.delay_frames;
        due.then(|| self.under_way.pop_front())
            .flatten()
            .filter(|_| !lost)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn points() -> Points {
        [[10.0, 20.0], [30.0, 40.0]].into_iter().collect()
    }

    #[test]
    fn without_flaws_what_is_exposed_is_delivered() {
        let frame = Sensor::new(Flaws::default()).expose(&points(), 7);
        assert_eq!(
            frame,
            Some(Frame {
                points: points(),
                exposure_ns: 7
            })
        );
    }

    #[test]
    fn delayed_frames_keep_their_exposure_stamp() {
        let mut sensor = Sensor::new(Flaws {
            delay_frames: 2,
            ..Flaws::default()
        });
        let stamps: Vec<Option<u64>> = (0..4)
            .map(|k| sensor.expose(&points(), k).map(|frame| frame.exposure_ns))
            .collect();
        assert_eq!(stamps, [None, None, Some(0), Some(1)]);
    }

    #[test]
    fn noise_and_losses_have_the_size_asked_for_and_follow_the_seed() {
        let flaws = Flaws {
            noise_px: 0.5,
            drop: 0.25,
            seed: 3,
            ..Flaws::default()
        };
        let deliver = |flaws| {
            let mut sensor = Sensor::new(flaws);
            (0..4000)
                .map(|k| sensor.expose(&points(), k))
                .collect::<Vec<_>>()
        };
        let frames = deliver(flaws);
        assert_eq!(frames, deliver(flaws));
        let delivered: Vec<&Frame> = frames.iter().flatten().collect();
        assert!((2850..3150).contains(&delivered.len()));
        let square: f64 = delivered
            .iter()
            .map(|f| (f.points[0][0] - 10.0).powi(2))
            .sum();
        assert!((square / delivered.len() as f64 - 0.25).abs() < 0.03);
    }
}
