//! Settings of the builder; the paper's values are the defaults.

use std::collections::BTreeMap;

use scene::Scene;
use serde::{Deserialize, Serialize};
use vpc::{Model, SolverOptions};

/// How the memory is built.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct BuildSettings {
    /// N_t: successful trajectories to collect, 1 to 100000.
    pub trajectories: usize,
    /// Steps previewed, 1 to 40.
    pub np: usize,
    /// Most iterations of the solver, 1 to 1000.
    pub iterations: u32,
    /// Optimality precision of the solver, 1e-15 to 1.
    pub tolerance: f64,
    /// Features closer than this to an occlusion are guided by the memory, px.
    pub trigger_px: f64,
    /// n_th: trajectories from which on the memory guides its own building.
    pub guide_after: usize,
    /// Share of the trajectories after which starts are drawn near failed ones, 0 to 1.
    pub adapt_after: f64,
    /// Share of adapted starts once adapting has begun, 0 to 1; the rest stays uniform.
    pub adapt_share: f64,
    /// Starts tried in parallel against one state of the memory; part of the result, unlike the threads.
    pub batch: usize,
    /// Where way points lie on the trajectory.
    pub way_point: WayPoint,
    /// Whether a start that every recovery leaves stuck is solved by a planner in pose space.
    pub planner: bool,
    /// Least image motion between two stored samples of a trajectory, share of the image width.
    pub sample_spacing: f64,
    /// Seed of every random choice.
    pub seed: u64,
    /// Occlusions that are drawn larger while trajectories are made, by name, with their factors: 1 to 3.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub grow: BTreeMap<String, f64>,
    /// Regression on the samples.
    pub regression: RegressionSettings,
}

/// Where the way point of a sample lies on its trajectory.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum WayPoint {
    /// n_s control periods ahead, as in the paper.
    Samples(usize),
    /// The last features in sight: within this image motion along the trajectory (share of the image width), and
    /// to which every point can go straight without crossing an occlusion.
    Sight(f64),
}

/// How the Gaussian process is fitted.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RegressionSettings {
    /// Samples kept for regression, at most; 2 to 20000.
    pub samples: usize,
    /// Samples are drawn where a feature is closer to an occlusion than this many times the trigger distance.
    pub zone: f64,
    /// Samples on which the hyper-parameters are fitted, at most.
    pub likelihood_samples: usize,
    /// Seeded restarts of the likelihood maximisation.
    pub restarts: usize,
    /// Evaluations of the likelihood on all kept samples that improve on the subset's best.
    pub polish: usize,
    /// Whether the factor for predictive variances is stored (8 bytes for each pair of samples).
    pub variance: bool,
}

impl Default for BuildSettings {
    fn default() -> Self {
        Self {
            trajectories: 900,
            np: 10,
            iterations: 100,
            tolerance: 1e-9,
            trigger_px: 20.0,
            guide_after: 100,
            adapt_after: 0.5,
            adapt_share: 0.5,
            batch: 32,
            way_point: WayPoint::Sight(0.25),
            planner: true,
            sample_spacing: 0.01,
            seed: 1,
            grow: BTreeMap::new(),
            regression: RegressionSettings::default(),
        }
    }
}

impl Default for RegressionSettings {
    fn default() -> Self {
        Self {
            samples: 800,
            zone: 2.0,
            likelihood_samples: 400,
            restarts: 3,
            polish: 0,
            variance: false,
        }
    }
}

/// A setting outside its range.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{name} = {value}; allowed: {allowed}")]
pub struct SettingError {
    /// Name of the setting.
    pub name: &'static str,
    /// What was found.
    pub value: String,
    /// What is allowed.
    pub allowed: &'static str,
}

impl BuildSettings {
    /// The scene in which trajectories are made: with the grown occlusions, each part about its own centre. What keeps
    /// clear of those keeps clear of the scene's, so that the memory is one for the scene; it bears its fingerprint, and
    /// these settings in its provenance.
    ///
    /// # Errors
    /// [`SettingError`] where a name is not the scene's, or a factor out of its range.
    pub fn grown(&self, scene: &Scene) -> Result<Scene, SettingError> {
        let mut grown = scene.clone();
        let mut most: f64 = 0.0;
        for (name, &factor) in &self.grow {
            let refused = |allowed| SettingError {
                name: "grow",
                value: format!("{name}={factor}"),
                allowed,
            };
            if !(1.0..=3.0).contains(&factor) {
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
        // Starts keep their distance from what is there, not from what is drawn: else nothing would be known of those
        // that are close.
        grown.starts.clearance_px = (grown.starts.clearance_px - most).max(0.0);
        Ok(grown)
    }

    /// Checks every setting.
    ///
    /// # Errors
    /// [`SettingError`] names the first one that is wrong.
    pub fn check(&self) -> Result<(), SettingError> {
        let range = |name, value: f64, low: f64, high: f64, allowed| {
            if (low..=high).contains(&value) {
                Ok(())
            } else {
                Err(SettingError {
                    name,
                    value: value.to_string(),
                    allowed,
                })
            }
        };
        let r = &self.regression;
        range(
            "trajectories",
            self.trajectories as f64,
            1.0,
            1e5,
            "1 to 100000",
        )?;
        range("np", self.np as f64, 1.0, vpc::MAX_NP as f64, "1 to 40")?;
        range(
            "iterations",
            f64::from(self.iterations),
            1.0,
            1000.0,
            "1 to 1000",
        )?;
        range("tolerance", self.tolerance, 1e-15, 1.0, "1e-15 to 1")?;
        range("trigger_px", self.trigger_px, 0.0, 1e4, "0 to 1e4 px")?;
        range("adapt_after", self.adapt_after, 0.0, 1.0, "0 to 1")?;
        range("adapt_share", self.adapt_share, 0.0, 1.0, "0 to 1")?;
        range("batch", self.batch as f64, 1.0, 4096.0, "1 to 4096")?;
        range(
            "sample_spacing",
            self.sample_spacing,
            0.0,
            1.0,
            "0 to 1 (share of the image width)",
        )?;
        range(
            "regression.samples",
            r.samples as f64,
            2.0,
            2e4,
            "2 to 20000",
        )?;
        range("regression.zone", r.zone, 1.0, 1e6, "1 to 1e6")?;
        range(
            "regression.likelihood_samples",
            r.likelihood_samples as f64,
            2.0,
            4000.0,
            "2 to 4000",
        )?;
        range(
            "regression.restarts",
            r.restarts as f64,
            1.0,
            100.0,
            "1 to 100",
        )?;
        match self.way_point {
            WayPoint::Samples(ahead) => range(
                "way_point.samples",
                ahead as f64,
                1.0,
                1e4,
                "1 to 10000 control periods",
            ),
            WayPoint::Sight(share) => range(
                "way_point.sight",
                share,
                1e-3,
                1.0,
                "0.001 to 1 (share of the image width)",
            ),
        }
    }

    /// When the solver stops.
    pub fn solver(&self) -> SolverOptions {
        SolverOptions {
            max_iterations: self.iterations,
            tolerance: self.tolerance,
        }
    }

    /// The model that previews use: exact, since the builder knows the pattern.
    pub const MODEL: Model = Model::Pose;
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_defaults_are_the_papers_and_valid() {
        let settings = BuildSettings::default();
        assert_eq!(settings.check(), Ok(()));
        assert_eq!(
            (settings.trajectories, settings.np, settings.iterations),
            (900, 10, 100)
        );
    }

    #[test]
    fn a_setting_out_of_range_is_named() {
        let settings = BuildSettings {
            tolerance: f64::NAN,
            ..Default::default()
        };
        let message = settings.check().unwrap_err().to_string();
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
