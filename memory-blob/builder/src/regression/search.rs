//! The search for the hyper-parameters: subset, starts, and the final polish.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

use super::likelihood::Likelihood;
use super::{FitSettings, HyperBounds, Kernel, moments};
use crate::lbfgs;

/// The best kernel over all starts and the number of evaluations. Equal values are settled by the
/// order of the starts, never by which thread came first.
pub(super) fn search(
    inputs: &[Vec<f64>],
    subset: &Likelihood,
    whole: &Likelihood,
    settings: &FitSettings,
) -> (Kernel, usize) {
    let (lower, upper) = box_of(inputs[0].len(), &settings.bounds);
    let first = first_start(inputs, &settings.bounds);
    let mut rng = ChaCha8Rng::seed_from_u64(settings.seed);
    rng.set_stream(1); // stream 0 draws the subset: a setting of the one must not move the other
    let mut starts = vec![first.clone()];
    for _ in 0..settings.restarts {
        starts.push(random_start(&first, &mut rng));
    }
    let climb = |samples: &Likelihood, start: &[f64], search: &lbfgs::Settings| {
        let values = samples.values() as f64;
        let negative = |logarithms: &[f64]| {
            let kernel = Kernel::from_logarithms(logarithms);
            let (value, gradient) = samples.value_and_gradient(&kernel).ok()?;
            Some((
                -value / values,
                gradient.into_iter().map(|g| -g / values).collect(),
            ))
        };
        lbfgs::minimise(negative, start, &lower, &upper, search)
    };
    let ends: Vec<Option<lbfgs::Minimum>> = starts
        .par_iter()
        .map(|start| climb(subset, start, &settings.search))
        .collect();
    let mut evaluations = ends.iter().flatten().map(|end| end.evaluations).sum();
    let best = lowest(ends);
    // Without any end no start had a value: the factor of all samples will say so, with the reason.
    let mut point = best.map_or(first, |end| end.point);
    if settings.polish > 0 && whole.rows() > subset.rows() {
        let few = lbfgs::Settings {
            max_evaluations: settings.polish,
            ..settings.search.clone()
        };
        let lifted = lift_noise(&point, &lower);
        let end = climb(whole, &lifted, &few);
        evaluations += end.as_ref().map_or(0, |end| end.evaluations);
        let before = whole.value(&Kernel::from_logarithms(&point));
        let before = before.map_or(f64::INFINITY, |value| -value / whole.values() as f64);
        if let Some(end) = end.filter(|end| end.value < before) {
            point = end.point;
        }
    }
    (Kernel::from_logarithms(&point), evaluations)
}

/// The lowest end, the earliest of equal ones.
fn lowest(ends: Vec<Option<lbfgs::Minimum>>) -> Option<lbfgs::Minimum> {
    let found = ends.into_iter().flatten();
    found.reduce(|a, b| if b.value < a.value { b } else { a })
}

/// The point with a noise at least 100 times its lower bound. Where the noise has all but vanished
/// on the subset the likelihood is flat in its logarithm, and a search that began there would leave
/// it.
fn lift_noise(point: &[f64], lower: &[f64]) -> Vec<f64> {
    let mut lifted = point.to_vec();
    if let (Some(noise), Some(bound)) = (lifted.last_mut(), lower.last()) {
        *noise = noise.max(bound + 100f64.ln());
    }
    lifted
}

/// Logarithms of the box for n inputs, in the order of [`Kernel::from_logarithms`].
fn box_of(inputs: usize, bounds: &HyperBounds) -> (Vec<f64>, Vec<f64>) {
    let mut pairs = vec![bounds.length_scale; inputs];
    pairs.extend([bounds.signal_deviation, bounds.noise_variance]);
    pairs
        .into_iter()
        .map(|(low, high)| (low.ln(), high.ln()))
        .unzip()
}

/// Length scales of sqrt(n) spreads, so that typical samples are about one length apart; phi_o = 1,
/// phi_s = 0.01.
pub(super) fn first_start(inputs: &[Vec<f64>], bounds: &HyperBounds) -> Vec<f64> {
    let columns = inputs[0].len();
    let root = (columns as f64).sqrt();
    let spread = |column: usize| {
        let (_, deviation) = moments(inputs.iter().map(|row| row[column]));
        if deviation > 0.0 {
            deviation * root
        } else {
            1.0
        }
    };
    let lengths = (0..columns).map(|column| spread(column).ln());
    let start: Vec<f64> = lengths.chain([0.0, 0.01f64.ln()]).collect();
    let (lower, upper) = box_of(columns, bounds);
    start
        .iter()
        .zip(lower.iter().zip(upper))
        .map(|(s, (&low, high))| s.max(low).min(high))
        .collect()
}

/// Length scales within a factor of 5 of the first start, phi_o within 3, phi_s from 1e-3 to 10
/// times; the search clips them to the box.
fn random_start(first: &[f64], rng: &mut ChaCha8Rng) -> Vec<f64> {
    let inputs = first.len() - 2;
    let reach = |at: usize| match at.checked_sub(inputs) {
        None => (-5f64.ln(), 5f64.ln()),
        Some(0) => (-3f64.ln(), 3f64.ln()),
        Some(_) => (1e-3f64.ln(), 10f64.ln()),
    };
    first
        .iter()
        .enumerate()
        .map(|(at, value)| {
            let (low, high) = reach(at);
            value + low + (high - low) * rng.random::<f64>()
        })
        .collect()
}

/// Rows of the subset in rising order.
pub(super) fn draw_subset(rows: usize, settings: &FitSettings) -> Vec<usize> {
    let mut order: Vec<usize> = (0..rows).collect();
    if settings.subset < rows {
        let mut rng = ChaCha8Rng::seed_from_u64(settings.seed);
        for at in 0..settings.subset {
            let other = rng.random_range(at as u64..rows as u64) as usize;
            order.swap(at, other);
        }
        order.truncate(settings.subset);
        order.sort_unstable();
    }
    order
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lowest_end_is_kept_and_the_earliest_of_equal_ones() {
        let end = |value, at| {
            Some(lbfgs::Minimum {
                point: vec![at],
                value,
                evaluations: 1,
            })
        };
        let ends = vec![
            None,
            end(2.0, 0.0),
            end(-1.0, 1.0),
            end(-1.0, 2.0),
            end(0.0, 3.0),
        ];
        assert_eq!(lowest(ends).unwrap().point, [1.0]);
        assert!(lowest(vec![None, None]).is_none());
    }

    #[test]
    fn only_a_vanished_noise_is_lifted() {
        let (lower, _) = box_of(1, &HyperBounds::default());
        let lifted = lift_noise(&[0.0, 0.0, lower[2]], &lower);
        assert!((lifted[2].exp() - 1e-4).abs() < 1e-12);
        assert_eq!(lift_noise(&[0.3, -1.0, -2.0], &lower), [0.3, -1.0, -2.0]);
    }
}
