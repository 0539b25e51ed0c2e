//! A Gaussian mixture in R^6: where the starts are that the memory cannot solve yet.
//!
//! Adaptive sampling draws new starts where old ones failed (paper, Sect. IV). A failed start is a
//! point of R^6: the translation (m) and the rotation vector (rad) of the object in the camera
//! frame. The mixture is fitted by expectation maximisation with full covariances, from seeded
//! starts spread as k-means++ does; the number of components is the one with the least Bayesian
//! information criterion.
//!
//! | Symbol | Here | Meaning |
//! |---|---|---|
//! | N | `points.len()` | number of failed starts |
//! | K | [`Mixture::components`] | number of components, 1 to [`MixtureSettings::max_components`] |
//! | pi_k, mu_k, Sigma_k | [`Component`] | weight, mean, covariance |
//! | BIC | [`Mixture::bic`] | -2 log L + (28 K - 1) ln N |
//!
//! Every covariance is held above a floor, Sigma_k >= diag(floor^2) in the order of symmetric
//! matrices. The floor is a constraint of the maximisation and not a term added afterwards (see
//! [`gaussian::Gaussian::above_floor`]), so the likelihood still never decreases from one iteration
//! to the next.
//!
//! Rotation vectors are treated as plain vectors: two nearly equal rotations close to pi rad, with
//! opposite vectors, count as far apart. They then get a component each, which costs a component
//! and nothing else.

pub mod em;
pub mod gaussian;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use gaussian::Gaussian;

/// Number of coordinates of a point: three of translation (m), three of the rotation vector (rad).
pub const DIMENSION: usize = 6;

/// Largest size of a coordinate that [`Mixture::fit`] accepts (m or rad); squares stay far from
/// overflow.
pub const LARGEST_COORDINATE: f64 = 1e6;

/// Fewest points that a full covariance is estimated from: one more than the dimension.
const FEWEST_POINTS: usize = DIMENSION + 1;

/// How a mixture is fitted.
#[derive(Clone, Debug, PartialEq)]
pub struct MixtureSettings {
    /// Largest number of components that is tried, at least 1.
    pub max_components: usize,
    /// Seeded starts of the expectation maximisation for each number of components, at least 1.
    pub attempts: usize,
    /// Most iterations of the expectation maximisation in one attempt, at least 1.
    pub max_iterations: usize,
    /// An attempt ends when the mean log likelihood of a point grows by less than this, above 0.
    pub tolerance: f64,
    /// Least standard deviation along each axis: m for the first three, rad for the last three,
    /// above 0.
    pub floor: [f64; DIMENSION],
}

impl Default for MixtureSettings {
    fn default() -> Self {
        Self {
            max_components: 5,
            attempts: 4,
            max_iterations: 200,
            tolerance: 1e-6,
            floor: [0.005, 0.005, 0.005, 0.02, 0.02, 0.02],
        }
    }
}

/// Why no mixture could be fitted.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum MixtureError {
    /// There is nothing to fit.
    #[error("the mixture has no points: at least 1 is needed")]
    NoPoints,
    /// A coordinate is not a number, infinite or absurdly large.
    #[error(
        "coordinate {axis} of point {point} of the mixture is {value}: it must be finite and at most \
         {LARGEST_COORDINATE:e} in size"
    )]
    Coordinate {
        /// Index of the point.
        point: usize,
        /// Index of the coordinate, 0 to 5.
        axis: usize,
        /// What was found.
        value: f64,
    },
    /// A setting is out of its range.
    #[error("mixture setting {name} is {value}: it must be {allowed}")]
    Setting {
        /// Name of the field of [`MixtureSettings`].
        name: &'static str,
        /// What was found.
        value: f64,
        /// What is allowed.
        allowed: &'static str,
    },
}

impl MixtureSettings {
    fn check(&self) -> Result<(), MixtureError> {
        let counts = [
            ("max_components", self.max_components),
            ("attempts", self.attempts),
            ("max_iterations", self.max_iterations),
        ];
        for (name, count) in counts {
            if count == 0 {
                return Err(MixtureError::Setting {
                    name,
                    value: 0.0,
                    allowed: "at least 1",
                });
            }
        }
        let reals = self.floor.iter().map(|&floor| ("floor", floor));
        for (name, value) in reals.chain([("tolerance", self.tolerance)]) {
            if !(value > 0.0 && value <= LARGEST_COORDINATE) {
                return Err(MixtureError::Setting {
                    name,
                    value,
                    allowed: "above 0 and at most 1e6",
                });
            }
        }
        Ok(())
    }
}

/// One Gaussian of a mixture and its share of the points.
#[derive(Clone, Debug)]
pub struct Component {
    /// Share of the points, in (0, 1]; the shares of a mixture add up to 1.
    pub weight: f64,
    /// Where the component is and how wide.
    pub gaussian: Gaussian,
}

/// A fitted mixture: a probability density over starts.
#[derive(Clone, Debug)]
pub struct Mixture {
    components: Vec<Component>,
    log_likelihood: f64,
    bic: f64,
}

impl Mixture {
    /// Fits a mixture to `points` (translation in m, rotation vector in rad). The same points in
    /// the same order, settings and seed give the same mixture.
    ///
    /// Fewer than 7 points do not determine a covariance: they give one Gaussian with independent
    /// axes.
    ///
    /// # Errors
    /// [`MixtureError`] when there is no point, a coordinate is not finite, or a setting is out of
    /// range.
    pub fn fit(
        points: &[[f64; DIMENSION]],
        settings: &MixtureSettings,
        seed: u64,
    ) -> Result<Self, MixtureError> {
        settings.check()?;
        check_points(points)?;
        let points: Vec<gaussian::Point> = points.iter().map(|&p| p.into()).collect();
        if points.len() < FEWEST_POINTS {
            let only = Gaussian::with_independent_axes(&points, &settings.floor);
            return Ok(Self::new(
                vec![Component {
                    weight: 1.0,
                    gaussian: only,
                }],
                &points,
            ));
        }
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut best = Self::new(em::single(&points, settings), &points);
        for count in 2..=settings.max_components.min(points.len() / FEWEST_POINTS) {
            for _ in 0..settings.attempts {
                let candidate = em::maximise(&points, count, settings, &mut rng)
                    .map(|run| Self::new(run.components, &points));
                if let Some(candidate) = candidate.filter(|c| c.bic < best.bic) {
                    best = candidate;
                }
            }
        }
        Ok(best)
    }

    fn new(components: Vec<Component>, points: &[gaussian::Point]) -> Self {
        let log_likelihood = em::log_likelihood(points, &components);
        // mean, upper half of the covariance and weight of each, less one because the weights add
        // up to 1
        let each = DIMENSION + DIMENSION * (DIMENSION + 1) / 2 + 1;
        let parameters = (components.len() * each - 1) as f64;
        let bic = parameters * (points.len() as f64).ln() - 2.0 * log_likelihood;
        Self {
            components,
            log_likelihood,
            bic,
        }
    }

    /// The components, at least one.
    pub fn components(&self) -> &[Component] {
        &self.components
    }

    /// Log likelihood of the points that the mixture was fitted to (nats).
    pub fn log_likelihood(&self) -> f64 {
        self.log_likelihood
    }

    /// Bayesian information criterion on the points that the mixture was fitted to; less is better.
    pub fn bic(&self) -> f64 {
        self.bic
    }

    /// Draws one start: translation (m) and rotation vector (rad). It is not limited to any region:
    /// the caller rejects what lies outside of its own.
    pub fn sample(&self, rng: &mut ChaCha8Rng) -> [f64; DIMENSION] {
        let mut left: f64 = rng.random();
        let mut chosen = &self.components[0];
        for component in &self.components {
            chosen = component;
            left -= component.weight;
            if left < 0.0 {
                break;
            }
        }
        chosen.gaussian.sample(rng)
    }
}

fn check_points(points: &[[f64; DIMENSION]]) -> Result<(), MixtureError> {
    if points.is_empty() {
        return Err(MixtureError::NoPoints);
    }
    for (index, point) in points.iter().enumerate() {
        for (axis, &value) in point.iter().enumerate() {
            if !value.is_finite() || value.abs() > LARGEST_COORDINATE {
                return Err(MixtureError::Coordinate {
                    point: index,
                    axis,
                    value,
                });
            }
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests;
