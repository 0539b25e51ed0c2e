//! The picture: plane with tags, object, optics, spot, sensor, processor; in this order, as light
//! meets them.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use scene::{Camera, Pose, Scene};

use crate::brightness::Brightness;
use crate::defocus::Defocus;
use crate::gloss::eye;
use crate::homography::{Homography, Point};
use crate::image::Image;
use crate::lens::{Lens, Rays};
use crate::look::Look;
use crate::object::Object;
use crate::optics::Optics;
use crate::plane::Plane;
use crate::processor::Processor;
use crate::sensor::Sensor;
use crate::spot::Spot;
use crate::tag::Tag;
use crate::texture::Texture;

/// An occlusion, ready to be drawn.
#[derive(Clone, Debug)]
enum Layer {
    Object(Object),
    Spot(Spot),
}

/// Draws frames of a scene.
#[derive(Clone, Debug)]
pub struct Renderer {
    camera: Camera,
    texture: Texture,
    plane: Plane,
    layers: Vec<(Layer, bool)>,
    lens: Lens,
    rays: Rays,
    /// The box of what the image shows, px of the pinhole.
    seen: [Point; 2],
    defocus: Option<Defocus>,
    optics: Optics,
    brightness: Brightness,
    sensor: Sensor,
    processor: Option<Processor>,
    levels: Vec<f32>,
    image: Image,
}

impl Renderer {
    /// A renderer of a scene with a tag at each point of its pattern, number i at point i, as large
    /// as the scene's markers; none where these have no size. An occlusion on the lens blurs and
    /// dims what lies behind; every other one is an object before the camera, which hides it.
    pub fn new(scene: &Scene, look: &Look) -> Self {
        let tags = match scene.marker_size > 0.0 {
            true => Tag::of_pattern(scene, look.family.black_share() * scene.marker_size),
            false => Vec::new(),
        };
        Self::with_tags(scene, look, &tags)
    }

    /// A renderer of a scene with these tags on the plane z = 0 of its object instead: a board, for
    /// example.
    pub fn with_tags(scene: &Scene, look: &Look, tags: &[Tag]) -> Self {
        let (width, height) = (scene.camera.width as usize, scene.camera.height as usize);
        let mut random = ChaCha8Rng::seed_from_u64(look.seed);
        let texture = Texture::new(&mut random);
        let lens = Lens::new(&scene.camera, look.distortion);
        let rays = Rays::new(&lens, width, height);
        let layers = scene
            .occlusions
            .iter()
            .map(|occlusion| match occlusion.on_lens {
                true => Layer::Spot(Spot::new(occlusion, &lens, look.spot, width, height)),
                false => {
                    Layer::Object(Object::new(occlusion, &lens, look, &texture, width, height))
                }
            })
            .map(|layer| (layer, true))
            .collect();
        Self {
            camera: scene.camera,
            texture,
            plane: Plane::new(look, tags),
            layers,
            lens,
            seen: rays.bounds(),
            rays,
            defocus: Defocus::new(look.defocus_px, width, height),
            optics: Optics::new(&scene.camera, look.vignette),
            brightness: Brightness::new(look.gain, look.seed),
            sensor: Sensor::new(look.noise, random),
            processor: Processor::new(look, width, height),
            levels: vec![0.0; width * height],
            image: Image::new(width, height),
        }
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
        self.render_moving(&[*first, *last], &[*first; 2])
    }

    /// Draws a frame of a camera that moves: the poses in the middle of the exposure of the first
    /// and of the last row, and those at the begin and at the end of the exposure of any row, whose
    /// difference blurs the tags.
    pub fn render_moving(&mut self, rows: &[Pose; 2], exposure: &[Pose; 2]) -> &Image {
        let eyes = rows.each_ref().map(eye);
        let map = |pose: &Pose| Homography::of_pose(&self.camera, pose);
        let (rows, exposure) = (rows.each_ref().map(map), exposure.each_ref().map(map));
        let way = (exposure[1].0 - exposure[0].0) * 0.5;
        let ends = |map: Homography| [Homography(map.0 - way), Homography(map.0 + way)];
        let (width, height) = (self.image.width(), self.image.height());
        let all = rows.map(ends);
        self.plane
            .aim(all.as_flattened(), &self.lens, self.seen, [width, height]);
        for row in 0..height {
            let share = row as f64 / (height - 1) as f64;
            let maps = ends(rows[0].between(&rows[1], share));
            let eye = eyes[0].lerp(&eyes[1], share);
            let line = &mut self.levels[row * width..(row + 1) * width];
            self.plane
                .draw(line, row, &maps, &eye, &self.rays, &self.texture);
        }
        for (layer, shown) in &self.layers {
            if let (Layer::Object(object), true) = (layer, shown) {
                object.cover(&mut self.levels, width);
            }
        }
        if let Some(defocus) = &mut self.defocus {
            defocus.blur(&mut self.levels);
        }
        self.optics.spread(&mut self.levels);
        for (layer, shown) in &mut self.layers {
            if let (Layer::Spot(spot), true) = (layer, shown) {
                spot.cover(&mut self.levels, width);
            }
        }
        let brightness = self.brightness.next();
        self.sensor.expose(&mut self.levels, width, brightness);
        if let Some(processor) = &mut self.processor {
            processor.process(&mut self.levels);
        }
        for (pixel, level) in self.image.pixels_mut().iter_mut().zip(&self.levels) {
            // The cast saturates.
            *pixel = (level + 0.5) as u8;
        }
        &self.image
    }

    /// The image that was drawn last.
    pub fn image(&self) -> &Image {
        &self.image
    }
}

#[cfg(test)]
mod tests {
    use markers::Family;

    use super::*;

    fn robot() -> Scene {
        Scene::parse(scene::TAGS_ROBOT, "robot").unwrap()
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
            let mut renderer = Renderer::new(&robot(), &look);
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
            .render(&robot().goal)
            .clone();
        let noisy = Renderer::new(&robot(), &look).render(&robot().goal).clone();
        let square: f64 = quiet
            .pixels()
            .iter()
            .zip(noisy.pixels())
            .map(|(a, b)| (f64::from(*a) - f64::from(*b)).powi(2))
            .sum();
        let deviation = (square / quiet.pixels().len() as f64).sqrt();
        assert!((deviation - 3.0).abs() < 0.15, "{deviation}");
    }

    /// The brightest level within 10 px of where the centre of tag `i` is seen.
    fn brightest(image: &Image, pose: &Pose, i: usize) -> u8 {
        let center = crate::truth(&robot(), pose, 0.03, |_| true)[i].pixel;
        let [u, v] = center.map(|x| x as usize - 10);
        let near = (0..21 * 21).map(|k| image.at(u + k % 21, v + k / 21));
        near.max().unwrap()
    }

    #[test]
    fn the_object_hides_markers_until_it_is_taken_away() {
        let mut pose = robot().goal;
        pose.translation[1] += 0.09;
        let mut renderer = Renderer::new(&robot(), &plain());
        assert!(brightest(renderer.render(&pose), &pose, 3) < 60);
        renderer.show(1, false);
        assert!(brightest(renderer.render(&pose), &pose, 3) > 200);
    }

    #[test]
    fn a_rolling_shutter_shears_what_moves_across() {
        let aside = |share: f64| {
            let mut pose = robot().goal;
            pose.translation[0] += 0.35 * 48.0 / 615.0 * share;
            pose
        };
        let mut renderer = Renderer::new(&robot(), &plain());
        let image = renderer.render_rolling(&aside(0.0), &aside(1.0)).clone();
        let still = renderer.render(&aside(143.0 / 479.0));
        let row = |image: &Image| image.pixels()[143 * 640..144 * 640].to_vec();
        // Its neighbours, which the point spread mixes in, lie 0.1 px aside.
        let off = row(&image).into_iter().zip(row(still));
        assert!(
            off.clone().all(|(a, b)| a.abs_diff(b) < 10),
            "{:?}",
            off.max_by_key(|(a, b)| a.abs_diff(*b))
        );
    }

    #[test]
    fn a_plane_behind_the_camera_is_no_trouble() {
        let mut renderer = Renderer::new(&robot(), &plain());
        for z in [-0.3, 0.0, 1e-12] {
            let mut pose = robot().goal;
            pose.translation[2] = z;
            let image = renderer.render(&pose);
            assert!(image.pixels().iter().all(|level| *level < 130));
        }
    }

    #[test]
    fn painted_objects_hide_markers_and_painted_spots_blur_them() {
        use crate::painted::tests::masked;
        let (free, goal) = (masked(|i, j| i < 2 && j < 2), robot().goal);
        let [u, v] = crate::truth(&free, &goal, 0.006, |_| true)[0]
            .pixel
            .map(f64::round);
        // To the middle of the white border, which is 21 to 26 px from the centre.
        let (left, top) = (u as u32 - 24, v as u32 - 24);
        let square =
            |i: u32, j: u32| (left..left + 49).contains(&i) && (top..top + 49).contains(&j);
        let draw = |scene: &Scene| {
            let mut renderer = Renderer::new(scene, &plain());
            renderer.render(&goal).clone()
        };
        let before = draw(&free);
        let [column, row] = [left, top].map(|x| x as usize);
        // Levels within 10 px of the centre.
        let contrast = |image: &Image| {
            let near = (0..21 * 21).map(|k| image.at(column + 14 + k % 21, row + 14 + k / 21));
            near.clone().max().unwrap() - near.min().unwrap()
        };
        assert!(contrast(&before) > 150);
        for name in ["object", "spot"] {
            let mut scene = masked(square);
            scene.occlusions[0].on_lens = name == "spot";
            assert!(crate::truth(&scene, &goal, 0.006, |_| true)[0].occluded);
            let image = draw(&scene);
            assert!(contrast(&image) < 40, "{name}: {}", contrast(&image));
            // The point spread reaches one pixel; a pixel is the square about its whole-numbered
            // centre.
            for (i, j) in [
                (column - 2, row + 24),
                (column + 50, row + 24),
                (column + 24, row - 2),
            ] {
                assert_eq!(image.at(i, j), before.at(i, j), "{name}: ({i}, {j})");
            }
        }
        let opaque = draw(&masked(square));
        assert!(opaque.at(column, row + 24) < 100 && before.at(column, row + 24) > 120);
    }

    #[test]
    fn a_tag_between_pixels_is_drawn_to_a_hundredth_of_a_pixel() {
        let mut scene = robot();
        scene.occlusions.clear();
        let size = 0.024;
        for (number, [du, dv]) in [(0, [0.0, 0.0]), (7, [0.23, 0.41]), (35, [0.5, -0.37])] {
            let tag = crate::Tag {
                number,
                center: [0.0; 2],
                size,
            };
            let look = Look {
                table_level: 215.0,
                box_level: 215.0,
                ..plain()
            };
            let mut renderer = Renderer::with_tags(&scene, &look, &[tag]);
            let mut pose = scene.goal;
            let depth = 0.35;
            pose.translation = [du * depth / 615.0, dv * depth / 615.0, depth];
            let image = renderer.render(&pose).clone();
            // The first moment of what is dark, against that of the black modules.
            let (mut sum, mut sums) = (0.0, [0.0; 2]);
            for (k, level) in image.pixels().iter().enumerate() {
                let at = [(k % 640) as f64, (k / 640) as f64];
                // The white border ends 26 px from the centre.
                if (at[0] - 320.0).abs().max((at[1] - 240.0).abs()) > 24.0 {
                    continue;
                }
                let dark = 215.0 - f64::from(*level);
                sum += dark;
                sums = [sums[0] + dark * at[0], sums[1] + dark * at[1]];
            }
            let (mut count, mut cells) = (0.0, [0.0; 2]);
            for (row, bits) in tag.rows(Family::default()).iter().enumerate() {
                for column in (0..10).filter(|column| bits >> column & 1 == 0) {
                    count += 1.0;
                    cells = [
                        cells[0] + f64::from(column) - 4.5,
                        cells[1] + row as f64 - 4.5,
                    ];
                }
            }
            let module = tag.module(Family::default()) * 615.0 / depth;
            let black = 215.0 - look.black_level;
            let area = sum / (black * count * module * module);
            assert!((area - 1.0).abs() < 2e-3, "{area}");
            for (k, middle) in [320.0 + du, 240.0 + dv].into_iter().enumerate() {
                let expected = middle + module * cells[k] / count;
                let off = sums[k] / sum - expected;
                assert!(off.abs() < 0.01, "tag {number}, axis {k}: {off}");
            }
        }
    }

    fn flawed(look: Look, pose: &Pose) -> Image {
        Renderer::new(&robot(), &look).render(pose).clone()
    }

    /// Area (px^2) and centroid (px) of the black modules of a tag as a lens shows them.
    fn black(scene: &Scene, lens: &Lens, pose: &Pose, tag: &Tag) -> (f64, Point) {
        /// Pieces along a side of a module.
        const PIECES: usize = 6;
        let map = Homography::of_pose(&scene.camera, pose);
        let step = tag.module(Family::default()) / PIECES as f64;
        let [left, top] = tag.rim(Family::default())[0];
        let seen = |a: usize, b: usize| {
            let at = [left + a as f64 * step, top + b as f64 * step];
            lens.distort(map.apply(at).unwrap())
        };
        let (mut area, mut sums) = (0.0, [0.0; 2]);
        for (row, bits) in tag.rows(Family::default()).iter().enumerate() {
            for column in (0..10).filter(|column| bits >> column & 1 == 0) {
                for piece in 0..PIECES * PIECES {
                    let (a, b) = (
                        column * PIECES + piece % PIECES,
                        row * PIECES + piece / PIECES,
                    );
                    let corners = [
                        seen(a, b),
                        seen(a + 1, b),
                        seen(a + 1, b + 1),
                        seen(a, b + 1),
                    ];
                    let side = |i: usize, j: usize| [0, 1].map(|k| corners[j][k] - corners[i][k]);
                    let (across, down) = (side(0, 2), side(1, 3));
                    let size = 0.5 * (across[0] * down[1] - across[1] * down[0]);
                    area += size;
                    for k in 0..2 {
                        sums[k] += size * corners.iter().map(|corner| corner[k]).sum::<f64>() / 4.0;
                    }
                }
            }
        }
        (area, sums.map(|sum| sum / area))
    }

    #[test]
    fn a_tag_in_a_distorted_picture_is_where_the_lens_shows_it() {
        let mut scene = robot();
        scene.occlusions.clear();
        let tag = Tag {
            number: 11,
            center: [0.0; 2],
            size: 0.024,
        };
        let look = Look {
            table_level: 215.0,
            box_level: 215.0,
            distortion: [-0.28, 0.09, 0.002, -0.001, 0.0],
            ..plain()
        };
        let lens = Lens::new(&scene.camera, look.distortion);
        let mut renderer = Renderer::with_tags(&scene, &look, &[tag]);
        for at in [[0.0, 0.0], [0.14, 0.1], [-0.15, -0.11], [0.15, -0.02]] {
            let mut pose = scene.goal;
            pose.translation = [at[0], at[1], 0.35];
            pose.rotation = [0.2, -0.1, 0.4];
            let image = renderer.render(&pose).clone();
            let (area, center) = black(&scene, &lens, &pose, &tag);
            let back = Homography::of_pose(&scene.camera, &pose).inverse().unwrap();
            let (mut sum, mut sums) = (0.0, [0.0; 2]);
            for (k, level) in image.pixels().iter().enumerate() {
                let pixel = [(k % 640) as f64, (k / 640) as f64];
                // Within the white border.
                let at = back.apply(lens.undistort(pixel).unwrap()).unwrap();
                if at[0].abs().max(at[1].abs()) > 4.6 * tag.module(Family::default()) {
                    continue;
                }
                let dark = 215.0 - f64::from(*level);
                sum += dark;
                sums = [0, 1].map(|j| sums[j] + dark * pixel[j]);
            }
            let found = sums.map(|x| x / sum);
            let apart = (found[0] - center[0]).hypot(found[1] - center[1]);
            assert!(apart < 0.02, "{at:?}: {found:?} {center:?}");
            assert!((sum / (193.0 * area) - 1.0).abs() < 0.01, "{at:?}");
        }
    }

    #[test]
    fn motion_blurs_tags_as_the_mean_of_many_instants() {
        let pose = |share: f64| {
            let mut pose = robot().goal;
            pose.translation[0] += 0.004 * share;
            pose.translation[1] -= 0.002 * share;
            pose.rotation = [0.0, 0.01 * share, 0.02 * share];
            pose
        };
        let mut renderer = Renderer::new(&robot(), &plain());
        let ends = [pose(-0.5), pose(0.5)];
        let blurred = renderer.render_moving(&[pose(0.0); 2], &ends).clone();
        let mut sums = vec![0u32; 640 * 480];
        const INSTANTS: u32 = 200;
        for k in 0..INSTANTS {
            let share = (f64::from(k) + 0.5) / f64::from(INSTANTS) - 0.5;
            let image = renderer.render(&pose(share));
            for (sum, level) in sums.iter_mut().zip(image.pixels()) {
                *sum += u32::from(*level);
            }
        }
        let sharp = renderer.render(&pose(0.0)).clone();
        // On the first tag and round it, away from the edge of the box, which is not blurred.
        let [u, v] = crate::truth(&robot(), &pose(0.0), 0.03, |_| true)[0].pixel;
        let (mut worst, mut squares, mut sharper) = (0.0f64, 0.0, 0.0f64);
        for k in 0..61 * 61 {
            let at = [u as usize - 30 + k % 61, v as usize - 30 + k / 61];
            let mean = f64::from(sums[at[1] * 640 + at[0]]) / f64::from(INSTANTS);
            let off = f64::from(blurred.at(at[0], at[1])) - mean;
            (worst, squares) = (worst.max(off.abs()), squares + off * off);
            sharper = sharper.max((f64::from(sharp.at(at[0], at[1])) - mean).abs());
        }
        let rms = (squares / 3721.0).sqrt();
        assert!(worst < 12.0 && rms < 2.0, "{worst} {rms}");
        assert!(sharper > 60.0, "{sharper}");
    }

    #[test]
    fn a_picture_out_of_focus_has_less_contrast_and_as_much_light() {
        let goal = robot().goal;
        let [sharp, blurred] = [0.0, 3.0].map(|defocus_px| {
            flawed(
                Look {
                    defocus_px,
                    ..plain()
                },
                &goal,
            )
        });
        let sum = |image: &Image| image.pixels().iter().map(|x| f64::from(*x)).sum::<f64>();
        assert!((sum(&blurred) / sum(&sharp) - 1.0).abs() < 2e-3);
        let steepest = |image: &Image| {
            let pairs = image.pixels().windows(2);
            pairs.map(|pair| pair[0].abs_diff(pair[1])).max().unwrap()
        };
        assert!(steepest(&blurred) < steepest(&sharp) / 3);
    }

    #[test]
    fn brightness_changes_from_frame_to_frame_and_ends_at_255() {
        let look = Look {
            gain: 0.9,
            ..plain()
        };
        let mut renderer = Renderer::new(&robot(), &look);
        let [mut least, mut most] = [f64::INFINITY, 0.0f64];
        for _ in 0..300 {
            let pixels = renderer.render(&robot().goal).pixels();
            let mean = pixels.iter().map(|x| f64::from(*x)).sum::<f64>() / 307_200.0;
            (least, most) = (least.min(mean), most.max(mean));
            // Brighter than white on the table: the tags' white is clipped, not wrapped.
            let white = pixels.iter().filter(|x| **x == 255).count();
            assert!(mean < 90.0 || white > 1000, "{mean} {white}");
        }
        assert!(most > 1.8 * least, "{least} {most}");
    }

    #[test]
    fn glossy_tags_mirror_a_light_as_the_camera_stands_to_it() {
        use crate::gloss::Gloss;
        let mut scene = robot();
        scene.occlusions.clear();
        // A tag that fills the picture.
        let tag = Tag {
            number: 3,
            center: [0.0; 2],
            size: 0.6,
        };
        let glossy = Look {
            gloss: 30.0,
            ..plain()
        };
        let gloss = Gloss::new(&glossy).unwrap();
        let mut pose = scene.goal;
        for x in [0.0, 0.05] {
            pose.translation[0] = x;
            let [dull, bright] = [plain(), glossy].map(|look| {
                let mut renderer = Renderer::with_tags(&scene, &look, &[tag]);
                renderer.render(&pose).clone()
            });
            let back = Homography::of_pose(&scene.camera, &pose).inverse().unwrap();
            let (mut least, mut most) = (f64::INFINITY, 0.0f64);
            for at in (0..640 * 480).step_by(997) {
                let [u, v] = [at % 640, at / 640];
                let point = back.apply([u as f64, v as f64]).unwrap();
                let expected = f64::from(gloss.at(point, &eye(&pose)));
                let found = f64::from(bright.at(u, v)) - f64::from(dull.at(u, v));
                assert!(
                    (found - expected).abs() < 1.5,
                    "({u}, {v}): {found}, {expected}"
                );
                (least, most) = (least.min(found), most.max(found));
            }
            assert!(least == 0.0 && most > 25.0, "{least} {most}");
        }
    }

    #[test]
    fn the_processor_sharpens_what_the_sensor_read_with_its_noise() {
        let mut scene = robot();
        scene.occlusions.clear();
        let [soft, sharp] = [0.0, 1.0].map(|sharpening| {
            let [quiet, noisy] = [0.0, 5.0].map(|noise| {
                let look = Look {
                    noise,
                    sharpening,
                    ..plain()
                };
                let mut renderer = Renderer::with_tags(&scene, &look, &[]);
                renderer.render(&scene.goal).clone()
            });
            let pairs = quiet.pixels().iter().zip(noisy.pixels());
            let squares = pairs.map(|(a, b)| (f64::from(*a) - f64::from(*b)).powi(2));
            (squares.sum::<f64>() / 307_200.0).sqrt()
        });
        // White noise less its blur: the gain is 2 at itself, less the Gaussian's own share.
        assert!((sharp / soft - 1.86).abs() < 0.06, "{soft} {sharp}");
    }

    #[test]
    fn clutter_is_drawn_beside_the_box_and_changes_nothing_else() {
        let mut far = robot().goal;
        far.translation[2] = 0.55;
        let without = flawed(plain(), &far);
        let with = flawed(
            Look {
                clutter: 6,
                ..plain()
            },
            &far,
        );
        let changed = |k: &usize| without.pixels()[*k] != with.pixels()[*k];
        let count = (0..640 * 480).filter(changed).count();
        // Six tags of 34 px, some of them under the object or outside.
        assert!((2000..9000).contains(&count), "{count}");
        for truth in crate::truth(&robot(), &far, 0.03, |_| true) {
            let [u, v] = truth.pixel.map(|x| x as usize);
            assert!((0..400).all(|k| !changed(&((v - 10 + k / 20) * 640 + u - 10 + k % 20))));
        }
    }
}
