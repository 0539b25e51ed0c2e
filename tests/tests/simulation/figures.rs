//! The times of a run, and the greatest of many runs.

use std::fmt;

use crate::fault::Fault;
use crate::promise::{COUNT, PROMISES};
use crate::world::Found;

const MS: u64 = 1_000_000;

/// The most of a fault's runs: times, ns, and the greatest step, as a share of the limits.
#[derive(Clone, Copy, Debug, Default)]
pub struct Figures {
    /// From the last good features or the fault to the first command that is not the law's.
    pub brakes_ns: u64,
    /// To the first zero.
    pub zero_ns: u64,
    /// The same where the scene limits the acceleration.
    pub limited_ns: u64,
    /// To the end of the robot's motion, where no commands come.
    pub rest_ns: u64,
    /// From SIGTERM to the end.
    pub end_ns: u64,
    /// From the asking of a stop to zero.
    pub stop_ns: u64,
    /// For how long the law is fast while robot or image lie.
    pub fast_ns: u64,
    /// The greatest step.
    pub steepest: f64,
    /// The deepest of a guarded point, px.
    pub deepest_px: f64,
    /// How often each promise was checked.
    pub checks: [u64; COUNT],
}

impl Figures {
    /// The greater of each, and the checks of both.
    pub fn max(self, other: Self) -> Self {
        Self {
            brakes_ns: self.brakes_ns.max(other.brakes_ns),
            zero_ns: self.zero_ns.max(other.zero_ns),
            limited_ns: self.limited_ns.max(other.limited_ns),
            rest_ns: self.rest_ns.max(other.rest_ns),
            end_ns: self.end_ns.max(other.end_ns),
            stop_ns: self.stop_ns.max(other.stop_ns),
            fast_ns: self.fast_ns.max(other.fast_ns),
            steepest: self.steepest.max(other.steepest),
            deepest_px: self.deepest_px.max(other.deepest_px),
            checks: std::array::from_fn(|k| self.checks[k] + other.checks[k]),
        }
    }
}

impl fmt::Display for Figures {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let times = [
            ("brakes", self.brakes_ns),
            ("zero", self.zero_ns),
            ("zero with limited acceleration", self.limited_ns),
            ("rest", self.rest_ns),
            ("end", self.end_ns),
            ("stop", self.stop_ns),
            ("fast", self.fast_ns),
        ];
        for (name, ns) in times.into_iter().filter(|(_, ns)| *ns > 0) {
            write!(f, "{name} {} ms, ", ns.div_ceil(MS))?;
        }
        write!(f, "step {:.4} of the limit", self.steepest)?;
        if self.deepest_px > 0.0 {
            write!(f, ", {:.2} px deep", self.deepest_px)?;
        }
        Ok(())
    }
}

/// Prints the greatest figures of a fault's runs, and what each promise saw in them.
pub fn print(fault: Fault, found: &[&Found]) {
    let figures = found.iter().map(|found| found.figures);
    let most = figures.fold(Figures::default(), Figures::max);
    let cycles: u64 = found.iter().map(|found| found.cycles).sum();
    let seconds = found.iter().map(|found| found.took_ns).sum::<u64>() / 1_000_000_000;
    let (runs, broken) = (
        found.len(),
        found.iter().filter(|one| one.broken.is_some()).count(),
    );
    println!(
        "{fault:?}: {runs} runs, {broken} broken, {seconds} s, {cycles} cycles; at most {most}"
    );
    for (promise, name, line) in PROMISES {
        let checks = most.checks[*promise as usize];
        println!("{fault:?} saw {name}: {line}: {checks}");
    }
}
