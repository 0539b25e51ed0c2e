//! Quantiles by nearest rank.

/// The least value that a share, 0 to 1, of the sorted values does not exceed; the default (0) if
/// there are no values.
pub fn quantile<T: Copy + Default>(sorted: &[T], share: f64) -> T {
    let rank = (share * sorted.len() as f64).ceil() as usize;
    sorted.get(rank.max(1) - 1).copied().unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_are_ranks() {
        let numbers: Vec<u64> = (1..=1000).collect();
        let at = |share| quantile(&numbers, share);
        assert_eq!((at(0.0), at(0.5), at(1.0)), (1, 500, 1000));
        assert_eq!((at(0.99), at(0.999)), (990, 999));
        assert_eq!(quantile(&numbers[..10], 0.99), 10);
        assert_eq!(quantile(&[7.0], 0.999), 7.0);
        assert_eq!(quantile::<f64>(&[], 0.5), 0.0);
    }
}
