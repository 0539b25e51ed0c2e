//! A program that steers by `vpc/desired`, and wants anything.

use messages::DesiredTwist;
use rand::{Rng, RngExt};

/// From one twist to the next, and for how long each counts, ns.
pub const EVERY_NS: u64 = 100_000_000;
const VALID_NS: u64 = 200_000_000;

/// The program.
pub struct Policy {
    limits: [f64; 6],
    wanted: [f64; 6],
    sequence: u64,
}

impl Policy {
    /// One that knows the limits.
    pub fn new(limits: [f64; 6]) -> Self {
        Self {
            limits,
            wanted: limits,
            sequence: 0,
        }
    }

    /// What it wants at `now_ns`: to the limits and beyond them, and seldom something else.
    pub fn publish(&mut self, now_ns: u64, random: &mut impl Rng) -> DesiredTwist {
        let mut scaled = |share: f64, most: f64| {
            self.limits
                .map(|limit| share * limit * random.random_range(-most..most))
        };
        let (beyond, gentle) = (scaled(1.0, 3.0), scaled(0.1, 1.0));
        self.wanted = match random.random_range(0..8) {
            0 | 1 => beyond,
            2 => gentle,
            _ => self.wanted,
        };
        let mut desired = DesiredTwist::until(self.wanted, now_ns + VALID_NS);
        self.sequence += 1;
        (desired.stamp.sequence, desired.stamp.published_ns) = (self.sequence, now_ns);
        desired
    }
}
