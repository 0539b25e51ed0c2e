//! The image plane to draw on: size, goal, occlusions, limits; from the scene, or from what was seen.

use std::path::Path;

use scene::{Mask, Pose, Scene, SceneError};

use crate::view::View;

/// Sizes of images that cameras have, px: the first that holds all features seen is taken where no scene tells.
const SIZES: [[f64; 2]; 5] = [
    [640.0, 480.0],
    [1280.0, 960.0],
    [1600.0, 1200.0],
    [2560.0, 1920.0],
    [5120.0, 3840.0],
];

/// The image plane.
#[derive(Clone, Debug, Default)]
pub struct Stage {
    scene: Option<Scene>,
}

impl Stage {
    /// From the scene file, where one is named.
    ///
    /// # Errors
    /// As [`Scene::read`].
    pub fn read(path: Option<&Path>) -> Result<Self, SceneError> {
        let scene = path.map(Scene::read).transpose()?;
        Ok(Self { scene })
    }

    /// From a scene.
    pub fn new(scene: Scene) -> Self {
        Self { scene: Some(scene) }
    }

    /// Width and height of the image, px.
    pub fn size(&self, view: &View) -> [f64; 2] {
        if let Some(scene) = &self.scene {
            return [scene.camera.width, scene.camera.height];
        }
        let mut most = [0.0_f64; 2];
        for point in view.recent(u64::MAX).flat_map(|record| record.pairs()) {
            most = [most[0].max(point[0]), most[1].max(point[1])];
        }
        let holds = |size: &&[f64; 2]| most[0] <= size[0] && most[1] <= size[1];
        *SIZES.iter().find(holds).unwrap_or(&SIZES[SIZES.len() - 1])
    }

    /// The goal of each feature (u, v), px; empty without a scene.
    pub fn goal(&self) -> Vec<[f64; 2]> {
        let Some(scene) = &self.scene else {
            return Vec::new();
        };
        let camera = &scene.camera;
        let seen = scene.pattern.iter().map(|&point| {
            let [x, y, z] = moved(&scene.goal, point);
            [camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy]
        });
        seen.collect()
    }

    /// Whether this point of the image (px) is in a shape: an occlusion that is not painted.
    pub fn covers(&self, point: [f64; 2]) -> bool {
        self.scene.iter().flat_map(Scene::parts).any(|part| {
            let reach = |i: usize| ((point[i] - part.center[i]).abs() / part.half[i]).powf(part.p);
            reach(0) + reach(1) < 1.0
        })
    }

    /// Whether there is an occlusion in this box of the image (px): its middle in a shape, or a pixel of it painted, so
    /// that thin lines do not get lost.
    pub fn touches(&self, low: [f64; 2], high: [f64; 2]) -> bool {
        let middle = [0, 1].map(|i| (low[i] + high[i]) / 2.0);
        // A pixel is the square about its whole-numbered centre. The casts stop at 0.
        let pixels = |i: usize| (low[i] + 0.5).floor() as usize..(high[i] + 0.5).ceil() as usize;
        let painted = |mask: &Mask| {
            pixels(1).any(|row| pixels(0).any(|column| mask.is_forbidden(column, row)))
        };
        self.covers(middle) || self.scene.iter().flat_map(Scene::masks).any(painted)
    }

    /// The painted pixels as rectangles [u, v, width, height], px.
    pub fn painted(&self) -> impl Iterator<Item = [f64; 4]> {
        let masks = self.scene.iter().flat_map(Scene::masks);
        masks.flat_map(Mask::rectangles).map(|[columns, rows]| {
            let [u, v] = [columns.start, rows.start].map(|pixel| pixel as f64 - 0.5);
            [u, v, columns.len() as f64, rows.len() as f64]
        })
    }

    /// Whether there are occlusions to draw.
    pub fn is_bare(&self) -> bool {
        self.scene
            .as_ref()
            .is_none_or(|scene| scene.occlusions.is_empty())
    }

    /// Limit of each component of the twist, m/s and rad/s; without a scene the largest seen.
    pub fn limits(&self, view: &View) -> [f64; 6] {
        if let Some(scene) = &self.scene {
            let (linear, angular) = (scene.limits.linear, scene.limits.angular);
            return [linear, linear, linear, angular, angular, angular];
        }
        let most = |of: std::ops::Range<usize>| {
            let sizes = view
                .recent(u64::MAX)
                .flat_map(|r| r.twist[of.clone()].iter());
            sizes.fold(1e-3_f64, |most, value| most.max(value.abs()))
        };
        let (linear, angular) = (most(0..3), most(3..6));
        [linear, linear, linear, angular, angular, angular]
    }

    /// The convergence threshold, px.
    pub fn convergence_px(&self) -> Option<f64> {
        self.scene
            .as_ref()
            .map(|scene| scene.success.convergence_px)
    }
}

/// A point of the object in the frame of the pose, by Rodrigues' formula, m.
fn moved(pose: &Pose, point: [f64; 3]) -> [f64; 3] {
    let [x, y, z] = pose.rotation;
    let angle = (x * x + y * y + z * z).sqrt();
    // sin(a)/a and (1 - cos(a))/a^2, of which the limits at zero suffice below 1e-8.
    let (first, second) = match angle > 1e-8 {
        true => (angle.sin() / angle, (1.0 - angle.cos()) / (angle * angle)),
        false => (1.0, 0.5),
    };
    let cross = |a: [f64; 3], b: [f64; 3]| {
        [
            a[1] * b[2] - a[2] * b[1],
            a[2] * b[0] - a[0] * b[2],
            a[0] * b[1] - a[1] * b[0],
        ]
    };
    let once = cross(pose.rotation, point);
    let twice = cross(pose.rotation, once);
    std::array::from_fn(|i| point[i] + first * once[i] + second * twice[i] + pose.translation[i])
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    fn paper() -> Stage {
        Stage::new(Scene::parse(scene::PAPER_SIM, "paper-sim.toml").unwrap())
    }

    /// The paper's simulated scene with a mask instead of its occlusions.
    pub(crate) fn painted(is_white: impl Fn(u32, u32) -> bool) -> Stage {
        let directory = tempfile::tempdir().unwrap();
        scene::write_mask(&directory.path().join("mask.png"), 1024, 1024, is_white).unwrap();
        let (head, _) = scene::PAPER_SIM.split_once("[[occlusion]]").unwrap();
        let text = format!("{head}[[occlusion]]\nname = \"painted\"\nmask = \"mask.png\"\n");
        let path = directory.path().join("scene.toml");
        std::fs::write(&path, text).unwrap();
        Stage::read(Some(&path)).unwrap()
    }

    #[test]
    fn a_line_one_pixel_wide_is_touched_and_only_where_it_is() {
        let stage = painted(|i, j| i == 77 && (100..200).contains(&j));
        assert!(stage.touches([70.0, 150.0], [80.0, 160.0]));
        assert!(stage.touches([77.0, 199.4], [77.4, 210.0]));
        for (low, high) in [
            ([78.0, 150.0], [90.0, 160.0]),
            ([60.0, 150.0], [76.5, 160.0]),
            ([70.0, 200.0], [80.0, 210.0]),
        ] {
            assert!(!stage.touches(low, high), "{low:?}");
        }
        assert_eq!(
            stage.painted().collect::<Vec<_>>(),
            [[76.5, 99.5, 1.0, 100.0]]
        );
        assert!(!stage.is_bare() && !stage.covers([77.0, 150.0]));
    }

    #[test]
    fn a_quarter_turn_about_the_optical_axis_takes_x_to_y() {
        let pose = Pose {
            translation: [0.0, 0.0, 2.0],
            rotation: [0.0, 0.0, std::f64::consts::FRAC_PI_2],
        };
        let [x, y, z] = moved(&pose, [1.0, 0.0, 0.0]);
        assert!(x.abs() < 1e-15 && (y - 1.0).abs() < 1e-15 && z == 2.0);
    }

    #[test]
    fn the_goal_of_the_paper_is_a_square_in_the_middle() {
        let stage = paper();
        let goal = stage.goal();
        let [width, height] = stage.size(&View::default());
        assert_eq!(goal.len(), 4);
        for axis in [0, 1] {
            let middle = goal.iter().map(|point| point[axis]).sum::<f64>() / 4.0;
            assert!(
                (middle - [width, height][axis] / 2.0).abs() < 1.0,
                "{goal:?}"
            );
        }
        assert!(goal.iter().all(|&point| !stage.covers(point)));
    }

    #[test]
    fn the_centre_of_every_part_is_covered() {
        let stage = paper();
        let scene = stage.scene.as_ref().unwrap();
        assert!(scene.parts().all(|part| stage.covers(part.center)));
        assert!(!Stage::default().covers([10.0, 10.0]));
    }
}
