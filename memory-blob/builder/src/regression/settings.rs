//! How a process is fitted, and what must hold of the settings.

use super::RegressionError;
use crate::lbfgs;

/// What each output is divided by before the likelihood is taken.
#[derive(Clone, Debug, PartialEq, Default)]
pub enum OutputScale {
    /// The root mean square of its difference to the mean m, or 1 if that is zero.
    #[default]
    RootMeanSquare,
    /// These, one an output, above 0, in its own units.
    Given(Vec<f64>),
}

/// Box of the search: each pair is (lowest, highest), above 0.
#[derive(Clone, Debug, PartialEq)]
pub struct HyperBounds {
    /// Every l_i, in units of the scaled inputs. An input that does not matter ends at the upper
    /// bound.
    pub length_scale: (f64, f64),
    /// phi_o (a deviation, not a variance), in output scales.
    pub signal_deviation: (f64, f64),
    /// phi_s (a variance), in squared output scales.
    pub noise_variance: (f64, f64),
}

impl Default for HyperBounds {
    fn default() -> Self {
        Self {
            length_scale: (1e-2, 1e3),
            signal_deviation: (1e-2, 1e2),
            noise_variance: (1e-6, 1e1),
        }
    }
}

/// How a process is fitted.
#[derive(Clone, Debug, PartialEq)]
pub struct FitSettings {
    /// Seed of the subset and of the starts.
    pub seed: u64,
    /// Random starts besides the first, which is one spread of the inputs for every length scale; 0
    /// or more.
    pub restarts: usize,
    /// Samples that the hyper-parameters are searched on, at least 2; Lambda is always computed on
    /// all.
    pub subset: usize,
    /// Evaluations on all samples that then improve on the best of the subset, each of which costs
    /// about 4 D^3 operations; 0 leaves the hyper-parameters of the subset.
    pub polish: usize,
    /// What the outputs are divided by.
    pub output_scale: OutputScale,
    /// Where the hyper-parameters may lie.
    pub bounds: HyperBounds,
    /// When each start ends; the function is the negative likelihood divided by the number of
    /// output values.
    pub search: lbfgs::Settings,
}

impl Default for FitSettings {
    fn default() -> Self {
        Self {
            seed: 0,
            restarts: 3,
            subset: 400,
            polish: 20,
            output_scale: OutputScale::default(),
            bounds: HyperBounds::default(),
            search: lbfgs::Settings {
                gradient_tolerance: 1e-5,
                value_tolerance: 1e-7,
                ..lbfgs::Settings::default()
            },
        }
    }
}

impl FitSettings {
    /// Everything but the output scales, which are checked beside the outputs.
    pub(super) fn check(&self) -> Result<(), RegressionError> {
        let counts = [
            ("subset", self.subset, 2, "at least 2"),
            ("search.memory", self.search.memory, 1, "at least 1"),
            (
                "search.max_iterations",
                self.search.max_iterations,
                1,
                "at least 1",
            ),
            (
                "search.max_evaluations",
                self.search.max_evaluations,
                1,
                "at least 1",
            ),
        ];
        for (name, count, least, allowed) in counts {
            if count < least {
                let value = count as f64;
                return Err(RegressionError::Setting {
                    name,
                    value,
                    allowed,
                });
            }
        }
        positive("search.largest_step", self.search.largest_step)?;
        let bounds = &self.bounds;
        let pairs = [
            ("length_scale", bounds.length_scale),
            ("signal_deviation", bounds.signal_deviation),
            ("noise_variance", bounds.noise_variance),
        ];
        for (name, (low, high)) in pairs {
            positive(name, low)?;
            positive(name, high)?;
            if low > high {
                let allowed = "a lower bound that is not above the upper bound";
                return Err(RegressionError::Setting {
                    name,
                    value: low,
                    allowed,
                });
            }
        }
        Ok(())
    }
}

pub(super) fn positive(name: &'static str, value: f64) -> Result<(), RegressionError> {
    let allowed = "above 0 and finite";
    let fine = value.is_normal() && value > 0.0;
    if fine {
        Ok(())
    } else {
        Err(RegressionError::Setting {
            name,
            value,
            allowed,
        })
    }
}
