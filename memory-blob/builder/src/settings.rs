//! Settings of the builder; the paper's values are the defaults.

use std::collections::BTreeMap;

use scene::Scene;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use smart_default::SmartDefault;
use toml_schema::Refusal;
use vpc::{Model, SolverOptions};

/// Factors by which an occlusion may be drawn larger.
const GROWTH: [f64; 2] = [1.0, 3.0];

/// How a memory is built. The defaults are the paper's where it has them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, SmartDefault)]
#[serde(deny_unknown_fields, default)]
#[schemars(title = "vpc-memory build")]
pub struct BuildSettings {
    /// N_t: successful trajectories to collect; the paper's strategies need 900. Flag:
    /// --trajectories.
    #[default = 50]
    #[schemars(range(min = 1, max = 10000000))]
    pub trajectories: usize,
    /// Steps previewed by the solver. Flag: --np.
    #[default = 10]
    #[schemars(range(min = 1, max = vpc::MAX_NP))]
    pub np: usize,
    /// Most iterations of the solver. Flag: --iterations.
    #[default = 100]
    #[schemars(range(min = 1, max = 1000))]
    pub iterations: u32,
    /// Optimality at which the solver stops. Flag: --tolerance.
    #[default = 1e-9]
    #[schemars(range(min = 1e-15, max = 1))]
    pub tolerance: f64,
    /// The memory guides features closer than this to an occlusion. Flag: --trigger-px.
    #[default = 20.0]
    #[schemars(range(min = 0, max = 1e4), extend("x-unit" = "px"))]
    pub trigger_px: f64,
    /// n_th: number of trajectories after which the memory guides its own building.
    #[default = 100]
    pub guide_after: usize,
    /// Share of the trajectories after which starts are drawn near failed ones.
    #[default = 0.5]
    #[schemars(range(min = 0, max = 1))]
    pub adapt_after: f64,
    /// Share of such starts; the rest stays uniform.
    #[default = 0.5]
    #[schemars(range(min = 0, max = 1))]
    pub adapt_share: f64,
    /// Starts tried in parallel against one state of the memory. Unlike the threads, it changes the
    /// result.
    #[default = 32]
    #[schemars(range(min = 1, max = 4096))]
    pub batch: usize,
    /// Way point of a sample on its trajectory: `{ sight = SHARE }` or `{ samples = N }`. Flag:
    /// --way-point-samples.
    #[schemars(extend("x-allowed" = "sight: 0.001 to 1; samples: 1 to 10000"))]
    pub way_point: WayPoint,
    /// Whether a planner in pose space solves starts that no recovery frees. Flag: --no-planner.
    #[default = true]
    pub planner: bool,
    /// Least image motion between stored samples, as a share of the image width.
    #[default = 0.01]
    #[schemars(range(min = 0, max = 1))]
    pub sample_spacing: f64,
    /// Seed of every random choice. Flag: --seed.
    #[default = 1]
    pub seed: u64,
    /// Occlusions enlarged while trajectories are made: `{ "NAME" = FACTOR }`. Flag: --grow.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    #[schemars(extend("x-allowed" = "factors from 1 to 3", "additionalProperties" = growth()))]
    pub grow: BTreeMap<String, f64>,
    #[allow(missing_docs)]
    pub regression: RegressionSettings,
    /// Collect foresight's trajectories, where it needs them, instead of the paper's. Flag:
    /// --foresight.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub foresight: Option<ForesightSettings>,
}

/// Trajectories of foresight: one is kept where foresight, with the memory so far and a short
/// pause, fails or pays more than after long thought. The law has its default settings then, and
/// knows no arm; np, iterations, tolerance, planner and guide_after do not matter. A batch that is
/// interrupted is done again.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, SmartDefault)]
#[serde(deny_unknown_fields, default)]
pub struct ForesightSettings {
    /// Starts that are tried; fewer if there are enough trajectories.
    #[default = 500]
    #[schemars(range(min = 1, max = 10000000))]
    pub starts: u64,
    /// Foresight thinks for so long before the run that is compared, as it does until it is armed.
    #[default = 1.0]
    #[schemars(range(min = 0, max = 3600), extend("x-unit" = "s"))]
    pub pause_s: f64,
    /// Foresight thinks for so long about the best way from a start.
    #[default = 10.0]
    #[schemars(range(min = 0, max = 3600), extend("x-unit" = "s"))]
    pub think_s: f64,
    /// A trajectory is kept where the run costs more than this many times the best.
    #[default = 1.05]
    #[schemars(range(min = 1, max = 100))]
    pub pays: f64,
}

fn growth() -> serde_json::Value {
    serde_json::json!({ "type": "number", "minimum": GROWTH[0], "maximum": GROWTH[1] })
}

/// Where the way point of a sample lies on its trajectory.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema, SmartDefault)]
#[serde(rename_all = "kebab-case")]
pub enum WayPoint {
    /// So many control periods ahead (n_s), as in the paper.
    Samples(#[schemars(range(min = 1, max = 10000))] usize),
    /// The last features in sight: within this image motion along the trajectory, share of the
    /// image width, and reached by every point on a straight line without crossing an occlusion.
    #[default]
    Sight(
        #[default = 0.25]
        #[schemars(range(min = 1e-3, max = 1))]
        f64,
    ),
}

/// Fit of the Gaussian process.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, SmartDefault)]
#[serde(deny_unknown_fields, default)]
pub struct RegressionSettings {
    /// Most samples kept for regression. Flag: --gpr-samples.
    #[default = 800]
    #[schemars(range(min = 2, max = 20000))]
    pub samples: usize,
    /// Samples have a feature closer to an occlusion than this many times `trigger_px`.
    #[default = 2.0]
    #[schemars(range(min = 1, max = 1e6))]
    pub zone: f64,
    /// Most samples for the fit of the hyperparameters.
    #[default = 400]
    #[schemars(range(min = 2, max = 4000))]
    pub likelihood_samples: usize,
    /// Seeded restarts of the maximization of the likelihood.
    #[default = 3]
    #[schemars(range(min = 1, max = 100))]
    pub restarts: usize,
    /// Evaluations of the likelihood on all kept samples, from the subset's best.
    pub polish: usize,
    /// Whether the factor for predictive variances is stored (8 bytes per pair of samples). Flag:
    /// --variance.
    pub variance: bool,
}

/// Returns the JSON Schema of a file of settings.
pub fn schema() -> serde_json::Value {
    toml_schema::schema::<BuildSettings>()
}

impl BuildSettings {
    /// The scene in which trajectories are made: with the grown occlusions, each part about its own
    /// centre. What keeps clear of those keeps clear of the scene's, so that the memory is one for
    /// the scene; it bears its fingerprint, and these settings in its provenance.
    ///
    /// # Errors
    /// [`Refusal`] where a name is not the scene's, or a factor out of its range.
    pub fn grown(&self, scene: &Scene) -> Result<Scene, Refusal> {
        let mut grown = scene.clone();
        let mut most: f64 = 0.0;
        for (name, &factor) in &self.grow {
            let refused = |allowed: &str| Refusal {
                key: "grow".to_owned(),
                value: Some(format!("{name}={factor}")),
                allowed: allowed.to_owned(),
            };
            if !(GROWTH[0]..=GROWTH[1]).contains(&factor) {
                return Err(refused("factors from 1 to 3"));
            }
            let mut named = grown.occlusions.iter_mut();
            let Some(occlusion) = named.find(|occlusion| occlusion.name.as_str() == name) else {
                return Err(refused("the name of one of the scene's occlusions"));
            };
            let sides = occlusion.parts.iter_mut().flat_map(|part| &mut part.half);
            for half in sides {
                most = most.max((factor - 1.0) * *half);
                *half *= factor;
            }
        }
        // Starts keep their distance from what is there, not from what is drawn: else nothing would
        // be known of those that are close.
        grown.starts.clearance_px = (grown.starts.clearance_px - most).max(0.0);
        Ok(grown)
    }

    /// When the solver stops.
    pub fn solver(&self) -> SolverOptions {
        SolverOptions {
            max_iterations: self.iterations,
            tolerance: self.tolerance,
            intersample: true,
        }
    }

    /// The model that previews use: exact, since the builder knows the pattern.
    pub const MODEL: Model = Model::Pose;
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_defaults_are_valid_and_the_papers() {
        let settings = BuildSettings::default();
        assert_eq!(toml_schema::check(&settings), Ok(()));
        assert_eq!(
            (settings.trajectories, settings.np, settings.iterations),
            (50, 10, 100)
        );
    }

    #[test]
    fn a_setting_out_of_range_is_named() {
        let settings = BuildSettings {
            tolerance: f64::NAN,
            ..Default::default()
        };
        let message = toml_schema::check(&settings).unwrap_err().to_string();
        assert_eq!(message, "tolerance = NaN; allowed: 1e-15 to 1");
    }

    #[test]
    fn an_occlusion_grows_about_its_centre_and_the_others_do_not() {
        let scene = Scene::parse(scene::PAPER_ROBOT, "robot").unwrap();
        let mut settings = BuildSettings::default();
        assert_eq!(settings.grown(&scene), Ok(scene.clone()));
        settings.grow.insert("spot on the lens".into(), 1.5);
        let grown = settings.grown(&scene).unwrap();
        let (before, after) = (&scene.occlusions[0].parts[0], &grown.occlusions[0].parts[0]);
        assert_eq!(before.center, after.center);
        assert_eq!(after.half, before.half.map(|half| 1.5 * half));
        assert_eq!(grown.occlusions[1], scene.occlusions[1]);
        // 15 px from the spot as it is, which is 19 px smaller.
        assert_eq!(grown.starts.clearance_px, 0.0);
        assert_ne!(grown.fingerprint(), scene.fingerprint());
    }

    #[test]
    fn what_the_scene_has_not_does_not_grow_and_nothing_shrinks() {
        let scene = Scene::parse(scene::PAPER_ROBOT, "robot").unwrap();
        for (name, factor, words) in [
            ("spot", 1.2, "grow = spot=1.2; allowed: the name of one"),
            ("spot on the lens", 0.9, "allowed: factors from 1 to 3"),
            ("spot on the lens", f64::NAN, "allowed: factors from 1 to 3"),
        ] {
            let mut settings = BuildSettings::default();
            settings.grow.insert(name.into(), factor);
            let message = settings.grown(&scene).unwrap_err().to_string();
            assert!(message.contains(words), "{message}");
        }
    }
}
