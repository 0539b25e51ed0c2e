//! The kernel: radial basis function with one length scale an input, and one noise.

/// Hyper-parameters. Variances are in squared output scales, length scales in the units of the
/// (scaled) inputs.
#[derive(Clone, Debug, PartialEq)]
pub struct Kernel {
    /// l_i, one an input, above 0.
    pub length_scales: Vec<f64>,
    /// phi_o^2, above 0.
    pub signal_variance: f64,
    /// phi_s, at least 0.
    pub noise_variance: f64,
}

impl Kernel {
    /// From (ln l_1, ..., ln l_n, ln phi_o, ln phi_s): the variables of the search. `logarithms`
    /// has n + 2 entries.
    pub fn from_logarithms(logarithms: &[f64]) -> Self {
        let (lengths, rest) = logarithms.split_at(logarithms.len().saturating_sub(2));
        let variance = |at: usize, factor: f64| rest.get(at).map_or(0.0, |v| (factor * v).exp());
        Self {
            length_scales: lengths.iter().map(|l| l.exp()).collect(),
            signal_variance: variance(0, 2.0),
            noise_variance: variance(1, 1.0),
        }
    }
}
