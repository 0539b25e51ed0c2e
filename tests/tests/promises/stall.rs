//! Bars of time, judged by what the machine did meanwhile.
//!
//! The limits of the promises are milliseconds of wall time. Something that took too long is
//! `late`, with the time that it took. It is void, and tried again, where it would have kept its
//! bar without the part of *that* time in which the machine stood still (`watch`). A standstill at
//! another time excuses nothing, and every failed `assert!`, which checks all but time, fails at
//! once. Of what is no duration (`ensure!`: releases missed, for instance) the whole trial is the
//! time.

use std::fmt;

use ipc::now_ns;

use crate::fixture::{WAKE_NS, not_run, tell};
use crate::machine::{processors, take_priority};
use crate::watch::{Standstills, Watch};

/// Between two looks at the clock, ns.
const TICK_NS: u64 = 1_000_000;
/// Lateness from which on the machine stood still: what the bars allow for being woken, ns.
const STALL_NS: u64 = WAKE_NS;
/// Most trials of one thing.
const TRIALS: usize = 6;

/// Something that took longer than its bar.
#[derive(Debug)]
struct Late {
    what: &'static str,
    from_ns: u64,
    to_ns: u64,
    bar_ns: u64,
}

impl fmt::Display for Late {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let took = (self.to_ns - self.from_ns) as f64 / 1e6;
        write!(
            f,
            "{} after {took:.1} ms, bar {:.1} ms",
            self.what,
            self.bar_ns as f64 / 1e6
        )
    }
}

impl std::error::Error for Late {}

/// How long something took, ns, if that was no longer than its bar; `from` and `to` are instants of
/// CLOCK_MONOTONIC, ns.
pub fn in_time(what: &'static str, from_ns: u64, to_ns: u64, bar_ns: u64) -> anyhow::Result<u64> {
    let took_ns = to_ns - from_ns;
    match took_ns <= bar_ns {
        true => Ok(took_ns),
        false => Err(Late {
            what,
            from_ns,
            to_ns,
            bar_ns,
        }
        .into()),
    }
}

/// Whether the machine is to blame for a bar that was missed in a trial.
fn is_void(missed: &anyhow::Error, trial_ns: [u64; 2], seen: &Standstills) -> bool {
    match missed.downcast_ref::<Late>() {
        Some(late) => {
            let stood_ns = seen.between(late.from_ns, late.to_ns);
            late.to_ns - late.from_ns <= late.bar_ns + stood_ns
        }
        None => seen.between(trial_ns[0], trial_ns[1]) > 0,
    }
}

/// Tries something until it keeps its bars, or misses them through its own fault. A trial gives an
/// error (`in_time`, `ensure!`) where it missed a bar of time, and panics at any other fault.
pub fn fairly<T>(what: &str, mut trial: impl FnMut() -> anyhow::Result<T>) -> T {
    for count in 1..=TRIALS {
        let watch = Watch::start(&processors(), TICK_NS, STALL_NS);
        let begin_ns = now_ns();
        let outcome = trial();
        let trial_ns = [begin_ns, now_ns()];
        let seen = watch.end();
        let missed = match outcome {
            Ok(value) => return value,
            Err(missed) => missed,
        };
        let stood = seen.longest_ns() / 1_000_000;
        let stood = format!("the machine stood still for {stood} ms at most");
        assert!(
            is_void(&missed, trial_ns, &seen) && count < TRIALS,
            "{what}, trial {count}: {missed}; {stood}"
        );
        tell(format!("VOID, tried again: {what}: {missed}; {stood}"));
    }
    unreachable!("the last trial has a result or panics")
}

/// Takes the processors away for this time, by threads above the watch, one on each.
fn hog(ns: u64) {
    std::thread::scope(|threads| {
        for processor in processors() {
            threads.spawn(move || {
                crate::machine::keep(None, processor);
                take_priority(crate::watch::PRIORITY + 1);
                let end = now_ns() + ns;
                while now_ns() < end {
                    std::hint::spin_loop();
                }
            });
        }
    });
}

#[test]
fn a_missed_bar_is_void_only_where_the_machine_stood_still() {
    const MS: u64 = 1_000_000;
    let _turn = crate::fixture::turn();
    if !take_priority(0) || !crate::machine::may_be_real_time() {
        return not_run("stall", "no right to real time");
    }
    const BAR_NS: u64 = 80 * MS;
    let sleep = |ms| std::thread::sleep(std::time::Duration::from_millis(ms));
    // 110 ms and a little, of which the machine takes 100: the bar of 80 would have been kept.
    let mut trials = 0;
    let taken = fairly("a hog", || {
        trials += 1;
        let from_ns = now_ns();
        if trials == 1 {
            hog(100 * MS);
            sleep(10);
        }
        in_time("it", from_ns, now_ns(), BAR_NS)?;
        Ok(trials)
    });
    assert_eq!(taken, 2);
    // What fails: a hog at another time, one that is too short, and none.
    let fails = |trial: &dyn Fn() -> anyhow::Result<u64>| {
        let trial = std::panic::AssertUnwindSafe(|| fairly("it", trial));
        assert!(std::panic::catch_unwind(trial).is_err());
    };
    fails(&|| {
        hog(100 * MS);
        let from_ns = now_ns();
        sleep(200);
        in_time("another time", from_ns, now_ns(), BAR_NS)
    });
    fails(&|| {
        let from_ns = now_ns();
        hog(20 * MS);
        sleep(200);
        in_time("too short", from_ns, now_ns(), BAR_NS)
    });
    fails(&|| anyhow::bail!("none"));
}
