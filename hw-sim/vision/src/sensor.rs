//! The sensor: noise and 8 bits.

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use crate::image::Image;

/// Numbers of noise drawn once; each row of each frame reads them from another place.
const NOISE: usize = 1 << 16;

/// Turns light into grey values.
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

    /// Exposes an image to levels of light, this many times as bright.
    pub fn expose(&mut self, levels: &[f32], brightness: f32, image: &mut Image) {
        let width = image.width();
        let rows = levels.chunks_exact(width);
        for (levels, pixels) in rows.zip(image.pixels_mut().chunks_exact_mut(width)) {
            let at = self.random.random::<u32>() as usize % NOISE;
            let noise = self.noise[at..].iter().chain(&self.noise).cycle();
            for ((level, noise), pixel) in levels.iter().zip(noise).zip(pixels) {
                // The cast saturates.
                *pixel = (brightness * level + self.amount * noise + 0.5) as u8;
            }
        }
    }
}

/// A number of the standard normal distribution (Box and Muller).
fn normal(random: &mut ChaCha8Rng) -> f32 {
    let (a, b) = (random.random::<f64>(), random.random::<f64>());
    ((-2.0 * (1.0 - a).ln()).sqrt() * (std::f64::consts::TAU * b).cos()) as f32
}
