//! A tag on the plane, ready to be drawn.

use markers::Family;

use crate::homography::{Homography, Point};
use crate::lens::{Lens, Rays};
use crate::look::Look;
use crate::tag::Tag;

/// Samples of a pixel that the edge of a module crosses: their offsets along u, along v and in time
/// are those of a lattice (Fibonacci's along u and v), evenly spread along each and every slant.
const SAMPLES: usize = 34;
/// Its steps along v and in time.
const LATTICE: [usize; 2] = [21, 9];
/// Points along each side of a tag by which it is found in a picture that is distorted.
const PLACES: usize = 8;

/// A tag, ready to be drawn.
#[derive(Clone, Debug)]
pub(crate) struct Sheet {
    tag: Tag,
    family: Family,
    modules: Vec<u16>,
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
            family: look.family,
            modules: tag.rows(look.family),
            levels: [look.black_level, look.white_level].map(|level| (light * level) as f32),
            window: [[0; 2]; 2],
        }
    }

    /// Finds where it may be seen in an image while it is seen by these maps, one after another.
    /// `image` is the box of what the image shows, px of the pinhole.
    pub fn aim(&mut self, maps: &[Homography], lens: &Lens, image: [Point; 2], size: [usize; 2]) {
        let (mut least, mut most) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        let rim = self.tag.rim(self.family);
        let places = (0..4 * PLACES).map(|k| {
            let (from, to) = (rim[k / PLACES], rim[(k / PLACES + 1) % 4]);
            let share = (k % PLACES) as f64 / PLACES as f64;
            [0, 1].map(|k| from[k] + share * (to[k] - from[k]))
        });
        for (map, place) in maps
            .iter()
            .flat_map(|map| places.clone().map(move |x| (map, x)))
        {
            // A place behind the camera: the tag may be anywhere.
            let seen = map.apply(place).map_or(image, |at| [at; 2]);
            for at in seen {
                // What is far outside has no place in the picture.
                let near = [0, 1].map(|k| at[k].clamp(image[0][k], image[1][k]));
                let pixel = lens.distort(near);
                for k in 0..2 {
                    least[k] = least[k].min(pixel[k]);
                    most[k] = most[k].max(pixel[k]);
                }
            }
        }
        // The casts saturate.
        self.window = [
            [0, 1].map(|k| ((least[k] - 1.0).floor() as usize).min(size[k])),
            [0, 1].map(|k| (most[k] + 3.0).min(size[k] as f64) as usize),
        ];
    }

    /// The level at a point in modules from the corner of the white border; `None` beside the tag.
    fn level(&self, at: [f64; 2]) -> Option<f32> {
        let inside = |x: f64| (0.0..self.modules.len() as f64).contains(&x);
        // The casts cut, which is the floor of what is not negative, without a call.
        (inside(at[0]) && inside(at[1])).then(|| {
            let bits = self.modules[at[1] as usize];
            self.levels[usize::from(bits >> at[0] as usize & 1)]
        })
    }

    /// Draws the pixels of a row that it covers, wholly or in part. `backs` lead to the plane at the
    /// begin and at the end of the exposure. Within a pixel and its exposure they are taken to be
    /// linear. `shine` is the level that a point of the plane adds; it is even over a pixel.
    pub fn draw(
        &self,
        line: &mut [f32],
        row: usize,
        backs: &[Homography; 2],
        rays: &Rays,
        shine: impl Fn(Point) -> f32,
    ) {
        let [[left, top], [right, bottom]] = self.window;
        if !(top..bottom).contains(&row) || left >= right {
            return;
        }
        let (center, scale) = (self.tag.center, 1.0 / self.tag.module(self.family));
        let middle = 0.5 * self.modules.len() as f64;
        let modules = |back: &Homography, pixel: Point| {
            let point = back.apply(pixel)?;
            Some([0, 1].map(|k| (point[k] - center[k]) * scale + middle))
        };
        let [first, last] = backs;
        for (u, pixel) in (left..right).zip(&mut line[left..right]) {
            let (at, [right, below]) = (rays.at(u, row), rays.slopes(u, row));
            let moved = |way: Point| [0, 1].map(|k| at[k] + way[k]);
            let places = [
                modules(first, at),
                modules(last, at),
                modules(first, moved(right)),
                modules(first, moved(below)),
            ];
            let [Some(from), Some(to), Some(beside), Some(under)] = places else {
                continue;
            };
            let way = |to: Point| [0, 1].map(|k| to[k] - from[k]);
            let [motion, du, dv] = [to, beside, under].map(way);
            // Half a pixel's diagonal, generously, for a plane seen at a slant; and the way that it
            // moves during the exposure.
            let most = |way: Point| way[0].abs().max(way[1].abs());
            let reach = 0.75 * (most(du) + most(dv)) + most(motion) + 1e-9;
            let is_plain = from.iter().all(|x| {
                let depth = x - *x as i64 as f64;
                depth > reach && depth < 1.0 - reach
            });
            let light = shine([0, 1].map(|k| (from[k] - middle) / scale + center[k]));
            let level = |at: Point| self.level(at).map(|level| level + light);
            if is_plain {
                *pixel = level(from).unwrap_or(*pixel);
                continue;
            }
            let share = |k: usize| (k as f64 + 0.5) / SAMPLES as f64;
            let samples = (0..SAMPLES).map(|k| {
                let [v, time] = LATTICE.map(|step| share(k * step % SAMPLES));
                let (a, b) = (share(k) - 0.5, v - 0.5);
                let at = [0, 1].map(|k| from[k] + a * du[k] + b * dv[k] + time * motion[k]);
                level(at).unwrap_or(*pixel)
            });
            *pixel = samples.sum::<f32>() / SAMPLES as f32;
        }
    }
}
