//! A Gaussian mixture over failed starts, from which starts are drawn that the memory cannot solve
//! yet.
//!
//! A start is a point of R^6: translation (m) and rotation vector (rad) of the object in the camera
//! frame. The paper (Sect. IV) fits a Gaussian mixture model. Here each failed start is a component
//! of its own, all with the same weight and the same deviations, by Scott's rule: nothing is
//! fitted, and a trap with few failures is not taken for part of a larger one. Rotation vectors are
//! treated as plain vectors: what is cut at pi rad lies on both sides of the cut.
//!
//! Source: D. Scott, "Multivariate Density Estimation" (1992), Eq. (6.42).

use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

/// Coordinates of a start.
pub const DIMENSION: usize = 6;

/// Least deviation along each axis, m and rad.
const FLOOR: [f64; DIMENSION] = [0.005, 0.005, 0.005, 0.02, 0.02, 0.02];

/// A probability density over starts.
#[derive(Clone, Debug)]
pub struct Mixture {
    centres: Vec<[f64; DIMENSION]>,
    /// Deviation of every component along each axis, m and rad.
    deviation: [f64; DIMENSION],
}

impl Mixture {
    /// The mixture over some failed starts; `None` where there are none.
    pub fn over(failures: &[[f64; DIMENSION]]) -> Option<Self> {
        let count = failures.len() as f64;
        let narrowing = count.powf(-1.0 / (DIMENSION as f64 + 4.0));
        let spread = |k: usize| {
            let mean = failures.iter().map(|x| x[k]).sum::<f64>() / count;
            let square = |x: &[f64; DIMENSION]| (x[k] - mean) * (x[k] - mean);
            (failures.iter().map(square).sum::<f64>() / count).sqrt()
        };
        (!failures.is_empty()).then(|| Self {
            centres: failures.to_vec(),
            deviation: std::array::from_fn(|k| (narrowing * spread(k)).max(FLOOR[k])),
        })
    }

    /// Draws one start. It is not limited to any region: the caller rejects what lies outside of
    /// its own.
    pub fn sample(&self, rng: &mut ChaCha8Rng) -> [f64; DIMENSION] {
        // A range of u64, so that the same seed gives the same start on every machine.
        let centre = self.centres[rng.random_range(0..self.centres.len() as u64) as usize];
        std::array::from_fn(|k| {
            centre[k] + self.deviation[k] * rng.sample::<f64, _>(StandardNormal)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;

    /// Starts drawn from the mixture over two clouds 0.6 m apart, the second with a third of the
    /// failures.
    fn drawn(seed: u64) -> Vec<[f64; DIMENSION]> {
        let mut rng = ChaCha8Rng::seed_from_u64(7);
        let mut cloud = |x: f64, count: usize| {
            let mut point =
                || std::array::from_fn(|_| x + 0.02 * rng.sample::<f64, _>(StandardNormal));
            (0..count)
                .map(|_| point())
                .collect::<Vec<[f64; DIMENSION]>>()
        };
        let failures = [cloud(0.0, 200), cloud(0.6, 100)].concat();
        let mixture = Mixture::over(&failures).unwrap();
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        (0..3000).map(|_| mixture.sample(&mut rng)).collect()
    }

    #[test]
    fn starts_are_drawn_about_every_failure_with_its_share() {
        let starts = drawn(1);
        let mean = starts.iter().map(|x| x[0]).sum::<f64>() / 3000.0;
        assert!((mean - 0.2).abs() < 0.02, "{mean}");
        // Each axis has the clouds' own variance and that of the components: 300^(-1/5) of the
        // whole.
        let square = |x: &[f64; DIMENSION]| (x[3] - mean) * (x[3] - mean);
        let variance = starts.iter().map(square).sum::<f64>() / 3000.0;
        let whole: f64 = 0.08 + 0.0004;
        let expected = whole * (1.0 + 300.0f64.powf(-0.2));
        assert!(
            (variance / expected - 1.0).abs() < 0.1,
            "{variance} {expected}"
        );
    }

    #[test]
    fn one_failure_spreads_by_the_floor() {
        let failure = [0.1, -0.2, 0.7, 0.3, 0.0, -1.0];
        let mixture = Mixture::over(&[failure]).unwrap();
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let starts: Vec<_> = (0..2000).map(|_| mixture.sample(&mut rng)).collect();
        for k in 0..DIMENSION {
            let square = |x: &[f64; DIMENSION]| (x[k] - failure[k]) * (x[k] - failure[k]);
            let deviation = (starts.iter().map(square).sum::<f64>() / 2000.0).sqrt();
            assert!((deviation / FLOOR[k] - 1.0).abs() < 0.1, "{deviation}");
        }
    }

    #[test]
    fn without_failures_there_is_no_mixture() {
        assert!(Mixture::over(&[]).is_none());
        assert_eq!(drawn(5), drawn(5));
        assert_ne!(drawn(5), drawn(6));
    }
}
