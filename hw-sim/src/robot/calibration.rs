//! The hand-eye calibration that the bridge was given, and how the world differs from it.

use nalgebra::{Rotation3, Translation3, Vector3};
use panda::{Mount, Pose};
use scene::Scene;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The camera in the flange frame, as a calibration finds it and the bridge believes.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct HandEye {
    /// Origin of the camera in the flange frame.
    #[schemars(inner(range(min = -1, max = 1)), extend("x-unit" = "m"))]
    pub translation: [f64; 3],
    /// Rotation vector from the camera frame to the flange frame.
    #[schemars(inner(range(min = -360, max = 360)), extend("x-unit" = "deg"))]
    pub rotation_deg: [f64; 3],
}

impl Default for HandEye {
    /// A camera in front of the hand that looks along the fingers, its lower edge towards them: the
    /// hand is turned by -45 deg on the flange, the camera by 90 deg on the hand, 7 cm before it
    /// and 4 cm above the flange.
    fn default() -> Self {
        let diagonal = 0.07 * std::f64::consts::FRAC_1_SQRT_2;
        Self {
            translation: [diagonal, -diagonal, 0.04],
            rotation_deg: [0.0, 0.0, 45.0],
        }
    }
}

impl HandEye {
    /// As the robot's package takes it.
    pub fn mount(&self) -> Mount {
        Mount {
            flange_from_camera: Pose::from_parts(
                Translation3::from(self.translation),
                Rotation3::new(Vector3::from(self.rotation_deg.map(f64::to_radians))),
            ),
        }
    }
}

/// How the world differs from what controller and bridge believe; all zero if it does not.
#[derive(Clone, Copy, Debug, Default, PartialEq, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Truth {
    /// True focal lengths are larger by this share.
    #[schemars(range(min = -0.5, max = 0.5))]
    pub focal: f64,
    /// The true principal point lies this far to the right and down.
    #[schemars(inner(range(min = -100, max = 100)), extend("x-unit" = "px"))]
    pub center_px: [f64; 2],
    /// The true camera sits this far from where the calibration has it, along the camera's axes.
    #[schemars(inner(range(min = -0.2, max = 0.2)), extend("x-unit" = "m"))]
    pub hand_eye_m: [f64; 3],
    /// The true camera is turned by this rotation vector from where the calibration has it, about
    /// the camera's axes.
    #[schemars(inner(range(min = -30, max = 30)), extend("x-unit" = "deg"))]
    pub hand_eye_deg: [f64; 3],
    /// Pattern and distances are larger by this share: an error of depth alone, the images at the
    /// start are the same.
    #[schemars(range(min = -0.5, max = 1))]
    pub depth: f64,
}

impl Truth {
    /// Where the camera really sits.
    pub fn mount(&self, believed: &Mount) -> Mount {
        let error = Pose::from_parts(
            Translation3::from(self.hand_eye_m),
            Rotation3::new(Vector3::from(self.hand_eye_deg.map(f64::to_radians))),
        );
        Mount {
            flange_from_camera: believed.flange_from_camera * error,
        }
    }

    /// The scene as it really is: the true lens and the true pattern.
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
        real
    }

    /// A start pose as it really is.
    pub fn start(&self, believed: &scene::Pose) -> scene::Pose {
        scene::Pose {
            translation: believed.translation.map(|x| x * (1.0 + self.depth)),
            rotation: believed.rotation,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::project;
    use crate::pose::from_scene;

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
    fn an_error_of_the_mounting_moves_the_camera_by_as_much_and_no_more() {
        let believed = HandEye::default().mount();
        let truth = Truth {
            hand_eye_m: [0.01, 0.0, -0.02],
            hand_eye_deg: [0.0, 3.0, 0.0],
            ..Truth::default()
        };
        let error =
            believed.flange_from_camera.inverse() * truth.mount(&believed).flange_from_camera;
        assert!((error.translation.vector - Vector3::new(0.01, 0.0, -0.02)).norm() < 1e-12);
        assert!((error.rotation.angle().to_degrees() - 3.0).abs() < 1e-9);
        assert_eq!(Truth::default().mount(&believed), believed);
    }
}
