//! The plane of the pattern: table, box and the discs on it.

use scene::{MAX_POINTS, Scene};

use crate::homography::{Homography, Point};
use crate::look::Look;
use crate::tag::{SIDE, Tag};
use crate::texture::Texture;

/// Pixels of a row over which the plane is taken to be linear.
const SPAN: usize = 16;
/// Samples along a side of a pixel that a marker's rim crosses.
const SAMPLES: usize = 8;
/// The box is larger than the pattern by this many radii of a marker on each side.
const MARGIN: f64 = 4.0;
/// The box reaches this many sides of a tag's black square beyond the tag's centre.
const EDGE: f64 = 1.0;

/// Samples of a pixel that the edge of a module crosses, and the step of their lattice (Fibonacci):
/// along u, v and every slant their offsets are evenly spread.
const LATTICE: [usize; 2] = [34, 21];

/// A tag, ready to be drawn.
#[derive(Clone, Debug)]
struct Sheet {
    tag: Tag,
    modules: [u16; SIDE],
    /// First column and row of the image that it may touch, and those after the last.
    window: [[usize; 2]; 2],
}

/// The plane with its markers.
#[derive(Clone, Debug)]
pub(crate) struct Plane {
    look: Look,
    pattern: heapless::Vec<Point, MAX_POINTS>,
    sheets: Vec<Sheet>,
    /// Corner of the box that is least and that is greatest in x and y, m.
    outline: [Point; 2],
}

impl Plane {
    pub fn new(scene: &Scene, look: &Look) -> Self {
        let pattern: heapless::Vec<Point, MAX_POINTS> =
            scene.pattern.iter().map(|p| [p[0], p[1]]).collect();
        let margin = MARGIN * look.marker_radius_m;
        let outline = pattern
            .iter()
            .fold([[f64::INFINITY; 2], [f64::NEG_INFINITY; 2]], |o, p| {
                [
                    [0, 1].map(|k| o[0][k].min(p[k] - margin)),
                    [0, 1].map(|k| o[1][k].max(p[k] + margin)),
                ]
            });
        Self {
            look: *look,
            pattern,
            sheets: Vec::new(),
            outline,
        }
    }

    /// A plane with these tags instead of discs.
    pub fn with_tags(look: &Look, tags: &[Tag]) -> Self {
        let mut outline = [[f64::INFINITY; 2], [f64::NEG_INFINITY; 2]];
        for tag in tags {
            let margin = EDGE * tag.size;
            for k in 0..2 {
                outline[0][k] = outline[0][k].min(tag.center[k] - margin);
                outline[1][k] = outline[1][k].max(tag.center[k] + margin);
            }
        }
        let sheet = |tag: &Tag| Sheet {
            tag: *tag,
            modules: tag.rows(),
            window: [[0; 2]; 2],
        };
        Self {
            look: *look,
            pattern: heapless::Vec::new(),
            sheets: tags.iter().map(sheet).collect(),
            outline,
        }
    }

    /// Finds where tags may be seen in an image of this size while the map goes from the first to
    /// the last.
    pub fn aim(&mut self, maps: &[Homography; 2], size: [usize; 2]) {
        for sheet in &mut self.sheets {
            let (mut least, mut most) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
            let rim = sheet.tag.rim();
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
            sheet.window = [
                [0, 1].map(|k| (least[k].floor() as usize).min(size[k])),
                [0, 1].map(|k| (most[k] + 2.0).min(size[k] as f64) as usize),
            ];
        }
    }

    /// Draws a row of the image, `line`, as seen by a map from the plane.
    pub fn draw(&self, line: &mut [f32], row: usize, map: &Homography, texture: &Texture) {
        self.draw_ground(line, row, map, texture);
        self.draw_markers(line, row, map);
        if let Some(back) = map.inverse() {
            for sheet in &self.sheets {
                self.draw_tag(line, row, sheet, &back);
            }
        }
    }

    /// The pixels of a row that a tag covers, wholly or in part; `back` leads to the plane.
    fn draw_tag(&self, line: &mut [f32], row: usize, sheet: &Sheet, back: &Homography) {
        let [[left, top], [right, bottom]] = sheet.window;
        if !(top..bottom).contains(&row) || left >= right {
            return;
        }
        let (center, scale) = (sheet.tag.center, 1.0 / sheet.tag.module());
        // In modules from the corner of the white border.
        let modules = |u: f64, v: f64| {
            let point = back.apply([u, v])?;
            Some([0, 1].map(|k| (point[k] - center[k]) * scale + 0.5 * SIDE as f64))
        };
        let light = (1.0 - 0.5 * center[0].clamp(-0.3, 0.3)) as f32;
        let levels =
            [self.look.black_level as f32, self.look.marker_level as f32].map(|x| x * light);
        let level = |at: [f64; 2]| {
            let cell = at.map(f64::floor);
            let inside = |x: f64| (0.0..SIDE as f64).contains(&x);
            (inside(cell[0]) && inside(cell[1])).then(|| {
                let bits = sheet.modules[cell[1] as usize];
                levels[usize::from(bits >> cell[0] as usize & 1)]
            })
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
                *pixel = level(at).unwrap_or(*pixel);
                continue;
            }
            let [count, step] = LATTICE;
            let offset = |k: usize| (k as f64 + 0.5) / count as f64 - 0.5;
            let sum: f32 = (0..count)
                .map(|k| {
                    let sample = modules(u as f64 + offset(k), v + offset(k * step % count));
                    sample.and_then(level).unwrap_or(*pixel)
                })
                .sum();
            *pixel = sum / count as f32;
        }
    }

    /// Box and table, textured and lit from the left.
    fn draw_ground(&self, line: &mut [f32], row: usize, map: &Homography, texture: &Texture) {
        let Some(back) = map.inverse() else {
            line.fill(self.look.table_level as f32);
            return;
        };
        let at = |u: f64| back.apply([u, row as f64]);
        let (box_level, table_level) = (self.look.box_level as f32, self.look.table_level as f32);
        let amount = self.look.texture as f32;
        let outline = self.outline.map(|corner| corner.map(|x| x as f32));
        // Exact where spans meet, and linear between: only markers need more.
        let mut from = at(0.0);
        for (k, span) in line.chunks_mut(SPAN).enumerate() {
            let to = at((k * SPAN + SPAN) as f64);
            let (Some(first), Some(next)) = (from, to) else {
                // Beyond the horizon of the plane.
                span.fill(table_level);
                from = to;
                continue;
            };
            let step = [0, 1].map(|k| ((next[k] - first[k]) / SPAN as f64) as f32);
            let [mut x, mut y] = first.map(|x| x as f32);
            for level in span {
                let on_box = (x > outline[0][0] && x < outline[1][0])
                    && (y > outline[0][1] && y < outline[1][1]);
                let (base, amount) = if on_box {
                    (box_level, amount)
                } else {
                    (table_level, 1.5 * amount)
                };
                let grain = texture.at(x, y);
                *level = (1.0 - 0.5 * x.clamp(-0.3, 0.3)) * (base + amount * grain);
                x += step[0];
                y += step[1];
            }
            from = to;
        }
    }

    /// The pixels of a row that markers cover, wholly or in part.
    fn draw_markers(&self, line: &mut [f32], row: usize, map: &Homography) {
        let radius = self.look.marker_radius_m;
        let (Some(back), width) = (map.inverse(), line.len()) else {
            return;
        };
        for &center in &self.pattern {
            let Some(ellipse) = map.disc(center, radius) else {
                continue;
            };
            let v = row as f64;
            if (v - ellipse.center[1]).abs() > ellipse.half[1] + 1.0 {
                continue;
            }
            let (mid, half) = (ellipse.center[0], ellipse.half[0] + 1.0);
            let from = (mid - half).ceil().clamp(0.0, width as f64) as usize;
            let to = (mid + half + 1.0).floor().clamp(0.0, width as f64) as usize;
            // Half a pixel's diagonal on the plane, generously: pixels farther from the rim need no
            // samples.
            let reach = 1.2 * radius / ellipse.half[0].min(ellipse.half[1]).max(1e-3);
            for u in from..to {
                let square = |du: f64, dv: f64| {
                    back.apply([u as f64 + du, v + dv])
                        .map_or(f64::INFINITY, |p| {
                            (p[0] - center[0]).powi(2) + (p[1] - center[1]).powi(2)
                        })
                };
                let depth = square(0.0, 0.0).sqrt() - radius;
                let share = if depth.abs() > reach {
                    f64::from(depth < 0.0)
                } else {
                    let offset = |i: usize| (i as f64 + 0.5) / SAMPLES as f64 - 0.5;
                    let samples = (0..SAMPLES * SAMPLES).filter(|k| {
                        square(offset(k % SAMPLES), offset(k / SAMPLES)) < radius * radius
                    });
                    samples.count() as f64 / (SAMPLES * SAMPLES) as f64
                };
                let level = &mut line[u];
                let light = 1.0 - 0.5 * center[0].clamp(-0.3, 0.3);
                *level += share as f32 * ((light * self.look.marker_level) as f32 - *level);
            }
        }
    }
}
