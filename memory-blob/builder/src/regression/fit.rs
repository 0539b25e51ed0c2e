//! From samples to a fitted process.

use super::inputs::Inputs;
use super::likelihood::{Factor, Likelihood, NotPositiveDefinite};
use super::search::{draw_subset, first_start, search};
use super::{FitSettings, Kernel, moments};

/// A column whose deviation is below this share of its size is constant up to rounding.
const CONSTANT: f64 = 1e-12;

/// A fitted process. Symbols: see the [module](super).
#[derive(Clone, Debug)]
pub struct Fit {
    /// The hyper-parameters.
    pub kernel: Kernel,
    /// What was added to the diagonal besides phi_s for the factor to exist, in squared output
    /// scales; mostly 0.
    pub jitter: f64,
    /// L (nats) of all samples, over the outputs that vary, after division by their scales.
    pub log_marginal_likelihood: f64,
    /// What each output less its mean was divided by, p values, above 0.
    pub output_scales: Vec<f64>,
    /// Lambda, D rows of p, in units of the outputs.
    pub lambda: Vec<Vec<f64>>,
    /// The Cholesky factor of K + (phi_s + jitter) I: lower triangle, row after row, D (D + 1) / 2
    /// values.
    pub cholesky: Vec<f64>,
    /// Evaluations of the likelihood with gradient, over all starts.
    pub evaluations: usize,
}

/// Fits a process with constant mean `mean` (p values) to as many rows of `inputs` (n values,
/// already scaled) as of `outputs` (p values), all finite and at least one.
///
/// # Errors
/// [`NotPositiveDefinite`] when the covariance cannot be factorised.
pub fn fit(
    inputs: &[Vec<f64>],
    outputs: &[Vec<f64>],
    mean: &[f64],
    settings: &FitSettings,
) -> Result<Fit, NotPositiveDefinite> {
    let differences = faer::Mat::from_fn(outputs.len(), mean.len(), |row, column| {
        outputs[row][column] - mean[column]
    });
    let output_scales = match &settings.output_scales {
        Some(scales) => scales.clone(),
        None => differences.col_iter().map(root_mean_square).collect(),
    };
    let varying: Vec<usize> = (0..mean.len())
        .filter(|&column| varies(outputs, column))
        .collect();
    let scaled = |rows: &[usize]| {
        let y = faer::Mat::from_fn(rows.len(), varying.len(), |row, at| {
            differences[(rows[row], varying[at])] / output_scales[varying[at]]
        });
        Likelihood::new(Inputs::of(rows.iter().map(|&row| &inputs[row])), y)
    };

    let all: Vec<usize> = (0..inputs.len()).collect();
    let (kernel, evaluations, log_marginal_likelihood) = if varying.is_empty() {
        // Nothing to learn a kernel from: any will do.
        let any = Kernel::from_logarithms(&first_start(inputs, &settings.bounds));
        (any, 0, 0.0)
    } else {
        let (whole, subset) = (scaled(&all), scaled(&draw_subset(inputs.len(), settings)));
        let (kernel, evaluations) = search(inputs, &subset, &whole, settings);
        let value = whole.value(&kernel)?;
        (kernel, evaluations, value)
    };
    let columns = Inputs::of(inputs).scaled(&kernel);
    let factor = Factor::new(&columns.covariance(kernel.signal_variance), &kernel)?;
    let mut weights = differences;
    factor.solve_in_place(&mut weights);
    let packed = all
        .iter()
        .flat_map(|&row| (0..=row).map(move |column| (row, column)));
    Ok(Fit {
        jitter: factor.jitter,
        log_marginal_likelihood,
        output_scales,
        lambda: all
            .iter()
            .map(|&row| weights.row(row).iter().copied().collect())
            .collect(),
        cholesky: packed.map(|at| factor.lower[at]).collect(),
        evaluations,
        kernel,
    })
}

fn root_mean_square(column: faer::ColRef<'_, f64>) -> f64 {
    let square = column.iter().map(|d| d * d).sum::<f64>() / column.nrows() as f64;
    if square.is_normal() {
        square.sqrt()
    } else {
        1.0
    }
}

fn varies(outputs: &[Vec<f64>], column: usize) -> bool {
    let (mean, deviation) = moments(outputs.iter().map(|row| row[column]));
    deviation > CONSTANT * mean.abs().max(f64::MIN_POSITIVE)
}
