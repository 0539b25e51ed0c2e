//! A tag on the plane, ready to be drawn.

use crate::homography::Homography;
use crate::look::Look;
use crate::tag::{SIDE, Tag};

/// Samples of a pixel that the edge of a module crosses, and the step of their lattice (Fibonacci):
/// along u, v and every slant their offsets are evenly spread.
const LATTICE: [usize; 2] = [34, 21];

/// A tag, ready to be drawn.
#[derive(Clone, Debug)]
pub(crate) struct Sheet {
    tag: Tag,
    modules: [u16; SIDE],
    /// Levels of black and of white modules.
    levels: [f32; 2],
    /// First column and row of the image that it may touch, and those after the last.
    window: [[usize; 2]; 2],
}

impl Sheet {
    pub fn new(tag: &Tag, look: &Look) -> Self {
        // Lit from the left, as the plane is.
        let light = 1.0 - 0.5 * tag.center[0].clamp(-0.3, 0.3);
        Self {
            tag: *tag,
            modules: tag.rows(),
            levels: [look.black_level, look.white_level].map(|level| (light * level) as f32),
            window: [[0; 2]; 2],
        }
    }

    /// Finds where it may be seen in an image of this size while the map goes from the first to the
    /// last.
    pub fn aim(&mut self, maps: &[Homography], size: [usize; 2]) {
        let (mut least, mut most) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        let rim = self.tag.rim();
        let corners = maps
            .iter()
            .flat_map(|map| rim.map(|corner| map.apply(corner)));
        for corner in corners {
            // A corner behind the camera: the tag may be anywhere.
            let [low, high] = corner.map_or([[0.0; 2], [f64::INFINITY; 2]], |at| [at; 2]);
            for k in 0..2 {
                least[k] = least[k].min(low[k]);
                most[k] = most[k].max(high[k]);
            }
        }
        // The casts saturate.
        self.window = [
            [0, 1].map(|k| (least[k].floor() as usize).min(size[k])),
            [0, 1].map(|k| (most[k] + 2.0).min(size[k] as f64) as usize),
        ];
    }

    /// The level at a point in modules from the corner of the white border; `None` beside the tag.
    fn level(&self, at: [f64; 2]) -> Option<f32> {
        let cell = at.map(f64::floor);
        let inside = |x: f64| (0.0..SIDE as f64).contains(&x);
        (inside(cell[0]) && inside(cell[1])).then(|| {
            let bits = self.modules[cell[1] as usize];
            self.levels[usize::from(bits >> cell[0] as usize & 1)]
        })
    }

    /// Draws the pixels of a row that it covers, wholly or in part; `back` leads to the plane.
    pub fn draw(&self, line: &mut [f32], row: usize, back: &Homography) {
        let [[left, top], [right, bottom]] = self.window;
        if !(top..bottom).contains(&row) || left >= right {
            return;
        }
        let (center, scale) = (self.tag.center, 1.0 / self.tag.module());
        let modules = |u: f64, v: f64| {
            let point = back.apply([u, v])?;
            Some([0, 1].map(|k| (point[k] - center[k]) * scale + 0.5 * SIDE as f64))
        };
        let v = row as f64;
        let mut before = modules(left as f64 - 1.0, v);
        for (u, pixel) in (left..right).zip(&mut line[left..right]) {
            let here = modules(u as f64, v);
            let (Some(from), Some(at)) = (before, here) else {
                before = here;
                continue;
            };
            before = here;
            // Half a pixel's diagonal, generously, for a plane seen at a slant.
            let reach = 1.5 * (at[0] - from[0]).abs().max((at[1] - from[1]).abs()) + 1e-9;
            let is_plain = at.iter().all(|x| {
                let depth = x - x.floor();
                depth > reach && depth < 1.0 - reach
            });
            if is_plain {
                *pixel = self.level(at).unwrap_or(*pixel);
                continue;
            }
            let [count, step] = LATTICE;
            let offset = |k: usize| (k as f64 + 0.5) / count as f64 - 0.5;
            let samples = (0..count).map(|k| {
                let sample = modules(u as f64 + offset(k), v + offset(k * step % count));
                sample.and_then(|at| self.level(at)).unwrap_or(*pixel)
            });
            *pixel = samples.sum::<f32>() / count as f32;
        }
    }
}
