//! Wrong times: what frames say of the instant at which they were exposed.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal};

use crate::robot::truth::Truth;

/// Distinguishes the random numbers from those of noise and losses.
const STAMPS: u64 = 0x57a3;

/// The clock of a camera.
#[derive(Clone, Debug)]
pub(crate) struct Stamps {
    bias_ns: f64,
    jitter: Option<Normal<f64>>,
    random: ChaCha8Rng,
    /// The least that the next frame may say.
    least_ns: u64,
}

impl Stamps {
    pub fn new(truth: &Truth, seed: u64) -> Self {
        let jitter_ns = 1e6 * truth.stamp_jitter_ms;
        Self {
            bias_ns: 1e6 * truth.stamp_bias_ms,
            jitter: (jitter_ns > 0.0)
                .then(|| Normal::new(0.0, jitter_ns).ok())
                .flatten(),
            random: ChaCha8Rng::seed_from_u64(seed ^ STAMPS),
            least_ns: 0,
        }
    }

    /// What a frame says that was exposed at `true_ns`: never what an earlier one said.
    pub fn told(&mut self, true_ns: u64) -> u64 {
        let jitter = self.jitter.map(|normal| normal.sample(&mut self.random));
        let error = (self.bias_ns + jitter.unwrap_or(0.0)).round() as i64;
        let told = true_ns.saturating_add_signed(error).max(self.least_ns);
        self.least_ns = told + 1;
        told
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PERIOD_NS: u64 = 33_333_333;

    /// Errors of the stamps of 3000 frames, ms.
    fn errors(bias: f64, jitter: f64) -> Vec<f64> {
        let truth = Truth {
            stamp_bias_ms: bias,
            stamp_jitter_ms: jitter,
            ..Truth::default()
        };
        let mut stamps = Stamps::new(&truth, 4);
        let told = (30..3030).map(|k| (k * PERIOD_NS, stamps.told(k * PERIOD_NS)));
        let told: Vec<(u64, u64)> = told.collect();
        assert!(told.windows(2).all(|pair| pair[0].1 < pair[1].1));
        told.iter()
            .map(|(real, told)| (*told as f64 - *real as f64) * 1e-6)
            .collect()
    }

    #[test]
    fn stamps_are_late_and_spread_as_asked_and_true_without_flaws() {
        assert!(errors(0.0, 0.0).iter().all(|x| *x == 0.0));
        assert!(errors(-20.0, 0.0).iter().all(|x| *x == -20.0));
        let all = errors(7.0, 3.0);
        let mean = all.iter().sum::<f64>() / 3000.0;
        let square = all.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / 3000.0;
        assert!((mean - 7.0).abs() < 0.2 && (square.sqrt() - 3.0).abs() < 0.15);
    }

    #[test]
    fn time_never_goes_back() {
        let all = errors(0.0, 50.0);
        assert!(all.iter().any(|x| x.abs() > 60.0));
    }
}
