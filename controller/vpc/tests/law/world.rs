//! A camera before a pattern that moves: a truth of its own.

use std::ops::Range;

use nalgebra::Vector3;
use scene::{Pose, Scene};
use vpc::motion::{Motion, rotation};
use vpc::{Twist, camera};

/// The pattern's twist in its own frame after some seconds, m/s and rad/s.
pub type Own = fn(f64) -> Twist;

/// A camera before a pattern that moves.
pub struct World {
    pub scene: Scene,
    /// The pattern in the camera frame, m.
    pub points: Vec<Vector3<f64>>,
    /// Its origin and the ends of its axes, m.
    pub origin: [Vector3<f64>; 4],
    pub seconds: f64,
}

/// Instants of a period at which the world is looked at.
pub const INSTANTS: usize = 12;

/// Whether tests run at full length: `VPC_LONG=1`.
pub fn is_long() -> bool {
    std::env::var_os("VPC_LONG").is_some_and(|value| !value.is_empty() && value != "0")
}

/// The numbers of a test's starts: these few, which show the mechanism, or all with `VPC_LONG=1`.
pub fn taken(few: &[usize], all: Range<usize>) -> Vec<usize> {
    if is_long() {
        all.collect()
    } else {
        few.to_vec()
    }
}

impl World {
    /// The paper's simulated scene.
    pub fn new(start: &Pose) -> Self {
        let scene = Scene::parse(scene::PAPER_SIM, "paper-sim.toml").unwrap();
        Self::of(scene, start)
    }

    pub fn of(scene: Scene, start: &Pose) -> Self {
        let at = |p: [f64; 3]| {
            rotation(start.rotation) * Vector3::from(p) + Vector3::from(start.translation)
        };
        Self {
            points: scene.pattern.iter().map(|p| at(*p)).collect(),
            origin: [[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]].map(at),
            scene,
            seconds: 0.0,
        }
    }

    pub fn features(&self) -> Vec<[f64; 2]> {
        let see = |x: &Vector3<f64>| camera::project(&self.scene.camera, (*x).into()).unwrap();
        self.points.iter().map(see).collect()
    }

    /// The pattern's own twist, in the camera frame.
    fn own(&self, own: Own) -> Twist {
        let [vx, vy, vz, wx, wy, wz] = own(self.seconds);
        let [at, x, y, z] = self.origin;
        let axes = [x - at, y - at, z - at];
        let turned = |v: [f64; 3]| axes[0] * v[0] + axes[1] * v[1] + axes[2] * v[2];
        let turning = turned([wx, wy, wz]);
        let velocity = turned([vx, vy, vz]) - turning.cross(&at);
        [
            velocity.x, velocity.y, velocity.z, turning.x, turning.y, turning.z,
        ]
    }

    pub fn go(&mut self, twist: &Twist, own: Own, seconds: f64) {
        let drift = self.own(own);
        let relative = core::array::from_fn(|k| twist[k] - drift[k]);
        let motion = Motion::of_camera(&relative, seconds);
        for x in self.points.iter_mut().chain(&mut self.origin) {
            *x = motion.apply(x);
        }
        self.seconds += seconds;
    }

    /// The same where the pattern rests.
    pub fn obey(&mut self, twist: &Twist, seconds: f64) {
        self.go(twist, |_| [0.0; 6], seconds);
    }
}
