//! Counted work: one unit for a change of the active set of a quadratic program, or for what takes
//! about as long (some 0.1 us on a present-day processor).

use crate::intersample::STRETCHES_A_STEP;

/// Previewing a window of `np` steps and summing up its cost and violations.
pub const fn evaluation(np: usize) -> u32 {
    2 * np as u32
}

/// Following the features to a place inside the first period.
pub const PLACE: u32 = 2;

/// Most work of previewing a window of `np` steps and following the features inside the first.
pub const fn most_evaluation(np: usize) -> u32 {
    evaluation(np) + PLACE * (STRETCHES_A_STEP as u32 - 1)
}

/// Expanding cost and clearances about a plan, and factorising the quadratic program.
pub const fn expansion(np: usize) -> u32 {
    4 * np as u32 + 8
}

/// Most work of a solution in at most `iterations`, from all starts together. A line search that is
/// under way may exceed it by half.
///
/// Hard problems stay within three times their median by it, with windows of 3, 10 and 30 steps
/// (`tests/tests/promises/bounded.rs`), and it hardly ever ends a search that would have led
/// somewhere.
pub const fn budget(np: usize, iterations: u32) -> u32 {
    iterations.saturating_mul(39 + 3 * np as u32)
}
