//! A program that steers by `vpc/desired`, and wants anything, or one thing.

use messages::DesiredTwist;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

/// From one twist to the next, and for how long each counts, ns.
pub const EVERY_NS: u64 = 100_000_000;
const VALID_NS: u64 = 200_000_000;
/// How fast the camera is to turn about its axis, as a share of the limit.
const ROLL: f64 = 1.0;

/// The program.
pub struct Policy {
    limits: [f64; 6],
    wanted: [f64; 6],
    /// Whether it wants nothing but to turn the camera on and on.
    turns: bool,
    sequence: u64,
    random: ChaCha8Rng,
}

impl Policy {
    /// One that knows the limits.
    pub fn new(limits: [f64; 6], turns: bool, random: ChaCha8Rng) -> Self {
        Self {
            limits,
            wanted: limits,
            turns,
            sequence: 0,
            random,
        }
    }

    /// What it wants at `now_ns`: to the limits and beyond them, and seldom something else.
    pub fn publish(&mut self, now_ns: u64) -> DesiredTwist {
        let mut scaled = |share: f64, most: f64| {
            self.limits
                .map(|limit| share * limit * self.random.random_range(-most..most))
        };
        let (beyond, gentle) = (scaled(1.0, 3.0), scaled(0.1, 1.0));
        self.wanted = match self.random.random_range(0..8) {
            _ if self.turns => [0.0, 0.0, 0.0, 0.0, 0.0, ROLL * self.limits[5]],
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
