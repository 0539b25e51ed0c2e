//! Drawings of tags for the tests of this crate.

use markers::Family;
use nalgebra::{Matrix3, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Samples along a side of a pixel.
const SAMPLES: usize = 6;
/// Levels of print.
pub const BLACK: f64 = 30.0;
pub const WHITE: f64 = 200.0;

/// An image in the making: levels of light.
pub struct Drawing {
    pub width: usize,
    pub height: usize,
    pub levels: Vec<f64>,
}

impl Drawing {
    pub fn new(width: usize, height: usize, level: f64) -> Self {
        Self {
            width,
            height,
            levels: vec![level; width * height],
        }
    }

    /// Paints what `level` gives at each sample, over what is there.
    pub fn paint(&mut self, level: impl Fn(f64, f64) -> Option<f64>) {
        let offset = |i: usize| (i as f64 + 0.5) / SAMPLES as f64 - 0.5;
        for (n, out) in self.levels.iter_mut().enumerate() {
            let (u, v) = ((n % self.width) as f64, (n / self.width) as f64);
            let samples = (0..SAMPLES * SAMPLES)
                .map(|k| level(u + offset(k % SAMPLES), v + offset(k / SAMPLES)).unwrap_or(*out));
            *out = samples.sum::<f64>() / (SAMPLES * SAMPLES) as f64;
        }
    }

    /// Lays a shape over what is there; `distance` to its border in px, negative inside.
    pub fn cover(&mut self, level: f64, distance: impl Fn(f64, f64) -> f64) {
        for (n, out) in self.levels.iter_mut().enumerate() {
            let (u, v) = ((n % self.width) as f64, (n / self.width) as f64);
            let share = (0.5 - distance(u, v)).clamp(0.0, 1.0);
            *out += share * (level - *out);
        }
    }

    /// Paints a tag with its white border; `h` takes tag coordinates to px.
    pub fn tag(&mut self, family: Family, number: u32, h: &Matrix3<f64>) {
        self.tag_on(family, number, h, 1.0);
    }

    /// The same with a white border of this many modules.
    pub fn tag_on(&mut self, family: Family, number: u32, h: &Matrix3<f64>, white: f64) {
        let black = family.black() as f64;
        let back = h.try_inverse().unwrap();
        self.paint(|u, v| {
            let p = back * Vector3::new(u, v, 1.0);
            let [i, j] = [p.x / p.z, p.y / p.z].map(|x| (0.5 * (x + 1.0) * black).floor());
            let is_within =
                |least: f64, most: f64| (least..=most).contains(&i) && (least..=most).contains(&j);
            if is_within(0.0, black - 1.0) {
                let is_white = family.is_white(number, [i, j].map(|k| k as usize));
                Some(if is_white { WHITE } else { BLACK })
            } else {
                is_within(-white, black - 1.0 + white).then_some(WHITE)
            }
        });
    }

    /// Blurs by a Gaussian of this standard deviation, px.
    pub fn blur(&mut self, sigma: f64) {
        let reach = (4.0 * sigma).ceil() as i64;
        let weights = Vec::from_iter((-reach..=reach).map(|k| {
            let x = k as f64 / sigma;
            (-0.5 * x * x).exp()
        }));
        let sum: f64 = weights.iter().sum();
        for [du, dv] in [[1, 0], [0, 1]] {
            let (width, height) = (self.width as i64, self.height as i64);
            let before = self.levels.clone();
            for (n, out) in self.levels.iter_mut().enumerate() {
                let (u, v) = (n as i64 % width, n as i64 / width);
                let at = |k: i64| {
                    let u = (u + k * du).clamp(0, width - 1);
                    let v = (v + k * dv).clamp(0, height - 1);
                    before[(v * width + u) as usize]
                };
                let terms = (-reach..=reach).zip(&weights).map(|(k, w)| w * at(k));
                *out = terms.sum::<f64>() / sum;
            }
        }
    }

    /// What a camera's processor does to every picture: adds the difference from the blurred one.
    pub fn sharpen(&mut self, gain: f64) {
        let levels = self.levels.clone();
        self.blur(1.0);
        for (out, level) in self.levels.iter_mut().zip(levels) {
            *out = (level + gain * (level - *out)).clamp(0.0, 255.0);
        }
    }

    /// A share of the light leaks into the rows below, and fades over this length, px.
    pub fn smear(&mut self, share: f64, length: f64) {
        let light = |level: f64| (level / 255.0).max(0.0).powf(2.2);
        let fade = (-1.0 / length).exp();
        for column in 0..self.width {
            let mut above = light(self.levels[column]);
            for out in self.levels[column..].iter_mut().step_by(self.width) {
                let here = light(*out);
                above = fade * above + (1.0 - fade) * here;
                *out = 255.0 * (here + share * (above - here)).powf(1.0 / 2.2);
            }
        }
    }

    /// Each pixel sees one colour of a Bayer mosaic, and the others come from its neighbours.
    pub fn demosaic(&mut self) {
        let levels = self.levels.clone();
        let (width, height) = (self.width as i64, self.height as i64);
        let colour = |u: i64, v: i64| ((u & 1) + (v & 1)) as usize;
        for (n, out) in self.levels.iter_mut().enumerate() {
            let (u, v) = (n as i64 % width, n as i64 / width);
            let mut sums = [[0.0; 2]; 3];
            for k in 0..9 {
                let (i, j) = (
                    (u + k % 3 - 1).clamp(0, width - 1),
                    (v + k / 3 - 1).clamp(0, height - 1),
                );
                let weight = [1.0, 2.0, 4.0][usize::from(k % 3 == 1) + usize::from(k / 3 == 1)];
                let [sum, count] = &mut sums[colour(i, j)];
                *sum += weight * levels[(j * width + i) as usize];
                *count += weight;
            }
            if colour(u, v) == 1 {
                // Green where it is seen itself.
                sums[1] = [levels[n], 1.0];
            }
            let [red, green, blue] = sums.map(|[sum, count]| sum / count);
            *out = 0.299 * red + 0.587 * green + 0.114 * blue;
        }
    }

    /// A light mirrored about a point, brighter by so many levels, with this radius, px.
    pub fn gloss(&mut self, [u, v]: [f64; 2], brighter: f64, radius: f64) {
        for (n, out) in self.levels.iter_mut().enumerate() {
            let (i, j) = ((n % self.width) as f64, (n / self.width) as f64);
            let far = (i - u).hypot(j - v) / radius;
            *out = (*out + brighter * (-0.5 * far * far).exp()).min(255.0);
        }
    }

    /// The image with noise of this standard deviation, levels.
    pub fn pixels(&self, noise: f64, seed: u64) -> Vec<u8> {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let mut normal = || {
            let (a, b) = (random.random::<f64>(), random.random::<f64>());
            (-2.0 * (1.0 - a).ln()).sqrt() * (std::f64::consts::TAU * b).cos()
        };
        let levels = self.levels.iter();
        levels.map(|x| (x + noise * normal() + 0.5) as u8).collect()
    }
}

/// The homography of a tag about (u, v) px with a black square of `side` px, turned by `turn` rad in
/// the image and tilted.
pub fn placed([u, v]: [f64; 2], side: f64, turn: f64, tilt: [f64; 2]) -> Matrix3<f64> {
    let (s, c) = turn.sin_cos();
    let half = 0.5 * side;
    let affine = Matrix3::new(half * c, -half * s, u, half * s, half * c, v, 0.0, 0.0, 1.0);
    affine * Matrix3::new(1.0, 0.0, 0.0, 0.0, 1.0, 0.0, tilt[0], tilt[1], 1.0)
}
