//! How the world differs from what controller and bridge believe.

use nalgebra::{Rotation3, Translation3, Vector3};
use panda::Pose;
use scene::{Occlusion, Scene};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use vision::Lens;

/// The least half size of an occlusion that shrinks, px.
const LEAST_HALF: f64 = 0.5;

/// How the world differs from what controller and bridge assume.
#[derive(Clone, Copy, Debug, Default, PartialEq, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Truth {
    /// The focal lengths are larger by this share.
    #[schemars(range(min = -0.5, max = 0.5))]
    pub focal: f64,
    /// Shift of the principal point, right and down.
    #[schemars(inner(range(min = -100, max = 100)), extend("x-unit" = "px"))]
    pub center_px: [f64; 2],
    /// Distortion of lens and occlusions, as in OpenCV: k1, k2, p1, p2, k3.
    #[schemars(inner(range(min = -2, max = 2)))]
    pub distortion: [f64; 5],
    /// Displacement of the camera from its calibration, along its axes.
    #[schemars(inner(range(min = -0.2, max = 0.2)), extend("x-unit" = "m"))]
    pub hand_eye_m: [f64; 3],
    /// Rotation vector of the camera from its calibration.
    #[schemars(inner(range(min = -30, max = 30)), extend("x-unit" = "deg"))]
    pub hand_eye_deg: [f64; 3],
    /// Pattern and distances are larger by this share; the images at the start are the same.
    #[schemars(range(min = -0.5, max = 1))]
    pub depth: f64,
    /// Shift of every occlusion, right and down.
    #[schemars(inner(range(min = -200, max = 200)), extend("x-unit" = "px"))]
    pub mask_shift_px: [f64; 2],
    /// Growth of every occlusion on every side.
    #[schemars(range(min = -100, max = 100), extend("x-unit" = "px"))]
    pub mask_growth_px: f64,
    /// Constant error of the exposure stamps; positive: too late.
    #[schemars(range(min = -200, max = 200), extend("x-unit" = "ms"))]
    pub stamp_bias_ms: f64,
    /// Random error of the stamps (standard deviation).
    #[schemars(range(min = 0, max = 50), extend("x-unit" = "ms"))]
    pub stamp_jitter_ms: f64,
    /// Mean number of frames lost in a row; 0: each by itself.
    #[schemars(range(min = 0, max = 100), extend("x-unit" = "frames"))]
    pub drop_burst: f64,
    /// FCI: decimals of the desk's F_T_NE, which O_T_EE inherits; 0: all.
    #[schemars(range(min = 0, max = 15), extend("x-unit" = "digits"))]
    pub desk_decimals: u32,
    /// Rendered: share of `exposure_ms` during which motion blurs tags.
    #[schemars(range(min = 0, max = 10))]
    pub motion_blur: f64,
    /// Rendered: standard deviation of the blur from defocus.
    #[schemars(range(min = 0, max = 20), extend("x-unit" = "px"))]
    pub defocus_px: f64,
    /// Rendered: the brightness changes by up to this share, slowly and in steps.
    #[schemars(range(min = 0, max = 1))]
    pub gain: f64,
    /// Rendered: level of a light that tags mirror, in the middle of its highlight.
    #[schemars(range(min = 0, max = 255), extend("x-unit" = "levels"))]
    pub gloss: f64,
    /// Rendered: the sensor sees one color a pixel (Bayer), and interpolates the gray.
    pub demosaic: bool,
    /// Rendered: gain of the camera's sharpening, an unsharp mask of 1 px.
    #[schemars(range(min = 0, max = 5))]
    pub sharpening: f64,
    /// Rendered: other tags on the table, the last a copy of tag 0.
    #[schemars(range(min = 0, max = 20))]
    pub clutter: u32,
}

impl Truth {
    /// Where the camera really sits in the flange, given where it is believed to.
    pub fn flange_from_camera(&self, believed: &Pose) -> Pose {
        let error = Pose::from_parts(
            Translation3::from(self.hand_eye_m),
            Rotation3::new(Vector3::from(self.hand_eye_deg.map(f64::to_radians))),
        );
        believed * error
    }

    /// The scene as it really is: the true lens, the true pattern and the true occlusions.
    pub fn scene(&self, believed: &Scene) -> Scene {
        let mut real = believed.clone();
        real.camera.fx *= 1.0 + self.focal;
        real.camera.fy *= 1.0 + self.focal;
        real.camera.cx += self.center_px[0];
        real.camera.cy += self.center_px[1];
        let lengths = real.pattern.iter_mut().flatten();
        let lengths = lengths.chain([&mut real.marker_size]);
        for length in lengths.chain(&mut real.goal.translation) {
            *length *= 1.0 + self.depth;
        }
        let (shift, growth) = (self.mask_shift_px, self.mask_growth_px);
        if shift != [0.0; 2] || growth != 0.0 {
            let occlusions = real.occlusions.iter_mut();
            occlusions.for_each(|occlusion| displace(occlusion, shift, growth));
        }
        real
    }

    /// The true lens of a true scene's camera.
    pub fn lens(&self, real: &Scene) -> Lens {
        Lens::new(&real.camera, self.distortion)
    }

    /// A start pose as it really is.
    pub fn start(&self, believed: &scene::Pose) -> scene::Pose {
        scene::Pose {
            translation: believed.translation.map(|x| x * (1.0 + self.depth)),
            rotation: believed.rotation,
        }
    }
}

fn displace(occlusion: &mut Occlusion, shift: [f64; 2], growth: f64) {
    for part in &mut occlusion.parts {
        for k in 0..2 {
            part.center[k] += shift[k];
            part.half[k] = (part.half[k] + growth).max(LEAST_HALF);
        }
    }
    if let Some(mask) = &mut occlusion.mask {
        *mask = mask.moved(shift, growth);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::project;
    use crate::occlusion::Shape;
    use crate::pose::from_scene;
    use crate::robot::calibration::HandEye;

    fn robot_scene() -> Scene {
        Scene::parse(scene::PAPER_ROBOT, "robot").unwrap()
    }

    #[test]
    fn an_error_of_depth_leaves_the_images_of_goal_and_start_alone() {
        let believed = robot_scene();
        let truth = Truth {
            depth: 0.2,
            ..Truth::default()
        };
        let real = truth.scene(&believed);
        let starts = scene::parse_starts(scene::PAPER_ROBOT_STARTS, "starts").unwrap();
        for start in starts.iter().chain([&believed.goal]) {
            let seen = project(&believed, &from_scene(start)).unwrap();
            let really = project(&real, &from_scene(&truth.start(start))).unwrap();
            for (a, b) in seen.iter().flatten().zip(really.iter().flatten()) {
                assert!((a - b).abs() < 1e-9);
            }
        }
        assert!(real.pattern[2][0] > 1.19 * believed.pattern[2][0]);
    }

    #[test]
    fn a_mounting_error_moves_the_camera_by_as_much() {
        let believed = HandEye::default().flange_from_camera();
        let truth = Truth {
            hand_eye_m: [0.01, 0.0, -0.02],
            hand_eye_deg: [0.0, 3.0, 0.0],
            ..Truth::default()
        };
        let error = believed.inverse() * truth.flange_from_camera(&believed);
        assert!((error.translation.vector - Vector3::new(0.01, 0.0, -0.02)).norm() < 1e-12);
        assert!((error.rotation.angle().to_degrees() - 3.0).abs() < 1e-9);
        assert_eq!(Truth::default().flange_from_camera(&believed), believed);
    }

    #[test]
    fn occlusions_are_displaced_and_grown_parts_and_masks_alike() {
        let truth = Truth {
            mask_shift_px: [12.0, -7.0],
            mask_growth_px: 5.0,
            ..Truth::default()
        };
        let believed = robot_scene();
        let directory = tempfile::TempDir::new().unwrap();
        let in_spot = |u: u32, v: u32| (f64::from(u) - 320.0).hypot(f64::from(v) - 222.0) < 38.0;
        scene::write_mask(&directory.path().join("mask.png"), 640, 480, in_spot).unwrap();
        let (head, _) = scene::PAPER_ROBOT.split_once("[[occlusion]]").unwrap();
        let text = format!("{head}[[occlusion]]\nname = \"spot\"\nmask = \"mask.png\"\n");
        std::fs::write(directory.path().join("scene.toml"), text).unwrap();
        let painted = Scene::read(&directory.path().join("scene.toml")).unwrap();
        for (growth, radius) in [(5.0, 43.0), (-5.0, 33.0)] {
            let truth = Truth {
                mask_growth_px: growth,
                ..truth
            };
            for scene in [&believed, &painted] {
                let spot = Shape::new(&truth.scene(scene).occlusions[0]);
                for angle in [0.0, 1.0, 2.5, 4.0] {
                    let (sin, cos) = f64::sin_cos(angle);
                    let at = |away: f64| [332.0 + away * cos, 215.0 + away * sin];
                    let depth = |away| spot.distance_below(at(away), 1e3);
                    assert!((depth(radius) / 1.5).abs() < 1.0, "{}", depth(radius));
                    assert!(depth(radius - 4.0) < 0.0 && depth(radius + 4.0) > 0.0);
                }
            }
        }
        assert_eq!(Truth::default().scene(&painted), painted);
    }
}
