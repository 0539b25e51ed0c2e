//! An operator's veto: a stop or a disarm, which the next arming must name.

use messages::{Action, Request};
use serde::{Deserialize, Serialize};

/// A veto that stands. Plain data.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Veto {
    /// Its name: random, odd for a stop, even for a disarm, never 0.
    pub name: u32,
    /// The first cycle since, CLOCK_MONOTONIC, ns; `u64::MAX` before that cycle.
    pub since_ns: u64,
}

impl Veto {
    /// The veto of this name, before its first cycle; `None` for 0.
    pub fn named(name: u32) -> Option<Self> {
        let since_ns = u64::MAX;
        (name != 0).then_some(Self { name, since_ns })
    }

    /// Notes that a cycle runs at `now_ns`. A clock that went back begins anew.
    pub fn pass(&mut self, now_ns: u64) {
        self.since_ns = self.since_ns.min(now_ns);
    }

    /// Whether no arming may follow yet: no cycle has answered a stop, or, where time passes, it is
    /// less than [`Request::AFTER_STOP_NS`] old in the last cycle, at `last_ns`.
    pub fn is_fresh(&self, last_ns: u64, is_live: bool) -> bool {
        let most = if is_live { Request::AFTER_STOP_NS } else { 0 };
        let is_old = last_ns
            .checked_sub(self.since_ns)
            .is_some_and(|age| age >= most);
        Action::of_veto(self.name) == Some(Action::Stop) && !is_old
    }
}

/// A source of names that nobody can guess, if its seed is secret. Plain data.
///
/// Source: G. L. Steele, D. Lea and C. H. Flood, "Fast splittable pseudorandom number generators"
/// (OOPSLA 2014), `SplitMix64`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Names(pub u64);

impl Names {
    /// The next name, of a stop or a disarm.
    pub fn next(&mut self, is_stop: bool) -> u32 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        let drawn = ((z ^ (z >> 31)) >> 32) as u32;
        match is_stop {
            true => drawn | 1,
            false => (drawn & !1).max(2),
        }
    }
}
