//! The one clock of the contract.

use rustix::time::{ClockId, clock_gettime};

/// CLOCK_MONOTONIC, ns since an arbitrary start that all processes of the machine share.
pub fn now_ns() -> u64 {
    let now = clock_gettime(ClockId::Monotonic);
    // The monotonic clock starts at boot: both parts are non-negative, and 2^64 ns are 584 years.
    (now.tv_sec as u64)
        .wrapping_mul(1_000_000_000)
        .wrapping_add(now.tv_nsec as u64)
}
