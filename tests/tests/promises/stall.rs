//! Whether the machine itself stood still while a promise was tested.
//!
//! The limits of the promises are milliseconds of wall time. A virtual machine whose host takes its
//! processors away for 50 ms breaks them through no fault of the programs. A thread on each
//! processor, at a priority above everything under test, wakes up every millisecond and notes how
//! late it is: only the machine can make it late. A trial that missed a limit *while the machine
//! stood still* is void: the test prints that and tries again, a few times at most. A trial that
//! missed a limit while the machine ran fails at once, and so does every failed `assert!`, which
//! checks everything but time.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;

use controller::clock::sleep_until;
use ipc::now_ns;

use crate::fixture::{WAKE_NS, not_run, tell};
use crate::machine::{keep, processors, take_priority};

/// SCHED_FIFO priority above everything under test.
const PRIORITY: i32 = 95;
/// Between two looks at the clock, ns.
const TICK_NS: u64 = 1_000_000;
/// Lateness from which on the machine stood still: what the bars allow for being woken, ns.
const STALL_NS: u64 = WAKE_NS;
/// Most trials of one thing.
const TRIALS: usize = 6;

/// Threads that look at the clock.
struct Watch {
    end: Arc<AtomicBool>,
    threads: Vec<JoinHandle<u64>>,
}

impl Watch {
    fn start() -> Self {
        let end = Arc::new(AtomicBool::new(false));
        let threads = processors().into_iter().map(|processor| {
            let end = Arc::clone(&end);
            std::thread::spawn(move || {
                keep(None, processor);
                // Without the right to real time nobody has it: this thread is then as ordinary as
                // the daemon.
                take_priority(PRIORITY);
                let (mut release, mut latest) = (now_ns(), 0);
                while !end.load(Ordering::Relaxed) {
                    release += TICK_NS;
                    sleep_until(release);
                    let now = now_ns();
                    latest = latest.max(now - release);
                    release = release.max(now - now % TICK_NS);
                }
                latest
            })
        });
        let threads = threads.collect();
        Self { end, threads }
    }

    /// The longest time that a processor stood still, ns.
    fn end(self) -> u64 {
        self.end.store(true, Ordering::Relaxed);
        let latest = self.threads.into_iter().map(|thread| thread.join());
        latest.map(Result::unwrap).max().unwrap_or(0)
    }
}

/// Tries something until it keeps its bars, or misses them on a machine that did not stand still. A
/// trial gives an error (`ensure!`) where it missed a bar of time, and panics at any other fault.
pub fn fairly<T>(what: &str, mut trial: impl FnMut() -> anyhow::Result<T>) -> T {
    for count in 1..=TRIALS {
        let watch = Watch::start();
        let outcome = trial();
        let stood_ns = watch.end();
        let missed = match outcome {
            Ok(value) => return value,
            Err(missed) => missed,
        };
        let stood = format!("the machine itself stood still for {stood_ns} ns");
        assert!(
            stood_ns > STALL_NS && count < TRIALS,
            "{what}, trial {count}: {missed}; {stood}"
        );
        tell(format!("VOID, tried again: {what}: {missed}; {stood}"));
    }
    unreachable!("the last trial has a result or panics")
}

#[test]
fn what_misses_a_bar_is_tried_again_only_where_the_machine_stood_still() {
    // A processor that is taken away: by threads above the watch, one on each.
    let hog = || {
        std::thread::scope(|threads| {
            for processor in processors() {
                threads.spawn(move || {
                    keep(None, processor);
                    take_priority(PRIORITY + 1);
                    let end = now_ns() + 20 * TICK_NS;
                    while now_ns() < end {
                        std::hint::spin_loop();
                    }
                });
            }
        });
    };
    let _turn = crate::fixture::turn();
    if !take_priority(0) || !crate::machine::may_be_real_time() {
        return not_run("stall", "no right to real time");
    }
    let mut trials = 0;
    let taken = fairly("a hog", || {
        trials += 1;
        if trials == 1 {
            hog();
            anyhow::bail!("late");
        }
        Ok(trials)
    });
    assert_eq!(taken, 2);
    let quiet = std::panic::catch_unwind(|| {
        fairly("no hog", || -> anyhow::Result<()> { anyhow::bail!("late") });
    });
    assert!(quiet.is_err());
}
