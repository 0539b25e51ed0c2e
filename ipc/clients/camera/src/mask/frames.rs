//! A sequence of grey images of one size.

use super::error::LearnError;
use super::plane::Plane;
use crate::grey::Grey;

/// Least side of an image, px.
const LEAST_SIDE: usize = 32;

/// Grey images of one size.
#[derive(Clone, Debug)]
pub struct Frames {
    width: usize,
    height: usize,
    images: Vec<Vec<u8>>,
}

impl Frames {
    /// No image yet, of this size.
    ///
    /// # Errors
    /// [`LearnError::Small`].
    pub fn new(width: usize, height: usize) -> Result<Self, LearnError> {
        if width.min(height) < LEAST_SIDE {
            return Err(LearnError::Small { width, height });
        }
        Ok(Self {
            width,
            height,
            images: Vec::new(),
        })
    }

    /// Adds a copy of an image.
    ///
    /// # Errors
    /// [`LearnError::Size`] if it has another size.
    pub fn push(&mut self, image: Grey<'_>) -> Result<(), LearnError> {
        let (width, height) = (image.width(), image.height());
        if (width, height) != (self.width, self.height) {
            return Err(LearnError::Size {
                image: self.images.len(),
                width,
                height,
                expected: [self.width, self.height],
            });
        }
        let rows = (0..height).flat_map(|row| image.row(row));
        self.images.push(rows.copied().collect());
        Ok(())
    }

    /// Width, px.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Height, px.
    pub fn height(&self) -> usize {
        self.height
    }

    /// How many images there are.
    pub fn count(&self) -> usize {
        self.images.len()
    }

    /// The levels of an image, row by row from the top.
    pub fn pixels(&self, index: usize) -> &[u8] {
        &self.images[index]
    }

    /// An image times a factor.
    pub fn plane(&self, index: usize, factor: f32) -> Plane {
        let levels = self.images[index].iter();
        Plane {
            width: self.width,
            values: levels.map(|level| factor * f32::from(*level)).collect(),
        }
    }
}

/// Images of 64 x 48 px of what `level(u, v, image)` draws, with noise of this deviation.
#[cfg(test)]
pub fn noisy(count: usize, level: impl Fn(f64, f64, usize) -> f64, noise: f64) -> Frames {
    use rand::{RngExt, SeedableRng};
    let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(1);
    let mut frames = Frames::new(64, 48).unwrap();
    for image in 0..count {
        let pixels: Vec<u8> = (0..64 * 48)
            .map(|k| {
                // Twelve uniform numbers sum to a variance of 1.
                let normal: f64 = (0..12).map(|_| random.random::<f64>() - 0.5).sum();
                (level((k % 64) as f64, (k / 64) as f64, image) + noise * normal).round() as u8
            })
            .collect();
        frames
            .push(Grey::new(&pixels, 64, 48, 64).unwrap())
            .unwrap();
    }
    frames
}
