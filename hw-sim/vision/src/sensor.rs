//! The sensor: noise.

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

/// Numbers of noise drawn once; each row of each frame reads them from another place.
const NOISE: usize = 1 << 16;

/// Reads the light.
#[derive(Clone, Debug)]
pub(crate) struct Sensor {
    /// Standard deviation, levels.
    amount: f32,
    noise: Vec<f32>,
    random: ChaCha8Rng,
}

impl Sensor {
    pub fn new(amount: f64, mut random: ChaCha8Rng) -> Self {
        Self {
            amount: amount as f32,
            noise: (0..NOISE).map(|_| normal(&mut random)).collect(),
            random,
        }
    }

    /// Makes of levels of light, rows of this width, what the sensor reads where it is this many
    /// times as bright.
    pub fn expose(&mut self, levels: &mut [f32], width: usize, brightness: f32) {
        for levels in levels.chunks_exact_mut(width) {
            let at = self.random.random::<u32>() as usize % NOISE;
            let noise = self.noise[at..].iter().chain(&self.noise).cycle();
            for (level, noise) in levels.iter_mut().zip(noise) {
                *level = brightness * *level + self.amount * noise;
            }
        }
    }
}

/// A number of the standard normal distribution (Box and Muller).
fn normal(random: &mut ChaCha8Rng) -> f32 {
    let (a, b) = (random.random::<f64>(), random.random::<f64>());
    ((-2.0 * (1.0 - a).ln()).sqrt() * (std::f64::consts::TAU * b).cos()) as f32
}
