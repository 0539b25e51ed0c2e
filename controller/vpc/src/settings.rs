//! Settings of the law.

use core::fmt;

#[cfg(feature = "file")]
use alloc::string::ToString;

#[cfg(feature = "file")]
use serde::{Deserialize, Serialize};

use crate::prediction::Model;
use crate::problem::SolverOptions;
#[cfg(feature = "file")]
use crate::strategy::{self, Allowed};
use crate::strategy::{MAX_NEIGHBOURS, Strategy};
use crate::task::TaskError;
use crate::{MAX_NC, MAX_NP, Twist};

/// Declares the settings: what [`Settings`], its default, [`Settings::check`] and, with the feature
/// `file`, table `[law]` of the configuration of `vpcd` and its JSON Schema have in common.
/// `#[allowed(..)]` gives the least and the greatest value and the unit; `#[key(..)]` is
/// `#[schemars(..)]` with the feature `file`, and nothing without it.
macro_rules! settings {
    ($(#[$meta:meta])* pub struct $name:ident {$(
        $(#[doc = $text:literal])+
        #[default($default:expr)]
        $(#[allowed($low:literal to $high:literal $(, $unit:literal)?)])?
        $(#[key($($key:tt)*)])?
        $(#[with = $with:literal])?
        pub $field:ident: $type:ty,
    )+}) => {
        $(#[$meta])*
        #[derive(Clone, Copy, Debug, PartialEq)]
        #[cfg_attr(feature = "file", derive(Serialize, Deserialize, schemars::JsonSchema))]
        #[cfg_attr(feature = "file", serde(deny_unknown_fields, default = "Settings::daemon"))]
        pub struct $name {$(
            $(#[doc = $text])+
            $(#[cfg_attr(feature = "file", schemars(
                range(min = $low, max = $high) $(, extend("x-unit" = $unit))?
            ))])?
            $(#[cfg_attr(feature = "file", schemars($($key)*))])?
            $(#[cfg_attr(feature = "file", serde(with = $with))])?
            pub $field: $type,
        )+}

        impl Default for $name {
            /// The paper's on-line settings for its simulations.
            fn default() -> Self {
                Self {$($field: $default,)+}
            }
        }

        impl $name {
            /// Checks each setting for itself.
            fn check_ranges(&self) -> Result<(), SettingsError> {
                $($(in_range(
                    stringify!($field),
                    self.$field as f64,
                    [$low as f64, $high as f64],
                    concat!(stringify!($low), " to ", stringify!($high) $(, " ", $unit)?),
                )?;)?)+
                Ok(())
            }
        }
    };
}

settings! {
    /// The control law.
    pub struct Settings {
        /// How the goal is reached. `foresight` simulates whole futures over the memory between two
        /// frames and follows the best. The paper's strategies take warm start and target from the
        /// previous cycle (`previous`), the nearest sample of the memory (`knn`), the mean of
        /// several (`knn5`), or regression over the memory (`gpr`). `ibvs` is the classic law
        /// without prediction. `follow` has no goal: it sends the nearest allowed twist to that of
        /// `vpc/desired`. Flag: --strategy.
        #[default(Strategy::Previous)]
        #[key(
            with = "alloc::string::String",
            extend("enum" = strategy::words(), "x-allowed" = Allowed.to_string())
        )]
        #[with = "strategy::word"]
        pub strategy: Strategy,
        /// Steps predicted. Flag: --np.
        #[default(3)]
        #[allowed(1 to 40)]
        pub np: usize,
        /// Length of a step; longer for slower cameras and, far from the target, for slow stops. Flag
        /// of `cargo table`: --step-s.
        #[default(0.033)]
        #[allowed(0.001 to 10, "s")]
        pub step_s: f64,
        /// Free commands in the prediction; the last is held.
        #[default(1)]
        #[allowed(1 to 4)]
        #[key(extend("x-allowed" = FREE_COMMANDS))]
        pub nc: usize,
        /// Most iterations of the solver.
        #[default(10)]
        #[allowed(1 to 1000)]
        pub iterations: u32,
        /// Optimality at which the solver stops.
        #[default(1e-3)]
        #[allowed(1e-15 to 1)]
        pub tolerance: f64,
        /// Whether constraints also hold between the sampling instants of the next period; in the
        /// paper they do not.
        #[default(true)]
        pub intersample: bool,
        /// How features are predicted.
        #[default(Model::Pose)]
        pub model: Model,
        /// Most steps that foresight simulates between two frames, within a fifth of the control
        /// period.
        #[default(150)]
        #[allowed(1 to 1e5)]
        pub foresight_steps: u32,
        /// Distance of a feature, or of a sized marker's edge, from an occlusion at which the
        /// memory is queried.
        #[default(20.0)]
        #[allowed(0 to 1e4, "px")]
        pub trigger_px: f64,
        /// The memory is queried until every feature is this many times `trigger_px` away.
        #[default(2.0)]
        #[allowed(1 to 100)]
        pub hysteresis: f64,
        /// Clearance of each feature, or of a sized marker's edge, from every border.
        #[default(0.0)]
        #[allowed(0 to 1e3, "px")]
        pub margin_px: f64,
        /// Weight of the command's change per period, as a share of R; 0 in the paper.
        #[default(0.03)]
        #[allowed(0 to 10)]
        pub change_share: f64,
        /// Time constant of the feature filter; 0: no filter, as in the paper.
        #[default(0.15)]
        #[allowed(0 to 10, "s")]
        pub filter_s: f64,
        /// Greatest distance of a filtered feature from the measured one: about three times the
        /// noise.
        #[default(1.0)]
        #[allowed(0 to 100, "px")]
        pub filter_px: f64,
        /// Gain of ibvs.
        #[default(0.5)]
        #[allowed(1e-6 to 100, "per s")]
        pub lambda: f64,
        /// Whether the commands sent since the exposure advance the features to now.
        #[default(true)]
        pub delay_compensation: bool,
        /// Whether the law learns how the pattern moves by itself, as on a conveyor or in a hand, and
        /// follows it. Flag of `cargo table`: --no-drift.
        #[default(true)]
        pub drift_compensation: bool,
        /// Longest time for which the law goes on while points are hidden, s; 0: not at all. The
        /// daemon takes `safety.blind_s`.
        #[default(1.0)]
        #[allowed(0 to 1, "s")]
        #[key(skip)]
        pub blind_s: f64,
        /// Time in which a component of the twist goes from zero to its limit, where the scene
        /// gives no limit of acceleration; 0: at once. The daemon takes `safety.brake_s`.
        #[default(0.0)]
        #[allowed(0 to 10, "s")]
        #[key(skip)]
        pub brake_s: f64,
    }
}

// The literals above.
const _: () = assert!(MAX_NP == 40 && MAX_NC == 4);

/// What is allowed for `nc`.
const FREE_COMMANDS: &str = "1 to 4, at most np";

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
        self.check_ranges()?;
        let most_nc = MAX_NC.min(self.np) as f64;
        in_range("nc", self.nc as f64, [1.0, most_nc], FREE_COMMANDS)?;
        match self.strategy {
            Strategy::Knn { k } => in_range("k", k as f64, [1.0, MAX_NEIGHBOURS as f64], "1 to 64"),
            _ => Ok(()),
        }
    }

    /// The defaults of `vpcd`: the paper's, with foresight.
    pub fn daemon() -> Self {
        Self {
            strategy: Strategy::Foresight,
            ..Self::default()
        }
    }

    /// When the solver stops.
    pub fn solver(&self) -> SolverOptions {
        SolverOptions {
            max_iterations: self.iterations,
            tolerance: self.tolerance,
            intersample: self.intersample,
        }
    }
}

fn in_range(
    name: &'static str,
    value: f64,
    [low, high]: [f64; 2],
    allowed: &'static str,
) -> Result<(), SettingsError> {
    // A NaN is in no range.
    if (low..=high).contains(&value) {
        return Ok(());
    }
    Err(SettingsError::Range {
        name,
        value,
        allowed,
    })
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
            check(|s| s.tolerance = -1.0)
                .unwrap_err()
                .contains("tolerance = -1")
        );
    }
}
