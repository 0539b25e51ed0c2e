//! The hand-eye calibration that the bridge was given.

use nalgebra::{Rotation3, Translation3, Vector3};
use panda::Pose;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The camera in the flange frame, as the bridge believes.
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
    /// A camera in the flange itself.
    pub const NONE: Self = Self {
        translation: [0.0; 3],
        rotation_deg: [0.0; 3],
    };

    /// The camera in the flange frame, F_T_C.
    pub fn flange_from_camera(&self) -> Pose {
        Pose::from_parts(
            Translation3::from(self.translation),
            Rotation3::new(Vector3::from(self.rotation_deg.map(f64::to_radians))),
        )
    }
}
