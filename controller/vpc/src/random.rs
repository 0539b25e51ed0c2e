//! Numbers that look random and follow from other numbers, so that a replay has the same.

/// A number in [0, 1) that follows from another (SplitMix64).
pub(crate) fn uniform(number: u64) -> f64 {
    let mut z = number.wrapping_mul(0x9e37_79b9_7f4a_7c15);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
}

/// A number in [0, 1) that follows from another and an index below 8.
pub(crate) fn uniform_of(number: u64, index: u64) -> f64 {
    uniform(8 * number + index)
}
