//! The tables of a scene file as TOML has them, before any check.

use serde::Deserialize;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct RawScene {
    pub(crate) camera: RawCamera,
    pub(crate) pattern: RawPattern,
    pub(crate) goal: RawPose,
    pub(crate) limits: RawLimits,
    pub(crate) cost: RawCost,
    pub(crate) success: RawSuccess,
    pub(crate) starts: RawStarts,
    #[serde(default)]
    pub(crate) occlusion: Vec<RawOcclusion>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct RawCamera {
    pub(crate) width: u32,
    pub(crate) height: u32,
    pub(crate) fx: f64,
    pub(crate) fy: f64,
    pub(crate) cx: f64,
    pub(crate) cy: f64,
    pub(crate) rate_hz: f64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct RawPattern {
    pub(crate) points: Vec<[f64; 3]>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct RawPose {
    pub(crate) translation: [f64; 3],
    pub(crate) rotation: [f64; 3],
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct RawLimits {
    pub(crate) linear: f64,
    pub(crate) angular: f64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct RawCost {
    pub(crate) k_q: f64,
    pub(crate) r: [f64; 6],
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct RawSuccess {
    pub(crate) violation_px: f64,
    pub(crate) convergence_px: f64,
    pub(crate) time_s: f64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct RawStarts {
    pub(crate) translation_min: [f64; 3],
    pub(crate) translation_max: [f64; 3],
    pub(crate) tilt_max: f64,
    pub(crate) roll_max: f64,
    pub(crate) clearance_px: f64,
    pub(crate) min_error_px: f64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct RawOcclusion {
    pub(crate) name: String,
    #[serde(default)]
    pub(crate) parts: Vec<RawPart>,
    pub(crate) mask: Option<String>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct RawPart {
    pub(crate) center: [f64; 2],
    pub(crate) half: [f64; 2],
    pub(crate) p: f64,
}
