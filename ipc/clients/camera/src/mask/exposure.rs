//! How the exposure changes over a sequence of images.

use super::frames::Frames;

/// Side of the blocks whose mean levels are compared, px.
const BLOCK: usize = 16;
/// Most blocks that the others are compared with.
const CANDIDATES: usize = 400;
/// Blocks change together if they differ by no more than this share of their level, beside what
/// noise does.
const TOGETHER: f32 = 0.004;
/// Variances of the noise that are allowed beside.
const NOISES: f32 = 3.0;
/// Least share of the image that must change together.
const LEAST: f64 = 0.01;

/// A block's mean level in each image, its mean over the images 1, and its share of noise.
struct Block {
    levels: Vec<f32>,
    noise: f32,
}

impl Block {
    /// Whether it changes as `course` does, in which noise has the variance `noise`.
    fn follows(&self, course: &[f32], noise: f32) -> bool {
        let squares = self.levels.iter().zip(course);
        let sum: f32 = squares.map(|(a, b)| (a - b).powi(2)).sum();
        let limit = TOGETHER.powi(2) + NOISES * (self.noise + noise);
        sum < limit * course.len() as f32
    }
}

/// How bright each image is beside the mean: as the course that most blocks of the image follow
/// together, which are those of something opaque. Where fewer than 1 % do, or as many do not change
/// at all, all are 1. `noise` is the variance of a pixel's noise, levels^2.
pub fn gains(frames: &Frames, noise: f32) -> Vec<f32> {
    let blocks = blocks(frames, noise);
    let constant = vec![1.0; frames.count()];
    let followers = |course: &[f32], noise: f32| -> Vec<&Block> {
        let blocks = blocks.iter();
        blocks
            .filter(|block| block.follows(course, noise))
            .collect()
    };
    let total = frames.width() * frames.height() / (BLOCK * BLOCK);
    // A block always follows itself.
    let least = (LEAST * total as f64).ceil().max(2.0) as usize;
    let candidates = blocks
        .iter()
        .step_by(blocks.len().div_ceil(CANDIDATES).max(1));
    let together = candidates.map(|block| followers(&block.levels, block.noise));
    let most = together.max_by_key(Vec::len).unwrap_or_default();
    if most.len() < least.max(followers(&constant, 0.0).len() + 1) {
        return constant;
    }
    let mean = |image: usize| {
        let sum: f32 = most.iter().map(|block| block.levels[image]).sum();
        sum / most.len() as f32
    };
    (0..frames.count()).map(mean).collect()
}

fn blocks(frames: &Frames, noise: f32) -> Vec<Block> {
    let (columns, rows) = (frames.width() / BLOCK, frames.height() / BLOCK);
    let pixels = (BLOCK * BLOCK) as f32;
    let block = |k: usize| {
        let first = k / columns * BLOCK * frames.width() + k % columns * BLOCK;
        let level = |image: usize| {
            let image = frames.pixels(image);
            let rows = (0..BLOCK).map(|row| &image[first + row * frames.width()..][..BLOCK]);
            rows.flatten().map(|level| f32::from(*level)).sum::<f32>() / pixels
        };
        let mut levels: Vec<f32> = (0..frames.count()).map(level).collect();
        let mean = levels.iter().sum::<f32>() / levels.len() as f32;
        // What is black tells nothing.
        (mean >= 1.0).then(|| {
            levels.iter_mut().for_each(|level| *level /= mean);
            Block {
                levels,
                noise: noise / (pixels * mean * mean),
            }
        })
    };
    (0..columns * rows).filter_map(block).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mask::frames::noisy;

    fn light(image: usize) -> f64 {
        1.0 + 0.2 * (0.3 * image as f64).sin()
    }

    /// A wave that runs through the image.
    fn wave(u: f64, v: f64, image: usize) -> f64 {
        90.0 + 40.0 * (0.05 * u + 0.07 * v + 0.9 * (image * image) as f64).sin()
    }

    #[test]
    fn what_keeps_still_tells_the_exposure() {
        // A quarter of the image keeps still.
        let frames = noisy(
            40,
            |u, v, k| light(k) * if u < 16.0 { 50.0 + u } else { wave(u, v, k) },
            2.0,
        );
        let mean = (0..40).map(light).sum::<f64>() / 40.0;
        for (k, gain) in gains(&frames, 4.0).iter().enumerate() {
            let expected = light(k) / mean;
            assert!(
                (f64::from(*gain) - expected).abs() < 0.01,
                "{k}: {gain}, {expected}"
            );
        }
    }

    #[test]
    fn a_constant_exposure_is_exactly_constant() {
        let still = |u: f64, v: f64, k: usize| if u < 16.0 { 50.0 + u } else { wave(u, v, k) };
        for frames in [
            noisy(40, still, 2.0),
            noisy(
                40,
                |u, v, k| wave(u, v, k) * (0.8 + 0.2 * (0.1 * v * k as f64).sin()),
                2.0,
            ),
        ] {
            assert_eq!(gains(&frames, 4.0), [1.0; 40]);
        }
    }
}
