//! What another program wants of the camera.

use crate::field::Stamp;
use crate::message::{Qos, message};

/// Longest time for which a wanted twist counts after it was published, ns.
pub const MOST_WANTED_NS: u64 = 500_000_000;

message! {
    /// The camera velocity that another program wants. With the strategy `follow` the controller
    /// sends the nearest twist to it that is allowed.
    DesiredTwist {
        /// Head.
        stamp: Stamp,
        /// It counts until this instant, CLOCK_MONOTONIC, but for no more than 0.5 s after its
        /// publication; then the camera brakes.
        valid_until_ns: u64 ["ns"],
        /// Camera velocity in the camera frame (x right, y down, z forward): vx vy vz wx wy wz.
        twist: [f64; 6] ["m/s, rad/s" finite],
    }
    // No history: a controller that starts must not follow what was wanted before.
    "vpc/desired" from "policy": Qos { history: 0, buffer: 64, subscribers: 8, publishers: 1 }
}

impl DesiredTwist {
    /// A twist that is wanted until this instant, CLOCK_MONOTONIC, ns.
    pub fn until(twist: [f64; 6], valid_until_ns: u64) -> Self {
        Self {
            valid_until_ns,
            twist,
            ..Self::default()
        }
    }

    /// Until when it counts, CLOCK_MONOTONIC, ns.
    pub fn in_force_until_ns(&self) -> u64 {
        let most = self.stamp.published_ns.saturating_add(MOST_WANTED_NS);
        self.valid_until_ns.min(most)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_is_wanted_for_longer_than_half_a_second() {
        let mut desired = DesiredTwist::until([0.1; 6], 700);
        desired.stamp.published_ns = 600;
        assert_eq!(desired.in_force_until_ns(), 700);
        desired.valid_until_ns = u64::MAX;
        assert_eq!(desired.in_force_until_ns(), 600 + MOST_WANTED_NS);
    }
}
