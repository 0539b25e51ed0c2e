//! Views of a board with known truth and noisy corners.

use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use rand_distr::{Distribution, Normal};
use tag_board::Board;
use vision_calibration_core::{Iso3, Vec3};
use vpc_calib::camera::Camera;
use vpc_calib::view::{Tag, View};

/// A camera with a lens that distorts: 8 px in the corners of the image.
pub const CAMERA: Camera = Camera {
    size: [640, 480],
    focal: [615.0, 612.0],
    center: [322.3, 236.8],
    distortion: [-0.28, 0.09, 0.0008, -0.0005, 0.0],
};

/// The camera of rendered images, whose lens does not distort.
pub const PINHOLE: Camera = Camera {
    distortion: [0.0; 5],
    ..CAMERA
};

/// A source of chance.
pub struct Chance {
    random: ChaCha8Rng,
}

impl Chance {
    pub fn new(seed: u64) -> Self {
        Self {
            random: ChaCha8Rng::seed_from_u64(seed),
        }
    }

    /// -1 to 1.
    pub fn unit(&mut self) -> f64 {
        self.random.random_range(-1.0..1.0)
    }

    /// Between two numbers.
    pub fn between(&mut self, least: f64, most: f64) -> f64 {
        self.random.random_range(least..most)
    }

    /// Normally distributed.
    pub fn normal(&mut self, deviation: f64) -> f64 {
        Normal::new(0.0, deviation)
            .unwrap()
            .sample(&mut self.random)
    }

    /// Three of them.
    pub fn vector(&mut self, deviation: f64) -> Vec3 {
        Vec3::from_fn(|_, _| self.normal(deviation))
    }

    /// A pose of the board in the camera frame: some of it in the image, tilted by up to so many
    /// degrees.
    pub fn pose(&mut self, tilt_deg: f64) -> Iso3 {
        let z = self.between(0.25, 0.45);
        let axis = self.between(-3.2, 3.2);
        let tilt = self.between(0.4, 1.0) * tilt_deg.to_radians();
        let turn = Vec3::new(axis.cos(), axis.sin(), 0.0) * tilt;
        let at = Vec3::new(0.3 * z * self.unit(), 0.22 * z * self.unit(), z);
        let roll = Iso3::rotation(Vec3::new(0.0, 0.0, self.unit()));
        Iso3::new(at, turn) * roll
    }

    /// What a camera sees of a board: whole tags, with this much noise of each coordinate, px.
    pub fn view(&mut self, camera: &Camera, board: &Board, pose: &Iso3, noise: f64) -> View {
        let mut tags = Vec::new();
        let target = vpc_calib::target::Target::from(board);
        let inside = |[u, v]: [f64; 2]| {
            let [width, height] = camera.size.map(f64::from);
            (3.0..width - 4.0).contains(&u) && (3.0..height - 4.0).contains(&v)
        };
        for (number, _) in board.tags() {
            let places = target.corners(number).unwrap();
            let seen = places.map(|at| camera.project(pose, at).filter(|pixel| inside(*pixel)));
            if let [Some(a), Some(b), Some(c), Some(d)] = seen {
                let corners = [a, b, c, d].map(|pixel| pixel.map(|x| x + self.normal(noise)));
                tags.push(Tag { number, corners });
            }
        }
        View::of_tags("", &tags)
    }
}
