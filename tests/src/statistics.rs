//! Statistics over runs.

/// The mean, if there is a value.
pub(crate) fn mean(values: impl Iterator<Item = f64>) -> Option<f64> {
    let (sum, count) = values.fold((0.0, 0.0_f64), |(sum, count), x| (sum + x, count + 1.0));
    (count > 0.0).then(|| sum / count)
}

/// The 95 % interval of a rate (Wilson).
pub(crate) fn wilson(successes: usize, count: usize) -> [f64; 2] {
    const Z: f64 = 1.96;
    let n = count.max(1) as f64;
    let rate = successes as f64 / n;
    let middle = rate + Z * Z / (2.0 * n);
    let half = Z * (rate * (1.0 - rate) / n + Z * Z / (4.0 * n * n)).sqrt();
    let scale = 1.0 + Z * Z / n;
    [(middle - half) / scale, (middle + half) / scale]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_interval_is_wilsons() {
        // E. Wilson, 1927; computed by statsmodels' proportion_confint(99, 100, method="wilson").
        let [low, high] = wilson(99, 100);
        assert!(
            (low - 0.94551).abs() < 1e-4 && (high - 0.99823).abs() < 1e-4,
            "{low} {high}"
        );
    }
}
