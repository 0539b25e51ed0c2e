//! The one clock of the contract.

use rustix::time::{ClockId, clock_gettime};

/// CLOCK_MONOTONIC, ns since an arbitrary start that all processes of the machine share. It stands
/// still while the machine is suspended.
pub fn now_ns() -> u64 {
    ns(ClockId::Monotonic)
}

/// How long the machine was suspended since it was started, ns, or a little less: by the time that
/// passed between the readings of two clocks.
pub fn suspended_ns() -> u64 {
    let boot_ns = ns(ClockId::Boottime);
    boot_ns.saturating_sub(now_ns())
}

fn ns(clock: ClockId) -> u64 {
    let now = clock_gettime(clock);
    // Both start at boot: both parts are non-negative, and 2^64 ns are 584 years.
    (now.tv_sec as u64)
        .wrapping_mul(1_000_000_000)
        .wrapping_add(now.tv_nsec as u64)
}
