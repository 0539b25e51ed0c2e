//! Tests of the regression: against scikit-learn, against finite differences, and at the edges.

use super::*;
use serde::Deserialize;

impl Kernel {
    /// The inverse of [`Self::from_logarithms`].
    fn logarithms(&self) -> Vec<f64> {
        let lengths = self.length_scales.iter().map(|l| l.ln());
        lengths
            .chain([0.5 * self.signal_variance.ln(), self.noise_variance.ln()])
            .collect()
    }

    /// k(a, b) without noise.
    fn value(&self, a: &[f64], b: &[f64]) -> f64 {
        let terms = a.iter().zip(b).zip(&self.length_scales);
        let square: f64 = terms.map(|((a, b), l)| ((a - b) / l).powi(2)).sum();
        self.signal_variance * (-0.5 * square).exp()
    }
}

/// See `fixtures/gpr_likelihood.py`.
#[derive(Deserialize)]
struct Fixture {
    inputs: Vec<Vec<f64>>,
    outputs: Vec<Vec<f64>>,
    mean: Vec<f64>,
    output_scales: Vec<f64>,
    fixed: Fixed,
    best: Best,
}

#[derive(Deserialize)]
struct Fixed {
    length_scales: Vec<f64>,
    signal_variance: f64,
    noise_variance: f64,
    log_marginal_likelihood: f64,
    gradient: Vec<f64>,
    queries: Vec<Vec<f64>>,
    means: Vec<Vec<f64>>,
    variances: Vec<f64>,
}

#[derive(Deserialize)]
struct Best {
    log_marginal_likelihood: f64,
}

impl Fixture {
    fn read() -> Self {
        serde_json::from_str(include_str!("../../fixtures/gpr_likelihood.json")).unwrap()
    }

    fn likelihood(&self) -> Likelihood {
        let y = faer::Mat::from_fn(self.outputs.len(), self.mean.len(), |row, column| {
            (self.outputs[row][column] - self.mean[column]) / self.output_scales[column]
        });
        Likelihood::new(Inputs::of(&self.inputs), y)
    }

    fn kernel(&self) -> Kernel {
        Kernel {
            length_scales: self.fixed.length_scales.clone(),
            signal_variance: self.fixed.signal_variance,
            noise_variance: self.fixed.noise_variance,
        }
    }

    fn settings(&self) -> FitSettings {
        FitSettings {
            output_scales: Some(self.output_scales.clone()),
            ..FitSettings::default()
        }
    }

    fn fit(&self, settings: &FitSettings) -> Fit {
        fit(&self.inputs, &self.outputs, &self.mean, settings).unwrap()
    }
}

use likelihood::{Inputs, Likelihood};

/// What the process says about one query: the reference that the fast query of `memory-blob` is
/// written after. Variance of the function without noise, in squared output scales.
struct Prediction {
    mean: Vec<f64>,
    variance: f64,
}

fn predict(fit: &Fit, inputs: &[Vec<f64>], mean: &[f64], query: &[f64]) -> Prediction {
    let k: Vec<f64> = inputs.iter().map(|x| fit.kernel.value(query, x)).collect();
    let mut mean = mean.to_vec();
    for (row, k) in fit.lambda.iter().zip(&k) {
        mean.iter_mut()
            .zip(row)
            .for_each(|(mean, weight)| *mean += k * weight);
    }
    // Forward substitution: v = L^-1 k, and the variance is phi_o^2 - v^T v.
    let mut v: Vec<f64> = Vec::new();
    for (row, k) in k.iter().enumerate() {
        let line = &fit.cholesky[row * (row + 1) / 2..][..=row];
        let known: f64 = line.iter().zip(&v).map(|(l, v)| l * v).sum();
        v.push((k - known) / line[row]);
    }
    let explained: f64 = v.iter().map(|v| v * v).sum();
    let variance = (fit.kernel.signal_variance - explained).max(0.0);
    Prediction { mean, variance }
}

#[track_caller]
fn assert_close(found: f64, expected: f64, tolerance: f64) {
    let error = (found - expected).abs();
    assert!(
        error <= tolerance * expected.abs().max(1.0),
        "{found} instead of {expected}"
    );
}

/// Bounds that leave nothing to search: the fit has this kernel.
fn only(kernel: &Kernel) -> HyperBounds {
    let deviation = kernel.signal_variance.sqrt();
    let length = kernel.length_scales[0];
    HyperBounds {
        length_scale: (length, length),
        signal_deviation: (deviation, deviation),
        noise_variance: (kernel.noise_variance, kernel.noise_variance),
    }
}

#[test]
fn likelihood_and_gradient_are_those_of_scikit_learn() {
    let fixture = Fixture::read();
    let (value, gradient) = fixture
        .likelihood()
        .value_and_gradient(&fixture.kernel())
        .unwrap();
    assert_close(value, fixture.fixed.log_marginal_likelihood, 1e-8);
    assert_eq!(gradient.len(), fixture.fixed.gradient.len());
    for (found, expected) in gradient.iter().zip(&fixture.fixed.gradient) {
        assert_close(*found, *expected, 1e-8);
    }
    assert_eq!(
        fixture.likelihood().value(&fixture.kernel()).unwrap(),
        value
    );
}

#[test]
fn mean_and_variance_are_those_of_scikit_learn() {
    let fixture = Fixture::read();
    // One bound serves all length scales, so the inputs carry the fixture's: x / l with l = 1 is
    // the same kernel.
    let divide = |rows: &[Vec<f64>]| -> Vec<Vec<f64>> {
        let scaled = |row: &Vec<f64>| {
            row.iter()
                .zip(&fixture.fixed.length_scales)
                .map(|(x, l)| x / l)
                .collect()
        };
        rows.iter().map(scaled).collect()
    };
    let kernel = Kernel {
        length_scales: vec![1.0; 3],
        ..fixture.kernel()
    };
    let settings = FitSettings {
        bounds: only(&kernel),
        ..fixture.settings()
    };
    let inputs = divide(&fixture.inputs);
    let fitted = fit(&inputs, &fixture.outputs, &fixture.mean, &settings).unwrap();
    assert_close(
        fitted.log_marginal_likelihood,
        fixture.fixed.log_marginal_likelihood,
        1e-8,
    );
    assert_eq!(fitted.jitter, 0.0);
    let queries = divide(&fixture.fixed.queries);
    for (which, query) in queries.iter().enumerate() {
        let found = predict(&fitted, &inputs, &fixture.mean, query);
        for (found, expected) in found.mean.iter().zip(&fixture.fixed.means[which]) {
            assert_close(*found, *expected, 1e-8);
        }
        assert_close(found.variance, fixture.fixed.variances[which], 1e-8);
    }
}

#[test]
fn fitted_likelihood_is_at_least_that_of_scikit_learn() {
    let fixture = Fixture::read();
    let fitted = fixture.fit(&fixture.settings());
    let theirs = fixture.best.log_marginal_likelihood;
    assert!(
        fitted.log_marginal_likelihood >= theirs - 1e-3 * theirs.abs(),
        "{} against {theirs}",
        fitted.log_marginal_likelihood
    );
}

/// Central differences of the likelihood against its gradient, each relative to the largest
/// component.
fn assert_gradient_matches_differences(samples: &Likelihood, kernel: &Kernel, tolerance: f64) {
    let (_, gradient) = samples.value_and_gradient(kernel).unwrap();
    let size = gradient.iter().fold(1.0_f64, |size, g| size.max(g.abs()));
    let step = 1e-5;
    for (at, slope) in gradient.iter().enumerate() {
        let value = |shift: f64| {
            let mut logarithms = kernel.logarithms();
            logarithms[at] += shift;
            samples
                .value(&Kernel::from_logarithms(&logarithms))
                .unwrap()
        };
        let difference = (value(step) - value(-step)) / (2.0 * step);
        let error = (difference - slope).abs();
        assert!(
            error < tolerance * size,
            "variable {at}: {slope}, by differences {difference}"
        );
    }
}

#[test]
fn gradient_matches_finite_differences() {
    let fixture = Fixture::read();
    let samples = fixture.likelihood();
    for noise in [1.0, 1e-2, 1e-4] {
        for length in [0.3, 1.0, 6.0] {
            let kernel = Kernel {
                length_scales: vec![length, 2.0 * length, 0.7 * length],
                signal_variance: 0.6,
                noise_variance: noise,
            };
            assert_gradient_matches_differences(&samples, &kernel, 1e-6);
        }
    }
}

#[test]
fn gradient_matches_finite_differences_with_jitter() {
    // Inputs that come twice with different outputs, and a noise a little below zero: only a jitter
    // makes the covariance positive definite, and the likelihood hangs on it.
    let fixture = Fixture::read();
    let twice = Inputs::of(fixture.inputs[..8].iter().chain(&fixture.inputs[..8]));
    let y = faer::Mat::from_fn(16, 4, |row, column| fixture.outputs[row][column]);
    let samples = Likelihood::new(twice.clone(), y);
    let kernel = Kernel {
        noise_variance: -1e-5,
        ..fixture.kernel()
    };
    let covariance = twice.scaled(&kernel).covariance(kernel.signal_variance);
    let factor = likelihood::Factor::new(&covariance, &kernel).unwrap();
    assert_eq!(factor.jitter, 1e-4 * kernel.signal_variance);
    let (_, gradient) = samples.value_and_gradient(&kernel).unwrap();
    let value = |shift: f64| {
        let signal_variance = kernel.signal_variance * (2.0 * shift).exp();
        let moved = Kernel {
            signal_variance,
            ..kernel.clone()
        };
        samples.value(&moved).unwrap()
    };
    let difference = (value(1e-5) - value(-1e-5)) / 2e-5;
    assert!(
        (gradient[3] / difference - 1.0).abs() < 1e-5,
        "{} {difference}",
        gradient[3]
    );
}

#[test]
fn lambda_and_factor_solve_the_system_they_stand_for() {
    let fixture = Fixture::read();
    let fitted = fixture.fit(&fixture.settings());
    let (inputs, outputs, kernel) = (&fixture.inputs, &fixture.outputs, &fitted.kernel);
    let row_of = |row: usize| &fitted.cholesky[row * (row + 1) / 2..(row + 1) * (row + 2) / 2];
    assert_eq!(fitted.cholesky.len(), 60 * 61 / 2);
    for a in 0..inputs.len() {
        for b in 0..=a {
            let product: f64 = row_of(a).iter().zip(row_of(b)).map(|(p, q)| p * q).sum();
            let noise = if a == b {
                fitted.kernel.noise_variance + fitted.jitter
            } else {
                0.0
            };
            let expected = kernel.value(&inputs[a], &inputs[b]) + noise;
            assert_close(product, expected, 1e-12);
        }
        // (K + phi_s I) Lambda = Y - m: the prediction at a sample lacks exactly the noise times
        // its weight
        let found = predict(&fitted, inputs, &fixture.mean, &inputs[a]);
        let noise = fitted.kernel.noise_variance + fitted.jitter;
        for (column, mean) in found.mean.iter().enumerate() {
            let whole = mean + noise * fitted.lambda[a][column];
            assert_close(whole, outputs[a][column], 1e-9);
        }
    }
}

#[test]
fn input_that_does_not_matter_gets_a_long_length_scale() {
    let fixture = Fixture::read();
    let noisy: Vec<Vec<f64>> = fixture
        .inputs
        .iter()
        .enumerate()
        .map(|(at, row)| [&row[..], &[((at * 7919) % 61) as f64 / 30.0]].concat())
        .collect();
    let settings = fixture.settings();
    let fitted = fit(&noisy, &fixture.outputs, &fixture.mean, &settings).unwrap();
    let lengths = &fitted.kernel.length_scales;
    assert!(lengths[3] > 10.0, "{lengths:?}");
    assert!(lengths[0] < 3.0, "{lengths:?}");
}

#[test]
fn constant_outputs_change_nothing_for_the_others() {
    let fixture = Fixture::read();
    let settings = FitSettings::default();
    let plain = fixture.fit(&settings);
    // one output at its mean, one beside it
    let rows: Vec<Vec<f64>> = fixture
        .outputs
        .iter()
        .map(|r| [&r[..], &[5.0, 7.0]].concat())
        .collect();
    let mean = [&fixture.mean[..], &[5.0, 6.5]].concat();
    let fitted = fit(&fixture.inputs, &rows, &mean, &settings).unwrap();
    assert_eq!(fitted.kernel.length_scales, plain.kernel.length_scales);
    assert_eq!(
        fitted.log_marginal_likelihood,
        plain.log_marginal_likelihood
    );
    assert_eq!(fitted.output_scales[4..], [1.0, 0.5]);
    let found = predict(&fitted, &fixture.inputs, &mean, &fixture.inputs[0]);
    assert_eq!(found.mean[4], 5.0);
    assert!((found.mean[5] - 7.0).abs() < 0.1, "{}", found.mean[5]);
}

#[test]
fn nothing_but_constant_outputs_is_still_a_fit() {
    let fixture = Fixture::read();
    let rows = vec![vec![3.0, -1.0]; fixture.inputs.len()];
    let settings = FitSettings::default();
    let fitted = fit(&fixture.inputs, &rows, &[3.0, -1.0], &settings).unwrap();
    assert_eq!(fitted.evaluations, 0);
    assert!(fitted.lambda.iter().flatten().all(|&weight| weight == 0.0));
    let found = predict(&fitted, &fixture.inputs, &[3.0, -1.0], &[9.0, 9.0, 9.0]);
    assert_eq!(found.mean, [3.0, -1.0]);
}

#[test]
fn constant_input_does_no_harm() {
    let fixture = Fixture::read();
    let rows: Vec<Vec<f64>> = fixture
        .inputs
        .iter()
        .map(|r| [&r[..], &[0.25]].concat())
        .collect();
    let settings = fixture.settings();
    let fitted = fit(&rows, &fixture.outputs, &fixture.mean, &settings).unwrap();
    let plain = fixture.fit(&settings);
    let (a, b) = (
        fitted.log_marginal_likelihood,
        plain.log_marginal_likelihood,
    );
    assert_close(a, b, 1e-3);
}

#[test]
fn repeated_samples_are_fitted() {
    let fixture = Fixture::read();
    let inputs = vec![fixture.inputs[0].clone(); 12];
    let fitted = fit(
        &inputs,
        &fixture.outputs[..12],
        &fixture.mean,
        &fixture.settings(),
    )
    .unwrap();
    let found = predict(&fitted, &inputs, &fixture.mean, &fixture.inputs[0]);
    assert!(found.mean.iter().all(|mean| mean.is_finite()) && found.variance >= 0.0);
}

#[test]
fn one_sample_is_fitted() {
    let fixture = Fixture::read();
    let (inputs, outputs) = (&fixture.inputs[..1], &fixture.outputs[..1]);
    let fitted = fit(inputs, outputs, &fixture.mean, &fixture.settings()).unwrap();
    assert_eq!(fitted.cholesky.len(), 1);
}

#[test]
fn subset_gives_lambda_for_all_samples_and_depends_on_the_seed() {
    let fixture = Fixture::read();
    let with_seed = |seed| {
        fixture.fit(&FitSettings {
            seed,
            subset: 30,
            polish: 0,
            ..fixture.settings()
        })
    };
    let (one, again, other) = (with_seed(1), with_seed(1), with_seed(2));
    assert_eq!(one.lambda.len(), 60);
    assert_eq!(one.lambda, again.lambda);
    assert_ne!(one.kernel.length_scales, other.kernel.length_scales);
}

#[test]
fn polishing_raises_the_likelihood_within_its_budget() {
    let fixture = Fixture::read();
    let with = |polish| {
        fixture.fit(&FitSettings {
            polish,
            subset: 20,
            ..fixture.settings()
        })
    };
    let (rough, polished) = (with(0), with(20));
    assert!(polished.log_marginal_likelihood > rough.log_marginal_likelihood + 1.0);
    assert!(polished.evaluations <= rough.evaluations + 20);
}

#[test]
fn noise_that_vanished_on_the_subset_comes_back_by_polishing() {
    let fixture = Fixture::read();
    let with = |polish| {
        fixture.fit(&FitSettings {
            polish,
            seed: 1,
            subset: 10,
            ..fixture.settings()
        })
    };
    let (rough, polished) = (with(0), with(40));
    assert!(
        rough.kernel.noise_variance < 1.1e-6,
        "{}",
        rough.kernel.noise_variance
    );
    assert!(
        polished.kernel.noise_variance > 1e-3,
        "{}",
        polished.kernel.noise_variance
    );
}

#[test]
fn number_of_threads_does_not_change_a_bit() {
    let fixture = Fixture::read();
    let with_threads = |threads| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        pool.install(|| fixture.fit(&fixture.settings()))
    };
    let (one, three) = (with_threads(1), with_threads(3));
    assert_eq!(one.lambda, three.lambda);
    assert_eq!(one.cholesky, three.cholesky);
    assert_eq!(one.evaluations, three.evaluations);
}
