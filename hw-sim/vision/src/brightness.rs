//! Brightness that changes from frame to frame, as under a lamp, a cloud or an automatic exposure.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Frames of a slow rise and fall.
const PERIOD: f64 = 150.0;
/// Frames between two steps, on average.
const STEADY: f64 = 60.0;
/// Distinguishes the random numbers from those of the texture.
const BRIGHTNESS: u64 = 0x6a17;

/// Factors of the light, frame by frame: half of the change is slow, half comes in steps.
#[derive(Clone, Debug)]
pub(crate) struct Brightness {
    amount: f64,
    random: ChaCha8Rng,
    phase: f64,
    step: f64,
}

impl Brightness {
    /// Between 1 less and 1 more this amount.
    pub fn new(amount: f64, seed: u64) -> Self {
        let mut random = ChaCha8Rng::seed_from_u64(seed ^ BRIGHTNESS);
        Self {
            amount,
            phase: random.random(),
            step: 2.0 * random.random::<f64>() - 1.0,
            random,
        }
    }

    /// The factor of the next frame; 1 where nothing changes.
    pub fn next(&mut self) -> f32 {
        if self.amount <= 0.0 {
            return 1.0;
        }
        self.phase = (self.phase + 1.0 / PERIOD).fract();
        if self.random.random::<f64>() < 1.0 / STEADY {
            self.step = 2.0 * self.random.random::<f64>() - 1.0;
        }
        let slow = (std::f64::consts::TAU * self.phase).sin();
        (1.0 + 0.5 * self.amount * (slow + self.step)) as f32
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_changes_slowly_and_in_steps_within_its_bounds() {
        let mut brightness = Brightness::new(0.4, 3);
        let factors: Vec<f32> = (0..3000).map(|_| brightness.next()).collect();
        assert!(factors.iter().all(|x| (0.6..=1.4).contains(x)));
        let jumps: Vec<f32> = factors.windows(2).map(|x| (x[1] - x[0]).abs()).collect();
        let slow = 0.2 * std::f32::consts::TAU / 150.0;
        let steps = jumps.iter().filter(|jump| **jump > 1.01 * slow).count();
        assert!((25..75).contains(&steps), "{steps}");
        let spread = factors
            .iter()
            .fold([2.0f32, 0.0], |[a, b], x| [a.min(*x), b.max(*x)]);
        assert!(spread[0] < 0.75 && spread[1] > 1.25, "{spread:?}");
        let mut steady = Brightness::new(0.0, 3);
        assert!((0..100).all(|_| steady.next() == 1.0));
    }
}
