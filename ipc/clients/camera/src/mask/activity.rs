//! What changes in a sequence of images: level and fine structure of each pixel over time.

use super::exposure;
use super::frames::Frames;
use super::plane::{Blur, Plane, box_mean};

/// Standard deviations of the two Gaussians whose difference is the fine structure, px.
const FINE: [f64; 2] = [1.0, 2.5];
/// Half sides of the windows over which the variances of levels and of fine structure are averaged,
/// px.
const LEVEL_HALF: usize = 1;
const FINE_HALF: usize = 2;
/// Least variance of noise, levels^2: that of rounding to whole levels.
const ROUNDING: f32 = 1.0 / 12.0;
/// Median of the magnitude of a standard normal number.
const MEDIAN: f32 = 0.6745;

/// Variances over time, and what noise alone would give.
#[derive(Clone, Debug)]
pub struct Activity {
    /// Variance of each pixel's level, levels^2.
    pub level: Plane,
    /// Variance of its fine structure, levels^2.
    pub fine: Plane,
    /// Mean square of its fine structure, levels^2: what the variance is where all of it changes.
    pub energy: Plane,
    /// Variance of the camera's noise, levels^2.
    pub noise: f32,
    /// Variance of the noise's fine structure, levels^2.
    pub fine_noise: f32,
    gains: Vec<f32>,
    blurs: [Blur; 2],
}

impl Activity {
    /// Measures a sequence; the noise is estimated from the images where none is given (standard
    /// deviation, levels).
    pub fn of(frames: &Frames, noise: Option<f64>) -> Self {
        let blurs = FINE.map(Blur::gaussian);
        let given = noise.map(|deviation| (deviation * deviation) as f32);
        let deviations = match given {
            Some(_) => Vec::new(),
            None => noise_deviations(frames),
        };
        let noise_at = |gains: &[f32]| {
            let scaled = deviations
                .iter()
                .map(|(k, deviation)| deviation / gains[*k]);
            let estimated = || median(scaled.collect()).powi(2);
            given.unwrap_or_else(estimated).max(ROUNDING)
        };
        let gains = exposure::gains(frames, noise_at(&vec![1.0; frames.count()]));
        // In levels of the mean exposure, as all that follows.
        let noise = noise_at(&gains);
        let mut activity = Self {
            level: Plane::new(frames.width(), frames.height()),
            fine: Plane::new(frames.width(), frames.height()),
            energy: Plane::new(frames.width(), frames.height()),
            noise,
            fine_noise: noise * difference_gain(&blurs),
            gains,
            blurs,
        };
        activity.measure(frames);
        activity
    }

    /// The fine structure of an image of the sequence, its exposure that of the mean.
    fn fine_structure(&self, frames: &Frames, index: usize) -> (Plane, Plane) {
        let level = frames.plane(index, 1.0 / self.gains[index]);
        let mut fine = self.blurs[0].of(&level);
        let coarse = self.blurs[1].of(&level);
        let values = fine.values.iter_mut().zip(&coarse.values);
        values.for_each(|(fine, coarse)| *fine -= coarse);
        (level, fine)
    }

    /// Where the fine structure of an image is more than noise: its mean square over a small
    /// window, levels^2.
    pub fn structure(&self, frames: &Frames, index: usize) -> Plane {
        let (_, mut fine) = self.fine_structure(frames, index);
        fine.values.iter_mut().for_each(|value| *value *= *value);
        box_mean(&fine, FINE_HALF)
    }

    /// Fills in the planes.
    fn measure(&mut self, frames: &Frames) {
        let empty = || Moments::new(frames.width(), frames.height());
        let (mut levels, mut fines) = (empty(), empty());
        for index in 0..frames.count() {
            let (level, fine) = self.fine_structure(frames, index);
            levels.add(&level);
            fines.add(&fine);
        }
        self.level = box_mean(&levels.variance(), LEVEL_HALF);
        self.fine = box_mean(&fines.variance(), FINE_HALF);
        let mut energy = fines.variance();
        let squares = energy.values.iter_mut().zip(&fines.mean.values);
        squares.for_each(|(energy, mean)| *energy += mean * mean);
        self.energy = box_mean(&energy, FINE_HALF);
    }
}

/// Mean and variance of each pixel, image by image (Welford).
struct Moments {
    count: f32,
    mean: Plane,
    squares: Plane,
}

impl Moments {
    fn new(width: usize, height: usize) -> Self {
        Self {
            count: 0.0,
            mean: Plane::new(width, height),
            squares: Plane::new(width, height),
        }
    }

    fn add(&mut self, plane: &Plane) {
        self.count += 1.0;
        let sums = self.mean.values.iter_mut().zip(&mut self.squares.values);
        for ((mean, square), value) in sums.zip(&plane.values) {
            let off = value - *mean;
            *mean += off / self.count;
            *square += off * (value - *mean);
        }
    }

    fn variance(&self) -> Plane {
        let mut variance = self.squares.clone();
        let count = self.count.max(1.0);
        variance
            .values
            .iter_mut()
            .for_each(|square| *square /= count);
        variance
    }
}

/// Variance of noise after the difference of two blurs, for noise of variance 1 that neighbouring
/// pixels do not share.
fn difference_gain(blurs: &[Blur; 2]) -> f32 {
    let weight = |blur: &Blur, k: i64, l: i64| blur.weight(k) * blur.weight(l);
    let reach = blurs.iter().map(Blur::reach).max().unwrap_or(0);
    let offsets = || -reach..=reach;
    let squares = offsets().flat_map(|k| {
        offsets().map(move |l| (weight(&blurs[0], k, l) - weight(&blurs[1], k, l)).powi(2))
    });
    squares.sum()
}

/// Standard deviation of the pixels' noise in some images, and which: the median over pixels of
/// what the mask [1 -2 1; -2 4 -2; 1 -2 1] leaves, which smooth surfaces and straight edges do not
/// touch.
///
/// Source: J. Immerkaer, "Fast noise variance estimation" (1996), with a median for the mean.
fn noise_deviations(frames: &Frames) -> Vec<(usize, f32)> {
    const IMAGES: usize = 8;
    let (width, height) = (frames.width(), frames.height());
    let step = frames.count().div_ceil(IMAGES).max(1);
    let of_image = |index: usize| {
        let pixels = frames.pixels(index);
        let second = |at: usize| {
            let [a, b, c] = [at - 1, at, at + 1].map(|at| f32::from(pixels[at]));
            a - 2.0 * b + c
        };
        let inner = (1..height - 1).flat_map(|row| (1..width - 1).map(move |u| row * width + u));
        let left = inner
            .map(|at| (second(at - width) - 2.0 * second(at) + second(at + width)).abs() / 6.0);
        (index, median(left.collect()) / MEDIAN)
    };
    (0..frames.count()).step_by(step).map(of_image).collect()
}

fn median(mut values: Vec<f32>) -> f32 {
    let middle = values.len() / 2;
    match values.is_empty() {
        true => 0.0,
        false => *values.select_nth_unstable_by(middle, f32::total_cmp).1,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mask::frames::noisy;

    #[test]
    fn the_noise_of_a_sequence_is_told_from_its_images() {
        let frames = noisy(30, |u, v, _| 80.0 + 0.1 * u + 0.2 * v, 3.0);
        let activity = Activity::of(&frames, None);
        let deviation = activity.noise.sqrt();
        assert!((deviation - 3.0).abs() < 0.1, "{deviation}");
        // Nothing but noise, in the levels and in the fine structure.
        let mean = |plane: &Plane| plane.values.iter().sum::<f32>() / plane.values.len() as f32;
        let ratio = [
            mean(&activity.level) / activity.noise,
            mean(&activity.fine) / activity.fine_noise,
        ];
        assert!(
            ratio.iter().all(|ratio| (ratio - 1.0).abs() < 0.1),
            "{ratio:?}"
        );
    }

    #[test]
    fn a_still_image_under_changing_light_stays_still() {
        let wave = |u: f64, v: f64| 100.0 + 40.0 * (0.7 * u).sin() * (0.9 * v).cos();
        let light = |k: usize| 1.0 + 0.2 * (0.3 * k as f64).sin();
        let frames = noisy(40, |u, v, k| light(k) * wave(u, v), 1.0);
        let activity = Activity::of(&frames, None);
        let most = activity
            .level
            .values
            .iter()
            .fold(0.0, |a: f32, b| a.max(*b));
        assert!(most < 4.0, "{most}");
    }
}
