//! A light that glossy print mirrors: a highlight that moves with the camera.
//!
//! Source: J. F. Blinn, "Models of light reflection for computer synthesized pictures", SIGGRAPH
//! 1977: facets with normally distributed slopes mirror the light into the eye where they face
//! half-way between both.

use nalgebra::{Rotation3, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use scene::Pose;

use crate::homography::Point;
use crate::look::Look;

/// Height of the light over the plane of the pattern, and how far aside it may be along x and along
/// y, m.
const HEIGHT: f64 = 1.0;
const ASIDE: f64 = 0.3;
/// Standard deviation of the slopes of the facets: that of semi-gloss print, 3 degrees.
const ROUGHNESS: f64 = 0.052;
/// Distinguishes the random numbers of the light's place from those of the texture.
const GLOSS: u64 = 0x9105;

/// A light at rest to the pattern.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Gloss {
    /// In the frame of the object, m; z points away from the camera.
    light: Vector3<f64>,
    /// Level in the middle of the highlight.
    level: f64,
}

impl Gloss {
    /// Of this look; `None` where it asks for no gloss.
    pub fn new(look: &Look) -> Option<Self> {
        let mut random = ChaCha8Rng::seed_from_u64(look.seed ^ GLOSS);
        let mut aside = || ASIDE * (2.0 * random.random::<f64>() - 1.0);
        (look.gloss > 0.0).then(|| Self {
            light: Vector3::new(aside(), aside(), -HEIGHT),
            level: look.gloss,
        })
    }

    /// The level that a point of the plane mirrors into an eye in the frame of the object, m.
    pub fn at(&self, [x, y]: Point, eye: &Vector3<f64>) -> f32 {
        let point = Vector3::new(x, y, 0.0);
        let facing = (eye - point).normalize() + (self.light - point).normalize();
        // Not from behind.
        let slope = facing.xy().norm() / (-facing.z).max(1e-9) / ROUGHNESS;
        (self.level * (-0.5 * slope * slope).exp()) as f32
    }
}

/// Where the camera is in the frame of an object at this pose.
pub(crate) fn eye(pose: &Pose) -> Vector3<f64> {
    Rotation3::new(-Vector3::from(pose.rotation)) * -Vector3::from(pose.translation)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn gloss(seed: u64) -> Gloss {
        let look = Look {
            gloss: 80.0,
            seed,
            ..Look::default()
        };
        Gloss::new(&look).unwrap()
    }

    #[test]
    fn the_highlight_is_where_a_mirror_shows_the_light() {
        for seed in 0..10 {
            let gloss = gloss(seed);
            for eye in [[0.0, 0.0, -0.35], [0.1, -0.05, -0.5]].map(Vector3::from) {
                // The ray to the light's image behind the mirror crosses the plane there.
                let share = -eye.z / (HEIGHT - eye.z);
                let mirrored = (eye + (gloss.light - eye) * share).xy();
                let at = |du: f64, dv: f64| gloss.at([mirrored.x + du, mirrored.y + dv], &eye);
                let middle = at(0.0, 0.0);
                assert!((middle - 80.0).abs() < 1e-3, "{middle}");
                let around = [[0.01, 0.0], [-0.01, 0.0], [0.0, 0.01], [0.0, -0.01]];
                assert!(around.iter().all(|[du, dv]| at(*du, *dv) < middle));
                assert!(at(0.3, 0.0) < 0.1);
            }
        }
        assert_ne!(gloss(1).light, gloss(2).light);
        assert_eq!(gloss(1).light, gloss(1).light);
        assert!(Gloss::new(&Look::default()).is_none());
    }

    #[test]
    fn the_eye_is_the_camera_in_the_frame_of_the_object() {
        let pose = Pose {
            translation: [0.1, -0.2, 0.8],
            rotation: [0.3, -0.4, 1.2],
        };
        let there = Rotation3::new(Vector3::from(pose.rotation)) * eye(&pose);
        assert!((there + Vector3::from(pose.translation)).norm() < 1e-12);
    }
}
