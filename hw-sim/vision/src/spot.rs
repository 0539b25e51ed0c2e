//! The spot on the lens: blur and loss of light.

use scene::Occlusion;

use crate::layer::{Area, soft};
use crate::lens::Lens;
use crate::look::SpotLook;

/// Number of box blurs that approximate a Gaussian.
const PASSES: usize = 3;

/// A spot with its buffers.
#[derive(Clone, Debug)]
pub(crate) struct Spot {
    look: SpotLook,
    /// Pixels of the shape and of the reach of the blur about it.
    area: Area,
    action: Vec<f32>,
    radius: usize,
    blurred: Vec<f32>,
    line: Vec<f32>,
}

impl Spot {
    pub fn new(
        occlusion: &Occlusion,
        lens: &Lens,
        look: SpotLook,
        width: usize,
        height: usize,
    ) -> Self {
        // The variance of PASSES boxes of 2r + 1 pixels is PASSES r (r + 1) / 3.
        let variance = 3.0 * look.blur_px * look.blur_px / PASSES as f64;
        let radius = (((1.0 + 4.0 * variance).sqrt() - 1.0) / 2.0).round() as usize;
        let area = Area::around(occlusion, lens, (PASSES * radius) as f64, width, height);
        Self {
            look,
            area,
            action: soft(occlusion, lens, area, look.softness_px),
            radius,
            blurred: vec![0.0; area.width * area.height],
            line: vec![0.0; area.width.max(area.height)],
        }
    }

    /// Blurs and dims what lies behind the spot, in levels of an image of this width.
    pub fn cover(&mut self, levels: &mut [f32], width: usize) {
        let area = self.area;
        if area.width == 0 || area.height == 0 {
            return;
        }
        for (row, range) in area.rows(width) {
            self.blurred[row * area.width..][..area.width].copy_from_slice(&levels[range]);
        }
        let (radius, line) = (self.radius, &mut self.line);
        let mut blur = |start: usize, stride: usize, count: usize| {
            box_blur(&mut self.blurred, start, stride, count, radius, line);
        };
        for _ in 0..PASSES {
            (0..area.height).for_each(|row| blur(row * area.width, 1, area.width));
            (0..area.width).for_each(|column| blur(column, area.width, area.height));
        }
        let (transmission, veil) = (self.look.transmission as f32, self.look.veil as f32);
        for (row, range) in area.rows(width) {
            let inside = row * area.width..(row + 1) * area.width;
            let layer = self.blurred[inside.clone()].iter();
            for ((level, blurred), action) in levels[range]
                .iter_mut()
                .zip(layer)
                .zip(&self.action[inside])
            {
                *level += action * (transmission * blurred + veil - *level);
            }
        }
    }
}

/// The mean over 2 radius + 1 pixels of a line of `count` pixels `stride` apart; its ends are
/// repeated.
fn box_blur(
    values: &mut [f32],
    start: usize,
    stride: usize,
    count: usize,
    radius: usize,
    line: &mut [f32],
) {
    for (k, x) in line[..count].iter_mut().enumerate() {
        *x = values[start + k * stride];
    }
    let at = |k: usize| line[k.saturating_sub(radius).min(count - 1)];
    // `at` is shifted by the radius: at(k) is the pixel k - radius.
    let mut sum: f32 = (0..=2 * radius).map(at).sum();
    let share = 1.0 / (2 * radius + 1) as f32;
    for k in 0..count {
        values[start + k * stride] = sum * share;
        sum += at(k + 1 + 2 * radius) - at(k);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_blurred_step_is_a_ramp_and_keeps_its_ends() {
        let mut values = [0.0, 0.0, 0.0, 9.0, 9.0, 9.0];
        box_blur(&mut values, 0, 1, 6, 1, &mut [0.0; 6]);
        assert_eq!(values, [0.0, 0.0, 3.0, 6.0, 9.0, 9.0]);
    }

    #[test]
    fn inside_the_spot_a_bright_disc_loses_its_contrast() {
        let scene = scene::Scene::parse(scene::PAPER_ROBOT, "robot").unwrap();
        let look = crate::Look::default().spot;
        let mut spot = Spot::new(
            &scene.occlusions[0],
            &Lens::new(&scene.camera, [0.0; 5]),
            look,
            640,
            480,
        );
        let mut levels = vec![90.0f32; 640 * 480];
        for i in 0..levels.len() {
            let (u, v) = ((i % 640) as f64, (i / 640) as f64);
            if (u - 320.0).hypot(v - 222.0) < 10.5 {
                levels[i] = 215.0;
            }
        }
        let before = levels.clone();
        spot.cover(&mut levels, 640);
        let contrast = levels[222 * 640 + 320] - levels[222 * 640 + 345];
        assert!((0.0..15.0).contains(&contrast), "{contrast}");
        let outside = |i: &usize| ((i % 640) as f64 - 320.0).hypot((i / 640) as f64 - 222.0) > 38.0;
        assert!(
            (0..levels.len())
                .filter(outside)
                .all(|i| levels[i] == before[i])
        );
    }
}
