//! The plane of the pattern: table, box and the discs on it.

use scene::{MAX_POINTS, Scene};

use crate::homography::{Homography, Point};
use crate::look::Look;
use crate::texture::Texture;

/// Pixels of a row over which the plane is taken to be linear.
const SPAN: usize = 16;
/// Samples along a side of a pixel that a marker's rim crosses.
const SAMPLES: usize = 8;
/// The box is larger than the pattern by this many radii of a marker on each side.
const MARGIN: f64 = 4.0;

/// The plane with its markers.
#[derive(Clone, Debug)]
pub(crate) struct Plane {
    look: Look,
    pattern: heapless::Vec<Point, MAX_POINTS>,
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
            outline,
        }
    }

    /// Draws a row of the image, `line`, as seen by a map from the plane.
    pub fn draw(&self, line: &mut [f32], row: usize, map: &Homography, texture: &Texture) {
        self.draw_ground(line, row, map, texture);
        self.draw_markers(line, row, map);
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
