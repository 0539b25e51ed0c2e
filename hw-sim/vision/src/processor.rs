//! The camera's processor: grey from a mosaic of colours, and sharpening. It gets what the sensor
//! read, noise and saturation included.

use crate::defocus::Defocus;
use crate::look::Look;

/// Level of a pixel that holds no more light.
const SATURATED: f32 = 255.0;
/// Standard deviation of the Gaussian that sharpening takes its difference from, px.
const HALO_PX: f64 = 1.0;

/// Shares of red, green and blue in grey (ITU-R BT.601).
const RED: f32 = 0.299;
const GREEN: f32 = 0.587;
const BLUE: f32 = 0.114;
/// By row and column, even or odd, of the mosaic RG over GB: shares of the pixel itself, of those
/// beside it, of those above and below, and of those at its corners, each group together.
const SHARES: [[[f32; 4]; 2]; 2] = [
    [
        [RED, 0.5 * GREEN, 0.5 * GREEN, BLUE],
        [GREEN, RED, BLUE, 0.0],
    ],
    [
        [GREEN, BLUE, RED, 0.0],
        [BLUE, 0.5 * GREEN, 0.5 * GREEN, RED],
    ],
];

/// What happens between sensor and image.
#[derive(Clone, Debug)]
pub(crate) struct Processor {
    width: usize,
    is_mosaic: bool,
    gain: f32,
    /// Blurs a copy; none without sharpening.
    halo: Option<Defocus>,
    copy: Vec<f32>,
}

impl Processor {
    /// For images of this size; `None` where the look asks for nothing.
    pub fn new(look: &Look, width: usize, height: usize) -> Option<Self> {
        let halo = Defocus::new(HALO_PX, width, height).filter(|_| look.sharpening > 0.0);
        (look.demosaic || halo.is_some()).then(|| Self {
            width,
            is_mosaic: look.demosaic,
            gain: look.sharpening as f32,
            halo,
            copy: vec![0.0; width * height],
        })
    }

    /// Processes the levels that the sensor read.
    pub fn process(&mut self, levels: &mut [f32]) {
        for level in &mut *levels {
            *level = level.clamp(0.0, SATURATED);
        }
        if self.is_mosaic {
            self.copy.copy_from_slice(levels);
            demosaic(&self.copy, levels, self.width);
        }
        if let Some(halo) = &mut self.halo {
            self.copy.copy_from_slice(levels);
            halo.blur(&mut self.copy);
            for (level, mean) in levels.iter_mut().zip(&self.copy) {
                *level += self.gain * (*level - mean);
            }
        }
    }
}

/// Grey of a mosaic `raw`, each colour bilinear between the pixels that see it. The image is
/// mirrored at its borders, which keeps the colours' order.
fn demosaic(raw: &[f32], grey: &mut [f32], width: usize) {
    let height = raw.len() / width;
    let around = |k: usize, size: usize| {
        let last = size - 1;
        [
            k.abs_diff(1).min(last),
            if k < last {
                k + 1
            } else {
                last.saturating_sub(1)
            },
        ]
    };
    for (row, line) in grey.chunks_exact_mut(width).enumerate() {
        let [above, below] = around(row, height);
        let [above, here, below] = [above, row, below].map(|row| &raw[row * width..][..width]);
        for (column, level) in line.iter_mut().enumerate() {
            let [left, right] = around(column, width);
            let [own, beside, upright, corners] = SHARES[row % 2][column % 2];
            *level = own * here[column]
                + 0.5 * beside * (here[left] + here[right])
                + 0.5 * upright * (above[column] + below[column])
                + 0.25 * corners * (above[left] + above[right] + below[left] + below[right]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIDE: usize = 12;

    fn processed(look: Look, level: impl Fn(usize, usize) -> f32) -> Vec<f32> {
        let look = Look {
            sharpening: look.sharpening,
            demosaic: look.demosaic,
            ..Look::default()
        };
        let levels = (0..SIDE * SIDE).map(|k| level(k % SIDE, k / SIDE));
        let mut levels: Vec<f32> = levels.collect();
        let mut processor = Processor::new(&look, SIDE, SIDE).unwrap();
        processor.process(&mut levels);
        levels
    }

    fn mosaic() -> Look {
        Look {
            demosaic: true,
            ..Look::default()
        }
    }

    /// A colour picture's grey, where each pixel of the sensor sees one of its colours.
    #[test]
    fn a_plane_of_colours_becomes_its_grey() {
        // Bilinear interpolation is exact in a plane, away from the mirrored borders.
        let colours = |u: f32, v: f32| [90.0 + 3.0 * u, 60.0 + 2.0 * v, 120.0 - 4.0 * u + v];
        let grey = processed(mosaic(), |u, v| {
            let [red, green, blue] = colours(u as f32, v as f32);
            match (u % 2, v % 2) {
                (0, 0) => red,
                (1, 1) => blue,
                _ => green,
            }
        });
        for (u, v) in (1..SIDE - 1).flat_map(|u| (1..SIDE - 1).map(move |v| (u, v))) {
            let [red, green, blue] = colours(u as f32, v as f32);
            let expected = 0.299 * red + 0.587 * green + 0.114 * blue;
            let found = grey[v * SIDE + u];
            assert!(
                (found - expected).abs() < 1e-3,
                "({u}, {v}): {found}, not {expected}"
            );
        }
    }

    #[test]
    fn an_upright_edge_gets_a_zipper_and_an_even_picture_stays() {
        let grey = processed(mosaic(), |u, _| if u < 6 { 0.0 } else { 200.0 });
        // Beside the edge red and green alternate with green and blue from row to row.
        let [even, odd] = [4, 5].map(|v| grey[v * SIDE + 5]);
        assert!((even - odd).abs() > 10.0, "{even} {odd}");
        let even = processed(mosaic(), |_, _| 77.0);
        assert!(even.iter().all(|level| (level - 77.0).abs() < 1e-3));
    }

    #[test]
    fn sharpening_adds_its_gain_times_the_difference_from_the_blurred_picture() {
        let edge = |u: usize| if u < 6 { 50.0 } else { 150.0 };
        let mut blurred = (0..SIDE * SIDE)
            .map(|k| edge(k % SIDE))
            .collect::<Vec<f32>>();
        Defocus::new(1.0, SIDE, SIDE).unwrap().blur(&mut blurred);
        let look = Look {
            sharpening: 0.8,
            ..Look::default()
        };
        let sharp = processed(look, |u, _| edge(u));
        for (k, (sharp, blurred)) in sharp.iter().zip(&blurred).enumerate() {
            let level = edge(k % SIDE);
            assert!((sharp - level - 0.8 * (level - blurred)).abs() < 1e-3);
        }
        // The halo: darker before the edge, brighter behind it.
        assert!(
            sharp[5] < 30.0 && sharp[6] > 170.0,
            "{} {}",
            sharp[5],
            sharp[6]
        );
        // What was saturated cannot get a difference from beyond.
        let look = Look {
            sharpening: 1.0,
            ..Look::default()
        };
        let bright = processed(look, |_, _| 400.0);
        assert!(bright.iter().all(|level| (level - 255.0).abs() < 1e-2));
    }

    #[test]
    fn nothing_is_processed_unless_asked_for() {
        assert!(Processor::new(&Look::default(), SIDE, SIDE).is_none());
    }
}
