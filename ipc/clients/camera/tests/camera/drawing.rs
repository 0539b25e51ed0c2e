//! Rendered frames whose truth is known.

use nalgebra::{Rotation3, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use scene::{Camera, Pose, Scene};
use vision::Tag;
use vpc_camera::grey::Grey;
use vpc_camera::lens::Lens;

pub type Point = [f64; 2];

/// The scene with tags, without what hides them.
pub fn open_scene() -> Scene {
    let mut scene = Scene::parse(scene::TAGS_ROBOT, "tags").unwrap();
    scene.occlusions.clear();
    scene
}

/// Where the scene's camera sees a point of the pattern's plane, px.
pub fn project(camera: &Camera, pose: &Pose, [x, y]: Point) -> Point {
    let turn = Rotation3::new(Vector3::from(pose.rotation));
    let at = turn * Vector3::new(x, y, 0.0) + Vector3::from(pose.translation);
    [
        camera.cx + camera.fx * at.x / at.z,
        camera.cy + camera.fy * at.y / at.z,
    ]
}

/// Where the points of the pattern are seen, px.
pub fn truth(scene: &Scene, pose: &Pose) -> Vec<Point> {
    let points = scene.pattern.iter();
    points
        .map(|p| project(&scene.camera, pose, [p[0], p[1]]))
        .collect()
}

/// Poses of the scene's region of starts from which every tag is at least `clear` px inside the
/// image.
pub fn poses(scene: &Scene, seed: u64, clear: f64) -> impl Iterator<Item = Pose> {
    let (scene, mut random) = (scene.clone(), ChaCha8Rng::seed_from_u64(seed));
    let starts = scene.starts;
    std::iter::repeat_with(move || {
        let mut between = |low: f64, high: f64| low + (high - low) * random.random::<f64>();
        let (low, high) = (starts.translation_min, starts.translation_max);
        Pose {
            translation: std::array::from_fn(|k| between(low[k], high[k])),
            rotation: [
                between(-starts.tilt_max, starts.tilt_max),
                between(-starts.tilt_max, starts.tilt_max),
                between(-starts.roll_max, starts.roll_max),
            ],
        }
    })
    .filter(move |pose| {
        let tags = Tag::of_pattern(&scene, scene.marker_size);
        let corners = tags.iter().flat_map(|tag| tag.corners());
        let inside = |x: f64, size: f64| (clear..size - 1.0 - clear).contains(&x);
        corners
            .map(|corner| project(&scene.camera, pose, corner))
            .all(|[u, v]| inside(u, scene.camera.width) && inside(v, scene.camera.height))
    })
}

pub fn grey(image: &vision::Image) -> Grey<'_> {
    Grey::new(image.pixels(), image.width(), image.height(), image.width()).unwrap()
}

/// The image as a lens shows it: each of its pixels looks up what the pinhole sees there.
pub fn through(lens: &Lens, camera: &Camera, image: &vision::Image) -> vision::Image {
    let (width, height) = (image.width(), image.height());
    let source = grey(image);
    let mut bent = vision::Image::new(width, height);
    for (n, pixel) in bent.pixels_mut().iter_mut().enumerate() {
        let at = [(n % width) as f64, (n / width) as f64];
        let level = lens.undistort(at, camera).and_then(|p| source.level(p));
        *pixel = (level.unwrap_or(0.0) + 0.5) as u8;
    }
    bent
}

/// The image smeared along a row or a column over so many pixels, an odd number.
pub fn smeared(image: &vision::Image, length: usize, is_down: bool) -> vision::Image {
    let (width, height) = (image.width(), image.height());
    let mut smeared = vision::Image::new(width, height);
    let half = length as i64 / 2;
    for (n, pixel) in smeared.pixels_mut().iter_mut().enumerate() {
        let (u, v) = ((n % width) as i64, (n / width) as i64);
        let at = |k: i64| {
            let (u, v) = if is_down { (u, v + k) } else { (u + k, v) };
            f64::from(image.at(u.max(0) as usize, v.max(0) as usize))
        };
        let sum: f64 = (-half..=half).map(at).sum();
        *pixel = (sum / length as f64 + 0.5) as u8;
    }
    smeared
}

/// Errors of points.
#[derive(Debug, Default)]
pub struct Errors {
    squares: f64,
    pub count: f64,
    pub worst: f64,
}

impl Errors {
    pub fn add(&mut self, found: Point, truth: Point) {
        let off = (found[0] - truth[0]).hypot(found[1] - truth[1]);
        self.squares += off * off;
        self.count += 1.0;
        self.worst = self.worst.max(off);
    }

    pub fn rms(&self) -> f64 {
        (self.squares / self.count).sqrt()
    }
}
