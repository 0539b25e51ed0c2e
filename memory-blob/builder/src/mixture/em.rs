//! Expectation maximisation: from points to components, uphill in likelihood.

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::gaussian::{Gaussian, Point, Square};
use super::{Component, FEWEST_POINTS, MixtureSettings};

/// A component that explains less than this many points is dying: the attempt is given up.
const LEAST_WEIGHT: f64 = 1.0;

/// The end of one attempt.
#[derive(Clone, Debug)]
pub struct Run {
    /// The components after the last iteration.
    pub components: Vec<Component>,
    /// Log likelihood (nats) before each iteration and after the last; it never decreases.
    pub log_likelihoods: Vec<f64>,
}

/// The one Gaussian of all points.
pub fn single(points: &[Point], settings: &MixtureSettings) -> Vec<Component> {
    let shares = vec![1.0; points.len()];
    vec![component(points, &shares, points.len() as f64, settings)]
}

/// One attempt with `count` components. `None` when a component is left with fewer points than a
/// covariance needs: that number of components has then nothing to say about these points.
pub fn maximise(
    points: &[Point],
    count: usize,
    settings: &MixtureSettings,
    rng: &mut ChaCha8Rng,
) -> Option<Run> {
    let mut responsibilities = nearest_centre(points, &spread_centres(points, count, rng));
    let mut components = maximisation(points, &responsibilities, settings)?;
    let mut log_likelihoods = vec![expectation(points, &components, &mut responsibilities)];
    for iteration in 0..settings.max_iterations {
        components = maximisation(points, &responsibilities, settings)?;
        let after = expectation(points, &components, &mut responsibilities);
        let gain = after - log_likelihoods[iteration];
        log_likelihoods.push(after);
        if gain < settings.tolerance * points.len() as f64 {
            break;
        }
    }
    let least = FEWEST_POINTS as f64 / points.len() as f64;
    let carried = components.iter().all(|component| component.weight >= least);
    carried.then_some(Run {
        components,
        log_likelihoods,
    })
}

/// Log likelihood of `points` (nats).
pub fn log_likelihood(points: &[Point], components: &[Component]) -> f64 {
    let mut terms = vec![0.0; components.len()];
    points
        .iter()
        .map(|point| log_terms(point, components, &mut terms))
        .sum()
}

/// Fills `terms` with ln(pi_k N(point)) and returns the logarithm of their exponentials' sum.
fn log_terms(point: &Point, components: &[Component], terms: &mut [f64]) -> f64 {
    let mut largest = f64::NEG_INFINITY;
    for (term, component) in terms.iter_mut().zip(components) {
        *term = component.weight.ln() + component.gaussian.log_density(point);
        largest = largest.max(*term);
    }
    largest
        + terms
            .iter()
            .map(|term| (term - largest).exp())
            .sum::<f64>()
            .ln()
}

/// Share of each component in each point: one vector of length N a component. Returns the log
/// likelihood.
fn expectation(
    points: &[Point],
    components: &[Component],
    responsibilities: &mut [Vec<f64>],
) -> f64 {
    let mut terms = vec![0.0; components.len()];
    let mut total = 0.0;
    for (index, point) in points.iter().enumerate() {
        let log_density = log_terms(point, components, &mut terms);
        for (shares, term) in responsibilities.iter_mut().zip(&terms) {
            shares[index] = (term - log_density).exp();
        }
        total += log_density;
    }
    total
}

fn maximisation(
    points: &[Point],
    responsibilities: &[Vec<f64>],
    settings: &MixtureSettings,
) -> Option<Vec<Component>> {
    let mut components = Vec::with_capacity(responsibilities.len());
    for shares in responsibilities {
        let weight: f64 = shares.iter().sum();
        if weight < LEAST_WEIGHT {
            return None;
        }
        components.push(component(points, shares, weight, settings));
    }
    Some(components)
}

fn component(
    points: &[Point],
    shares: &[f64],
    weight: f64,
    settings: &MixtureSettings,
) -> Component {
    let weighted = || points.iter().zip(shares);
    let mean = weighted()
        .map(|(point, &share)| point * share)
        .sum::<Point>()
        / weight;
    let scatter = weighted()
        .map(|(point, &share)| (point - mean) * (point - mean).transpose() * share)
        .sum::<Square>()
        / weight;
    Component {
        weight: weight / points.len() as f64,
        gaussian: Gaussian::above_floor(mean, &scatter, &settings.floor),
    }
}

/// Centres chosen among the points: the first at random, each further one with a chance that grows
/// with the squared distance to the centres so far. Distances are in units of the spread of the
/// points along each axis, so that m and rad compare.
fn spread_centres(points: &[Point], count: usize, rng: &mut ChaCha8Rng) -> Vec<Point> {
    let scaled = in_units_of_spread(points);
    let first = rng.random_range(0..points.len());
    let mut chosen = vec![first];
    let mut distances: Vec<f64> = scaled
        .iter()
        .map(|p| (p - scaled[first]).norm_squared())
        .collect();
    while chosen.len() < count {
        let next = draw_index(&distances, rng);
        chosen.push(next);
        for (distance, point) in distances.iter_mut().zip(&scaled) {
            *distance = distance.min((point - scaled[next]).norm_squared());
        }
    }
    chosen.into_iter().map(|index| scaled[index]).collect()
}

/// An index with a chance proportional to its weight; uniform if all weights are zero.
fn draw_index(weights: &[f64], rng: &mut ChaCha8Rng) -> usize {
    let total: f64 = weights.iter().sum();
    if total <= 0.0 {
        return rng.random_range(0..weights.len());
    }
    let mut left = rng.random::<f64>() * total;
    for (index, weight) in weights.iter().enumerate() {
        left -= weight;
        if left < 0.0 {
            return index;
        }
    }
    weights.len() - 1
}

fn in_units_of_spread(points: &[Point]) -> Vec<Point> {
    let count = points.len() as f64;
    let mean = points.iter().sum::<Point>() / count;
    let variance = points
        .iter()
        .map(|p| (p - mean).map(|d| d * d))
        .sum::<Point>()
        / count;
    let spread = variance.map(|v| if v > 0.0 { v.sqrt() } else { 1.0 });
    points
        .iter()
        .map(|p| (p - mean).component_div(&spread))
        .collect()
}

/// Each point belongs wholly to the centre nearest to it; `centres` are in units of spread.
fn nearest_centre(points: &[Point], centres: &[Point]) -> Vec<Vec<f64>> {
    let mut responsibilities = vec![vec![0.0; points.len()]; centres.len()];
    for (index, point) in in_units_of_spread(points).iter().enumerate() {
        let mut nearest = (f64::INFINITY, 0);
        for (which, centre) in centres.iter().enumerate() {
            let distance = (point - centre).norm_squared();
            if distance < nearest.0 {
                nearest = (distance, which);
            }
        }
        responsibilities[nearest.1][index] = 1.0;
    }
    responsibilities
}
