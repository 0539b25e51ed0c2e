//! A command beside the limits of the paper's scene.

use messages::TwistCommand;

/// Largest magnitude of each component of the twist in the paper's scene, m/s and rad/s.
const LIMITS: [f64; 6] = [0.5, 0.5, 0.5, 1.0, 1.0, 1.0];

/// Returns whether a command asks for no motion.
pub fn is_still(twist: &TwistCommand) -> bool {
    twist.twist == [0.0; 6]
}

/// Largest component of a twist as a share of its limit; NaN is infinite.
pub fn speed(twist: &[f64; 6]) -> f64 {
    let shares = std::iter::zip(twist, LIMITS).map(|(v, limit)| v.abs() / limit);
    shares.fold(0.0, |most, share| {
        if share.is_nan() {
            f64::INFINITY
        } else {
            most.max(share)
        }
    })
}

/// Asserts that no component of a command is beyond the limits of the paper's scene.
pub fn assert_within_limits(twist: &TwistCommand) {
    assert!(speed(&twist.twist) <= 1.0 + 1e-9, "{twist:?}");
}
