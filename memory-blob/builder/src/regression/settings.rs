//! How a process is fitted.

use crate::lbfgs;

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
    /// Random starts besides the first, which is one spread of the inputs for every length scale.
    pub restarts: usize,
    /// Samples that the hyper-parameters are searched on, at least 2; Lambda is always computed on
    /// all.
    pub subset: usize,
    /// Evaluations on all samples that then improve on the best of the subset, each of which costs
    /// about 4 D^3 operations; 0 leaves the hyper-parameters of the subset.
    pub polish: usize,
    /// What each output less its mean is divided by before the likelihood is taken, above 0; by
    /// default its root mean square, or 1 if that is zero.
    pub output_scales: Option<Vec<f64>>,
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
            output_scales: None,
            bounds: HyperBounds::default(),
            search: lbfgs::Settings {
                gradient_tolerance: 1e-5,
                value_tolerance: 1e-7,
                ..lbfgs::Settings::default()
            },
        }
    }
}
