//! The picture: plane with markers, object, optics, spot, noise; in this order, as light meets them.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use scene::{Camera, MAX_POINTS, Pose, Scene};

use crate::homography::{Homography, Point};
use crate::image::Image;
use crate::layer::{Area, coverage, relief};
use crate::look::{Kind, Look, LookError};
use crate::spot::Spot;

/// Side of the tile of texture, texels; it repeats.
const TILE: usize = 256;
/// Size of a texel on the plane, m.
const TEXEL: f32 = 0.0006;
/// Pixels of a row over which the plane is taken to be linear.
const SPAN: usize = 16;
/// Texels, row by row.
type Tile = [f32; TILE * TILE];
/// Numbers of noise drawn once; each row of each frame reads them from another place.
const NOISE: usize = 1 << 16;
/// Samples along a side of a pixel that a marker's rim crosses.
const SAMPLES: usize = 8;
/// The box is larger than the pattern by this many radii of a marker on each side.
const MARGIN: f64 = 4.0;

/// An occlusion, ready to be drawn.
#[derive(Clone, Debug)]
enum Layer {
    Opaque {
        area: Area,
        coverage: Vec<f32>,
        light: Vec<f32>,
    },
    Spot(Spot),
}

/// Draws frames of a scene. Takes all its memory in `new`; drawing allocates nothing.
#[derive(Clone, Debug)]
pub struct Renderer {
    camera: Camera,
    pattern: heapless::Vec<Point, MAX_POINTS>,
    /// Corner of the box that is least and that is greatest in x and y, m.
    outline: [Point; 2],
    look: Look,
    layers: Vec<(Layer, bool)>,
    texture: Vec<f32>,
    vignette: Vec<f32>,
    noise: Vec<f32>,
    random: ChaCha8Rng,
    levels: Vec<f32>,
    lines: [Vec<f32>; 3],
    image: Image,
}

impl Renderer {
    /// A renderer in which occlusions are what their names say ([`Kind::by_name`]).
    ///
    /// # Errors
    /// [`LookError`] where a value of the look or the size of the scene's image is out of range.
    pub fn new(scene: &Scene, look: &Look) -> Result<Self, LookError> {
        let kinds: heapless::Vec<Kind, { scene::MAX_OCCLUSIONS }> =
            scene.occlusions.iter().map(Kind::by_name).collect();
        Self::with_kinds(scene, look, &kinds)
    }

    /// A renderer in which the caller says what each occlusion is, in the order of the scene.
    ///
    /// # Errors
    /// [`LookError`], also where there is not one kind for each occlusion.
    pub fn with_kinds(scene: &Scene, look: &Look, kinds: &[Kind]) -> Result<Self, LookError> {
        look.check()?;
        if kinds.len() != scene.occlusions.len() {
            return Err(LookError::Kinds {
                found: kinds.len(),
                expected: scene.occlusions.len(),
            });
        }
        let (width, height) = (scene.camera.width as usize, scene.camera.height as usize);
        let image = Image::new(width, height)?;
        let mut random = ChaCha8Rng::seed_from_u64(look.seed);
        let texture = texture(&mut random);
        let noise = (0..NOISE).map(|_| normal(&mut random)).collect();
        let layers = scene
            .occlusions
            .iter()
            .zip(kinds)
            .map(|(occlusion, kind)| match kind {
                Kind::Spot => Layer::Spot(Spot::new(occlusion, look.spot, width, height)),
                Kind::Opaque => {
                    let area = Area::around(occlusion, 1.0, width, height);
                    let mut light = relief(occlusion, area);
                    for (i, x) in light.iter_mut().enumerate() {
                        let (u, v) = (area.column + i % area.width, area.row + i / area.width);
                        // Brushed along u.
                        let grain = texture[(v * 5 % TILE) * TILE + (u / 5) % TILE];
                        let level = look.object_level as f32 * (0.55 + 0.6 * *x);
                        *x = level + 0.5 * look.texture as f32 * grain;
                    }
                    Layer::Opaque {
                        area,
                        coverage: coverage(occlusion, area),
                        light,
                    }
                }
            })
            .map(|layer| (layer, true))
            .collect();
        let vignette = |i: usize| {
            let (u, v) = ((i % width) as f64, (i / width) as f64);
            let (w, h) = (scene.camera.width, scene.camera.height);
            let square = ((u - 0.5 * w).powi(2) + (v - 0.5 * h).powi(2)) / (0.25 * (w * w + h * h));
            (1.0 - look.vignette * square) as f32
        };
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
        Ok(Self {
            camera: scene.camera,
            pattern,
            outline,
            look: *look,
            layers,
            texture,
            vignette: (0..width * height).map(vignette).collect(),
            noise,
            random,
            levels: vec![0.0; width * height],
            lines: [(); 3].map(|()| vec![0.0; width]),
            image,
        })
    }

    /// Shows or takes away an occlusion, by its index in the scene: the object that the gripper lets go.
    /// An index that the scene has not does nothing.
    pub fn show(&mut self, occlusion: usize, shown: bool) {
        if let Some(layer) = self.layers.get_mut(occlusion) {
            layer.1 = shown;
        }
    }

    /// Draws the object at a pose in the camera frame.
    pub fn render(&mut self, pose: &Pose) -> &Image {
        self.render_rolling(pose, pose)
    }

    /// Draws a frame of a rolling shutter: the poses while the first and the last row are exposed; see
    /// [`crate::Shutter::rows_ns`].
    pub fn render_rolling(&mut self, first: &Pose, last: &Pose) -> &Image {
        let maps = [first, last].map(|pose| Homography::of_pose(&self.camera, pose));
        let (width, height) = (self.image.width(), self.image.height());
        for row in 0..height {
            let share = row as f64 / (height - 1) as f64;
            let map = maps[0].between(&maps[1], share);
            self.draw_plane(row, &map);
            self.draw_markers(row, &map);
        }
        for (layer, shown) in &self.layers {
            if let (
                Layer::Opaque {
                    area,
                    coverage,
                    light,
                },
                true,
            ) = (layer, shown)
            {
                for (row, range) in area.rows(width) {
                    let inside = row * area.width..(row + 1) * area.width;
                    let layer = light[inside.clone()].iter().zip(&coverage[inside]);
                    for (level, (light, coverage)) in self.levels[range].iter_mut().zip(layer) {
                        *level += coverage * (light - *level);
                    }
                }
            }
        }
        self.spread();
        for (layer, shown) in &mut self.layers {
            if let (Layer::Spot(spot), true) = (layer, shown) {
                spot.cover(&mut self.levels, width);
            }
        }
        self.expose();
        &self.image
    }

    /// The image that was drawn last.
    pub fn image(&self) -> &Image {
        &self.image
    }

    /// A row of the plane: box and table, textured and lit from the left.
    fn draw_plane(&mut self, row: usize, map: &Homography) {
        let width = self.image.width();
        let line = &mut self.levels[row * width..(row + 1) * width];
        let Some(back) = map.inverse() else {
            line.fill(self.look.table_level as f32);
            return;
        };
        let Ok(tile) = <&Tile>::try_from(self.texture.as_slice()) else {
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
                let grain = sample(tile, x * (1.0 / TEXEL), y * (1.0 / TEXEL));
                *level = (1.0 - 0.5 * x.clamp(-0.3, 0.3)) * (base + amount * grain);
                x += step[0];
                y += step[1];
            }
            from = to;
        }
    }

    /// The pixels of a row that markers cover, wholly or in part.
    fn draw_markers(&mut self, row: usize, map: &Homography) {
        let radius = self.look.marker_radius_m;
        let (Some(back), width) = (map.inverse(), self.image.width()) else {
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
            // Half a pixel's diagonal on the plane, generously: pixels farther from the rim need no samples.
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
                let level = &mut self.levels[row * width + u];
                let light = 1.0 - 0.5 * center[0].clamp(-0.3, 0.3);
                *level += share as f32 * ((light * self.look.marker_level) as f32 - *level);
            }
        }
    }

    /// The optics: vignette, and a point spread of (1 2 1)/4 along u and v.
    fn spread(&mut self) {
        let (width, height) = (self.image.width(), self.image.height());
        let [above, here, below] = &mut self.lines;
        let blur = |levels: &[f32], vignette: &[f32], line: &mut Vec<f32>| {
            let mut lit = levels
                .iter()
                .zip(vignette)
                .map(|(level, share)| level * share);
            let mut here = lit.next().unwrap_or_default();
            let mut left = here;
            for (x, right) in line.iter_mut().zip(lit) {
                *x = 0.25 * (left + right) + 0.5 * here;
                (left, here) = (here, right);
            }
            line[width - 1] = 0.25 * left + 0.75 * here;
        };
        let row = |v: usize| v * width..(v + 1) * width;
        blur(&self.levels[row(0)], &self.vignette[row(0)], here);
        above.copy_from_slice(here);
        for v in 0..height {
            let next = row((v + 1).min(height - 1));
            if v + 1 < height {
                blur(&self.levels[next.clone()], &self.vignette[next], below);
            } else {
                below.copy_from_slice(here);
            }
            let lines = above.iter().zip(&*here).zip(&*below);
            for (level, ((a, h), b)) in self.levels[row(v)].iter_mut().zip(lines) {
                *level = 0.25 * (a + b) + 0.5 * h;
            }
            std::mem::swap(above, here);
            std::mem::swap(here, below);
        }
    }

    /// The sensor: noise and 8 bits.
    fn expose(&mut self) {
        let width = self.image.width();
        let amount = self.look.noise as f32;
        let rows = self.levels.chunks_exact(width);
        for (levels, pixels) in rows.zip(self.image.pixels_mut().chunks_exact_mut(width)) {
            let at = self.random.random::<u32>() as usize % NOISE;
            let noise = self.noise[at..].iter().chain(&self.noise).cycle();
            for ((level, noise), pixel) in levels.iter().zip(noise).zip(pixels) {
                // The cast saturates.
                *pixel = (level + amount * noise + 0.5) as u8;
            }
        }
    }
}

/// A number of the standard normal distribution (Box and Muller).
fn normal(random: &mut ChaCha8Rng) -> f32 {
    let (a, b) = (random.random::<f64>(), random.random::<f64>());
    ((-2.0 * (1.0 - a).ln()).sqrt() * (std::f64::consts::TAU * b).cos()) as f32
}

/// A tile of soft noise, about -1 to 1: grains of several sizes, each half as strong as the next larger one.
fn texture(random: &mut ChaCha8Rng) -> Vec<f32> {
    let mut tile = vec![0.0f32; TILE * TILE];
    for (cell, weight) in [(64, 0.5), (16, 0.35), (4, 0.25), (2, 0.15)] {
        let side = TILE / cell;
        let knots: Vec<f32> = (0..side * side)
            .map(|_| 2.0 * random.random::<f32>() - 1.0)
            .collect();
        for (i, x) in tile.iter_mut().enumerate() {
            let (u, v) = (i % TILE, i / TILE);
            let (a, b) = (
                (u % cell) as f32 / cell as f32,
                (v % cell) as f32 / cell as f32,
            );
            let ease = |t: f32| t * t * (3.0 - 2.0 * t);
            let knot =
                |p: usize, q: usize| knots[(v / cell + q) % side * side + (u / cell + p) % side];
            let (a, b) = (ease(a), ease(b));
            let upper = knot(0, 0) * (1.0 - a) + knot(1, 0) * a;
            let lower = knot(0, 1) * (1.0 - a) + knot(1, 1) * a;
            *x += weight * (upper * (1.0 - b) + lower * b);
        }
    }
    tile
}

/// The repeated tile between its texels, bilinear.
#[inline(always)]
fn sample(tile: &Tile, x: f32, y: f32) -> f32 {
    // Positive within 10 m of the pattern, so that the cast rounds down; farther away nobody looks.
    const FAR: f32 = (64 * TILE) as f32;
    let (x, y) = (x + FAR, y + FAR);
    let (column, row) = (x as i32, y as i32);
    let (a, b) = (x - column as f32, y - row as f32);
    let wrap = |i: i32| i as usize % TILE;
    let (u, v) = (wrap(column), wrap(row) * TILE);
    let (right, below) = (
        wrap(column.wrapping_add(1)),
        wrap(row.wrapping_add(1)) * TILE,
    );
    let upper = tile[v + u] * (1.0 - a) + tile[v + right] * a;
    let lower = tile[below + u] * (1.0 - a) + tile[below + right] * a;
    upper * (1.0 - b) + lower * b
}

#[cfg(test)]
mod tests {
    use super::*;

    fn robot() -> Scene {
        Scene::parse(scene::PAPER_ROBOT, "robot").unwrap()
    }

    fn plain() -> Look {
        Look {
            texture: 0.0,
            noise: 0.0,
            vignette: 0.0,
            ..Look::default()
        }
    }

    #[test]
    fn the_same_seed_gives_the_same_frames_and_another_seed_others() {
        let frames = |seed| {
            let look = Look {
                seed,
                ..Look::default()
            };
            let mut renderer = Renderer::new(&robot(), &look).unwrap();
            let first = renderer.render(&robot().goal).clone();
            (first, renderer.render(&robot().goal).clone())
        };
        assert_eq!(frames(1), frames(1));
        assert_ne!(frames(1).0, frames(2).0);
        // Noise is fresh in each frame.
        assert_ne!(frames(1).0, frames(1).1);
    }

    #[test]
    fn the_noise_has_the_size_asked_for() {
        let look = Look {
            noise: 3.0,
            ..plain()
        };
        let quiet = Renderer::new(&robot(), &plain())
            .unwrap()
            .render(&robot().goal)
            .clone();
        let noisy = Renderer::new(&robot(), &look)
            .unwrap()
            .render(&robot().goal)
            .clone();
        let square: f64 = quiet
            .pixels()
            .iter()
            .zip(noisy.pixels())
            .map(|(a, b)| (f64::from(*a) - f64::from(*b)).powi(2))
            .sum();
        let deviation = (square / quiet.pixels().len() as f64).sqrt();
        assert!((deviation - 3.0).abs() < 0.15, "{deviation}");
    }

    #[test]
    fn the_object_hides_markers_until_it_is_taken_away() {
        let mut pose = robot().goal;
        pose.translation[1] += 0.07;
        let mut renderer = Renderer::new(&robot(), &plain()).unwrap();
        let [u, v] = crate::truth(&robot(), &pose, 0.006, |_| true)[3].pixel;
        let level = |image: &Image| f64::from(image.at(u as usize, v as usize));
        assert!(level(renderer.render(&pose)) < 60.0);
        renderer.show(1, false);
        assert!(level(renderer.render(&pose)) > 200.0);
    }

    #[test]
    fn a_rolling_shutter_shears_what_moves_across() {
        let mut later = robot().goal;
        later.translation[0] += 0.35 * 48.0 / 615.0;
        let mut renderer = Renderer::new(&robot(), &plain()).unwrap();
        let image = renderer.render_rolling(&robot().goal, &later);
        // Rows near v = 143 are drawn 48 * 143 / 479 px farther right than at the start.
        let row = image.pixels()[143 * 640..144 * 640].iter().enumerate();
        let left: Vec<usize> = row
            .filter(|(u, level)| **level > 170 && *u < 320)
            .map(|(u, _)| u)
            .collect();
        let middle = left.iter().sum::<usize>() as f64 / left.len() as f64;
        let expected = 320.0 - 615.0 * 0.06 / 0.35 + 48.0 * 143.0 / 479.0;
        assert!((middle - expected).abs() < 1.0, "{middle}, {expected}");
    }

    #[test]
    fn a_plane_behind_the_camera_is_no_trouble() {
        let mut renderer = Renderer::new(&robot(), &plain()).unwrap();
        for z in [-0.3, 0.0, 1e-12] {
            let mut pose = robot().goal;
            pose.translation[2] = z;
            let image = renderer.render(&pose);
            assert!(image.pixels().iter().all(|level| *level < 130));
        }
    }

    #[test]
    fn kinds_must_fit_the_scene() {
        let message = Renderer::with_kinds(&robot(), &plain(), &[Kind::Spot])
            .unwrap_err()
            .to_string();
        assert_eq!(
            message,
            "look: 1 kinds of occlusion; allowed: 2, one for each of the scene's"
        );
    }
}
