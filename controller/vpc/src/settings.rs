//! Settings of the law.

use core::fmt;

use crate::prediction::Model;
use crate::problem::SolverOptions;
use crate::strategy::{MAX_NEIGHBOURS, Strategy};
use crate::task::TaskError;
use crate::{MAX_NC, MAX_NP, Twist};

/// Settings of the law; [`Settings::check`] accepts what [`crate::Law`] runs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// Where warm start and target come from.
    pub strategy: Strategy,
    /// Steps previewed, 1 to 40.
    pub np: usize,
    /// Length of a step, s; never shorter than the sampling time and a stop from the limits.
    pub step_s: f64,
    /// Free commands, 1 to 4 and at most `np`.
    pub nc: usize,
    /// When the solver stops.
    pub solver: SolverOptions,
    /// How features are predicted.
    pub model: Model,
    /// The memory is asked from here on: clearance of any feature, with its marker, from an
    /// occlusion, px.
    pub trigger_px: f64,
    /// The memory is asked until every feature is this many times further away than `trigger_px`,
    /// at least 1.
    pub hysteresis: f64,
    /// Extra clearance kept from every border by each feature with its marker, px.
    pub margin_px: f64,
    /// Weight of the change of the command from one period to the next, as a share of R.
    pub change_share: f64,
    /// Time constant of the filter of the features, s; 0: no filter, and the target is corrected by
    /// the mismatch instead, as in the paper.
    pub filter_s: f64,
    /// Greatest distance of a filtered feature from the measured one, px.
    pub filter_px: f64,
    /// Gain of the classic law, 1/s.
    pub lambda: f64,
    /// Most steps that foresight simulates in a cycle; never more than a fifth of the sampling time
    /// has room for.
    pub foresight_steps: u32,
    /// Time in which a component of the twist goes from zero to its limit, s, where the scene gives
    /// no limit of acceleration; 0: at once.
    pub brake_s: f64,
    /// Whether features are advanced from their exposure to the instant at which the command takes
    /// effect.
    pub delay_compensation: bool,
}

impl Default for Settings {
    /// The paper's on-line settings for its simulations.
    fn default() -> Self {
        Self {
            strategy: Strategy::Previous,
            np: 3,
            step_s: 0.033,
            nc: 1,
            solver: SolverOptions {
                max_iterations: 10,
                tolerance: 1e-3,
                intersample: true,
            },
            model: Model::Pose,
            trigger_px: 20.0,
            hysteresis: 2.0,
            margin_px: 0.0,
            change_share: 0.03,
            filter_s: 0.15,
            filter_px: 1.0,
            lambda: 0.5,
            foresight_steps: 150,
            brake_s: 0.0,
            delay_compensation: true,
        }
    }
}

/// Why a law cannot be set up.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum SettingsError {
    /// The scene gives no task.
    #[error(transparent)]
    Task(#[from] TaskError),
    /// A setting is outside its range.
    #[error("{name} = {value}; allowed: {allowed}")]
    #[allow(missing_docs)]
    Range {
        name: &'static str,
        value: f64,
        allowed: &'static str,
    },
    /// The window is too long for the scene, the iterations and the period.
    #[error(
        "np = {np} with nc = {nc}, {points} points, {obstacles} parts and areas of occlusions: more work than a period of \
         {period_ms:.1} ms has room for; allowed: {}fewer iterations, or a slower camera",
        Shorter(*most)
    )]
    #[allow(missing_docs)]
    Window {
        np: usize,
        nc: usize,
        points: usize,
        obstacles: usize,
        period_ms: f64,
        most: usize,
    },
    /// The workspace that the caller lends is too short.
    #[error("workspace: {found} numbers; allowed: {needed} or more")]
    #[allow(missing_docs)]
    Workspace { found: usize, needed: usize },
}

/// The advice to take a shorter window, where one fits.
struct Shorter(usize);

impl fmt::Display for Shorter {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.0 {
            0 => Ok(()),
            most => write!(f, "np of at most {most}, or "),
        }
    }
}

impl Settings {
    /// Greatest change of each component of the twist in a second, m/s^2 and rad/s^2: the scene's,
    /// else from zero to the limit in `brake_s`; infinite where that is 0.
    pub fn acceleration(&self, limits: &scene::Limits) -> Twist {
        let mut acceleration = limits.acceleration();
        for (most, limit) in acceleration.iter_mut().zip(limits.velocity()) {
            if most.is_infinite() {
                *most = limit / self.brake_s;
            }
        }
        acceleration
    }

    /// Checks every setting.
    ///
    /// # Errors
    /// [`SettingsError::Range`] names the first one that is wrong.
    pub fn check(&self) -> Result<(), SettingsError> {
        let k = match self.strategy {
            Strategy::Knn { k } => k as f64,
            _ => 1.0,
        };
        let (most_np, most_k) = (MAX_NP as f64, MAX_NEIGHBOURS as f64);
        let most_nc = MAX_NC.min(self.np) as f64;
        let iterations = f64::from(self.solver.max_iterations);
        let ranges = [
            ("np", self.np as f64, 1.0, most_np, "1 to 40"),
            ("step_s", self.step_s, 1e-3, 10.0, "0.001 to 10 s"),
            ("nc", self.nc as f64, 1.0, most_nc, "1 to 4, at most np"),
            ("iterations", iterations, 1.0, 1e3, "1 to 1000"),
            ("tolerance", self.solver.tolerance, 1e-15, 1.0, "1e-15 to 1"),
            ("trigger_px", self.trigger_px, 0.0, 1e4, "0 to 1e4 px"),
            ("hysteresis", self.hysteresis, 1.0, 100.0, "1 to 100"),
            ("margin_px", self.margin_px, 0.0, 1e3, "0 to 1e3 px"),
            ("change_share", self.change_share, 0.0, 10.0, "0 to 10"),
            ("filter_s", self.filter_s, 0.0, 10.0, "0 to 10 s"),
            ("filter_px", self.filter_px, 0.0, 100.0, "0 to 100 px"),
            ("lambda", self.lambda, 1e-6, 100.0, "1e-6 to 100 per s"),
            (
                "foresight_steps",
                f64::from(self.foresight_steps),
                1.0,
                1e5,
                "1 to 1e5",
            ),
            ("brake_s", self.brake_s, 0.0, 10.0, "0 to 10 s"),
            ("k", k, 1.0, most_k, "1 to 64"),
        ];
        for (name, value, low, high, allowed) in ranges {
            // A NaN is in no range.
            if !(low..=high).contains(&value) {
                return Err(SettingsError::Range {
                    name,
                    value,
                    allowed,
                });
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_shorter_window_is_advised_only_where_one_fits() {
        let message = |most| {
            let refused = SettingsError::Window {
                np: 9,
                nc: 1,
                points: 4,
                obstacles: 6,
                period_ms: 4.0,
                most,
            };
            refused.to_string()
        };
        assert!(
            message(5)
                .ends_with("allowed: np of at most 5, or fewer iterations, or a slower camera")
        );
        assert!(message(0).ends_with("allowed: fewer iterations, or a slower camera"));
    }

    #[test]
    fn settings_out_of_range_are_named() {
        let check = |change: fn(&mut Settings)| {
            let mut settings = Settings::default();
            change(&mut settings);
            settings.check().map_err(|e| e.to_string())
        };
        assert_eq!(check(|_| ()), Ok(()));
        assert_eq!(
            check(|s| s.np = 41).unwrap_err(),
            "np = 41; allowed: 1 to 40"
        );
        assert_eq!(
            check(|s| s.nc = 4).unwrap_err(),
            "nc = 4; allowed: 1 to 4, at most np"
        );
        assert!(
            check(|s| s.trigger_px = f64::NAN)
                .unwrap_err()
                .contains("NaN")
        );
        assert!(
            check(|s| s.solver.tolerance = -1.0)
                .unwrap_err()
                .contains("tolerance = -1")
        );
    }
}
