//! The picture: plane with markers, object, optics, spot, noise; in this order, as light meets
//! them.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use scene::{Camera, Pose, Scene};

use crate::homography::Homography;
use crate::image::{Image, ImageError};
use crate::layer::{Area, coverage, relief};
use crate::look::{Kind, Look};
use crate::optics::Optics;
use crate::plane::Plane;
use crate::sensor::Sensor;
use crate::spot::Spot;
use crate::texture::Texture;

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
    texture: Texture,
    plane: Plane,
    layers: Vec<(Layer, bool)>,
    optics: Optics,
    sensor: Sensor,
    levels: Vec<f32>,
    image: Image,
}

impl Renderer {
    /// A renderer of a scene. An occlusion whose name has the word "spot" is dirt on the lens,
    /// which blurs and dims what lies behind; every other one is an object before the camera, which
    /// hides it.
    ///
    /// # Errors
    /// [`ImageError`] if the size of the scene's image is out of range.
    pub fn new(scene: &Scene, look: &Look) -> Result<Self, ImageError> {
        let (width, height) = (scene.camera.width as usize, scene.camera.height as usize);
        let image = Image::new(width, height)?;
        let mut random = ChaCha8Rng::seed_from_u64(look.seed);
        let texture = Texture::new(&mut random);
        let layers = scene
            .occlusions
            .iter()
            .map(|occlusion| match Kind::by_name(occlusion) {
                Kind::Spot => Layer::Spot(Spot::new(occlusion, look.spot, width, height)),
                Kind::Opaque => {
                    let area = Area::around(occlusion, 1.0, width, height);
                    let mut light = relief(occlusion, area);
                    for (i, x) in light.iter_mut().enumerate() {
                        let (u, v) = (area.column + i % area.width, area.row + i / area.width);
                        // Brushed along u.
                        let grain = texture.texel(u / 5, v * 5);
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
        Ok(Self {
            camera: scene.camera,
            texture,
            plane: Plane::new(scene, look),
            layers,
            optics: Optics::new(&scene.camera, look.vignette),
            sensor: Sensor::new(look.noise, random),
            levels: vec![0.0; width * height],
            image,
        })
    }

    /// Shows or takes away an occlusion, by its index in the scene: the object that the gripper
    /// lets go. An index that the scene has not does nothing.
    pub fn show(&mut self, occlusion: usize, shown: bool) {
        if let Some(layer) = self.layers.get_mut(occlusion) {
            layer.1 = shown;
        }
    }

    /// Draws the object at a pose in the camera frame.
    pub fn render(&mut self, pose: &Pose) -> &Image {
        self.render_rolling(pose, pose)
    }

    /// Draws a frame of a rolling shutter: the poses while the first and the last row are exposed.
    pub fn render_rolling(&mut self, first: &Pose, last: &Pose) -> &Image {
        let maps = [first, last].map(|pose| Homography::of_pose(&self.camera, pose));
        let (width, height) = (self.image.width(), self.image.height());
        for row in 0..height {
            let share = row as f64 / (height - 1) as f64;
            let map = maps[0].between(&maps[1], share);
            let line = &mut self.levels[row * width..(row + 1) * width];
            self.plane.draw(line, row, &map, &self.texture);
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
        self.optics.spread(&mut self.levels);
        for (layer, shown) in &mut self.layers {
            if let (Layer::Spot(spot), true) = (layer, shown) {
                spot.cover(&mut self.levels, width);
            }
        }
        self.sensor.expose(&self.levels, &mut self.image);
        &self.image
    }

    /// The image that was drawn last.
    pub fn image(&self) -> &Image {
        &self.image
    }
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
    fn a_painted_object_hides_markers_and_a_painted_spot_blurs_them_and_beside_them_nothing_changes()
     {
        use crate::painted::tests::masked;
        let (free, goal) = (masked("painted", |i, j| i < 2 && j < 2), robot().goal);
        let [u, v] = crate::truth(&free, &goal, 0.006, |_| true)[0]
            .pixel
            .map(f64::round);
        let (left, top) = (u as u32 - 20, v as u32 - 20);
        let square =
            |i: u32, j: u32| (left..left + 41).contains(&i) && (top..top + 41).contains(&j);
        let draw = |scene: &Scene| {
            let mut renderer = Renderer::new(scene, &plain()).unwrap();
            renderer.render(&goal).clone()
        };
        let before = draw(&free);
        assert!(before.at(u as usize, v as usize) > 180);
        let [column, row] = [left, top].map(|x| x as usize);
        for (name, most) in [("painted object", 60), ("painted spot", 130)] {
            let scene = masked(name, square);
            assert!(crate::truth(&scene, &goal, 0.006, |_| true)[0].occluded);
            let image = draw(&scene);
            let level = image.at(u as usize, v as usize);
            assert!(level < most, "{name}: {level}");
            // The point spread reaches one pixel; a pixel is the square about its whole-numbered
            // centre.
            for (i, j) in [
                (column - 2, row + 20),
                (column + 42, row + 20),
                (column + 20, row - 2),
            ] {
                assert_eq!(image.at(i, j), before.at(i, j), "{name}: ({i}, {j})");
            }
            let mut detector = crate::Detector::new(&scene, &Default::default()).unwrap();
            detector.detect(&image).unwrap();
            assert_eq!(detector.visible(), 0b1110, "{name}");
        }
        let opaque = draw(&masked("painted object", square));
        assert!(opaque.at(column, row + 20) < before.at(column, row + 20) - 10);
    }

    #[test]
    fn a_marker_is_drawn_where_its_projection_says_with_pixels_about_whole_numbers() {
        let mut renderer = Renderer::new(&robot(), &plain()).unwrap();
        let image = renderer.render(&robot().goal).clone();
        let [u, v] = crate::truth(&robot(), &robot().goal, 0.006, |_| true)[0].pixel;
        let (mut sum, mut sums) = (0.0, [0.0; 2]);
        let background = f64::from(image.at(u as usize - 16, v as usize));
        for j in v as usize - 16..v as usize + 17 {
            for i in u as usize - 16..u as usize + 17 {
                let weight = (f64::from(image.at(i, j)) - background).max(0.0);
                // Shading of the box.
                let weight = if weight < 8.0 { 0.0 } else { weight };
                sum += weight;
                sums = [sums[0] + weight * i as f64, sums[1] + weight * j as f64];
            }
        }
        let centroid = sums.map(|x| x / sum);
        let apart = (centroid[0] - u).hypot(centroid[1] - v);
        assert!(apart < 0.05, "{centroid:?}, ({u}, {v})");
    }
}
