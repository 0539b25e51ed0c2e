//! From samples to a fitted process.

use super::inputs::Inputs;
use super::likelihood::{Factor, Likelihood};
use super::search::{draw_subset, first_start, search};
use super::settings::positive;
use super::{FitSettings, Kernel, Matrix, OutputScale, RegressionError, moments};

/// A column whose deviation is below this share of its size is constant up to rounding.
const CONSTANT: f64 = 1e-12;

/// A fitted process. Symbols: see the [module](super).
#[derive(Clone, Debug)]
pub struct Fit {
    /// l_i, n values, in units of the scaled inputs.
    pub length_scales: Vec<f64>,
    /// phi_o^2, in squared output scales.
    pub signal_variance: f64,
    /// phi_s, in squared output scales.
    pub noise_variance: f64,
    /// What was added to the diagonal besides phi_s for the factor to exist, in squared output
    /// scales; mostly 0.
    pub jitter: f64,
    /// L (nats) of all samples, over the outputs that vary, after division by their scales.
    pub log_marginal_likelihood: f64,
    /// m, p values, in units of the outputs.
    pub mean: Vec<f64>,
    /// What each output was divided by, p values, above 0.
    pub output_scales: Vec<f64>,
    /// Lambda, D x p, in units of the outputs.
    pub lambda: Matrix,
    /// The Cholesky factor of K + (phi_s + jitter) I: lower triangle, row after row, D (D + 1) / 2
    /// values.
    pub cholesky: Vec<f64>,
    /// Evaluations of the likelihood with gradient, over all starts.
    pub evaluations: usize,
}

/// Fits a process with constant mean `mean` (p values) to D x n `inputs`, already scaled, and D x p
/// `outputs`.
///
/// # Errors
/// [`RegressionError`] when sizes do not agree, a value is not finite, a setting is out of range,
/// or the covariance cannot be factorised.
pub fn fit(
    inputs: &Matrix,
    outputs: &Matrix,
    mean: &[f64],
    settings: &FitSettings,
) -> Result<Fit, RegressionError> {
    check(inputs, outputs, mean, settings)?;
    let differences = faer::Mat::from_fn(outputs.rows(), outputs.columns(), |row, column| {
        outputs.row(row)[column] - mean[column]
    });
    let output_scales = match &settings.output_scale {
        OutputScale::Given(scales) => scales.clone(),
        OutputScale::RootMeanSquare => root_mean_squares(&differences),
    };
    let varying: Vec<usize> = (0..outputs.columns())
        .filter(|&column| varies(outputs, column))
        .collect();
    let scaled = |rows: &[usize]| -> Result<Likelihood, RegressionError> {
        let x = rows
            .iter()
            .flat_map(|&row| inputs.row(row))
            .copied()
            .collect();
        let value = |row, &column| differences[(row, column)] / output_scales[column];
        let y = rows
            .iter()
            .flat_map(|&row| varying.iter().map(move |column| value(row, column)));
        Likelihood::new(
            &Matrix::new("inputs", inputs.columns(), x)?,
            &Matrix::new("scaled outputs", varying.len(), y.collect())?,
        )
    };

    let all: Vec<usize> = (0..inputs.rows()).collect();
    let (kernel, evaluations, log_marginal_likelihood) = if varying.is_empty() {
        // nothing to learn a kernel from: any will do
        (
            Kernel::from_logarithms(&first_start(inputs, &settings.bounds)),
            0,
            0.0,
        )
    } else {
        let whole = scaled(&all)?;
        let subset = scaled(&draw_subset(inputs.rows(), settings))?;
        let (kernel, evaluations) = search(inputs, &subset, &whole, settings);
        let value = whole.value(&kernel)?;
        (kernel, evaluations, value)
    };
    let columns = Inputs::new(inputs).scaled(&kernel);
    let factor = Factor::new(&columns.covariance(kernel.signal_variance), &kernel)?;
    let mut weights = differences;
    factor.solve_in_place(&mut weights);
    let lambda = all
        .iter()
        .flat_map(|&row| weights.row(row).iter().copied())
        .collect();
    let packed = all
        .iter()
        .flat_map(|&row| (0..=row).map(move |column| (row, column)));
    Ok(Fit {
        length_scales: kernel.length_scales,
        signal_variance: kernel.signal_variance,
        noise_variance: kernel.noise_variance,
        jitter: factor.jitter,
        log_marginal_likelihood,
        mean: mean.to_vec(),
        output_scales,
        lambda: Matrix::new("Lambda", outputs.columns(), lambda)?,
        cholesky: packed.map(|at| factor.lower[at]).collect(),
        evaluations,
    })
}

fn root_mean_squares(differences: &faer::Mat<f64>) -> Vec<f64> {
    let rows = differences.nrows() as f64;
    let square = |c: faer::ColRef<'_, f64>| c.iter().map(|d| d * d).sum::<f64>() / rows;
    let scale = |square: f64| {
        if square.is_normal() {
            square.sqrt()
        } else {
            1.0
        }
    };
    differences
        .col_iter()
        .map(|column| scale(square(column)))
        .collect()
}

fn varies(outputs: &Matrix, column: usize) -> bool {
    let (mean, deviation) = moments(outputs.column(column));
    deviation > CONSTANT * mean.abs().max(f64::MIN_POSITIVE)
}

fn check(
    inputs: &Matrix,
    outputs: &Matrix,
    mean: &[f64],
    settings: &FitSettings,
) -> Result<(), RegressionError> {
    let size = |name, what, found: usize, wanted: usize| {
        let expected = format!("{wanted} are needed");
        if found == wanted {
            Ok(())
        } else {
            Err(RegressionError::Size {
                name,
                what,
                found,
                expected,
            })
        }
    };
    size("outputs", "rows", outputs.rows(), inputs.rows())?;
    size("mean", "values", mean.len(), outputs.columns())?;
    Matrix::new("mean", mean.len(), mean.to_vec())?;
    if let OutputScale::Given(scales) = &settings.output_scale {
        size("output_scale", "values", scales.len(), outputs.columns())?;
        for &value in scales {
            positive("output_scale", value)?;
        }
    }
    settings.check()
}
