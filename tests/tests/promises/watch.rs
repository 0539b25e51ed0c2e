//! When the processors stood still.
//!
//! A virtual machine whose host takes a processor away for 50 ms breaks bars of milliseconds
//! through no fault of the programs. A thread on each processor, at a priority above everything
//! under test, looks at the clock again and again: only the machine can make it late. What a
//! promise measured is compared with what the machine did *in that very time*.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Barrier};
use std::thread::JoinHandle;

use controller::clock::sleep_until;
use ipc::now_ns;

use crate::machine::{keep, take_priority};

/// SCHED_FIFO priority above everything under test.
pub const PRIORITY: i32 = 95;
/// Most standstills that are kept of a processor.
const MOST: usize = 1 << 16;

/// A time in which processors may have stood still: from the last instant at which one was seen at
/// work to the first at which it was again, CLOCK_MONOTONIC, ns.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Standstill {
    from_ns: u64,
    to_ns: u64,
}

/// Threads that look at the clock, one on each of some processors.
pub struct Watch {
    end: Arc<AtomicBool>,
    threads: Vec<JoinHandle<Vec<Standstill>>>,
}

impl Watch {
    /// Looks every `tick_ns`; a look that is later than `late_ns` ends a standstill. When this
    /// returns, every thread has begun.
    ///
    /// Without the right to real time nobody has it: these threads are then as ordinary as the
    /// daemon's.
    pub fn start(processors: &[usize], tick_ns: u64, late_ns: u64) -> Self {
        let end = Arc::new(AtomicBool::new(false));
        let begun = Arc::new(Barrier::new(processors.len() + 1));
        let look = |processor: usize| {
            let (end, begun) = (Arc::clone(&end), Arc::clone(&begun));
            std::thread::spawn(move || look(processor, tick_ns, late_ns, &begun, &end))
        };
        let threads = processors.iter().copied().map(look).collect();
        begun.wait();
        Self { end, threads }
    }

    /// What was seen.
    pub fn end(mut self) -> Standstills {
        self.end.store(true, Ordering::Relaxed);
        let threads = std::mem::take(&mut self.threads).into_iter();
        let mut all: Vec<_> = threads.flat_map(|thread| thread.join().unwrap()).collect();
        all.sort_unstable_by_key(|one| one.from_ns);
        // Where processors stood still at the same time, that time counts once.
        let mut apart: Vec<Standstill> = Vec::new();
        for next in all {
            match apart.last_mut() {
                Some(last) if next.from_ns <= last.to_ns => last.to_ns = last.to_ns.max(next.to_ns),
                _ => apart.push(next),
            }
        }
        Standstills(apart)
    }
}

impl Drop for Watch {
    fn drop(&mut self) {
        self.end.store(true, Ordering::Relaxed);
    }
}

fn look(
    processor: usize,
    tick_ns: u64,
    late_ns: u64,
    begun: &Barrier,
    end: &AtomicBool,
) -> Vec<Standstill> {
    // Touched before it counts: a page fault in here would look like the machine's fault.
    let mut found = vec![Standstill::default(); MOST];
    let mut count = 0;
    keep(None, processor);
    take_priority(PRIORITY);
    let mut seen_ns = now_ns();
    begun.wait();
    let mut release_ns = seen_ns;
    while !end.load(Ordering::Relaxed) && count < MOST {
        release_ns += tick_ns;
        sleep_until(release_ns);
        let now = now_ns();
        if now - release_ns > late_ns {
            found[count] = Standstill {
                from_ns: seen_ns,
                to_ns: now,
            };
            count += 1;
            release_ns = now;
        }
        seen_ns = now;
    }
    assert!(
        count < MOST,
        "processor {processor} does nothing but stand still"
    );
    found.truncate(count);
    found
}

/// When some processors stood still, in order and apart from each other.
#[derive(Debug, Default)]
pub struct Standstills(Vec<Standstill>);

impl Standstills {
    /// How much of the time between two instants one of them stood still, ns.
    pub fn between(&self, from_ns: u64, to_ns: u64) -> u64 {
        let first = self.0.partition_point(|one| one.to_ns <= from_ns);
        let inside = self.0[first..].iter().take_while(|one| one.from_ns < to_ns);
        inside
            .map(|one| one.to_ns.min(to_ns) - one.from_ns.max(from_ns))
            .sum()
    }

    /// The longest one, ns.
    pub fn longest_ns(&self) -> u64 {
        self.0
            .iter()
            .map(|one| one.to_ns - one.from_ns)
            .max()
            .unwrap_or(0)
    }
}

#[test]
fn time_is_shared_out_between_standstills() {
    let all = [(10, 20), (30, 50)].map(|(from_ns, to_ns)| Standstill { from_ns, to_ns });
    let seen = Standstills(all.to_vec());
    let cases = [
        ((0, 5), 0),
        ((0, 15), 5),
        ((12, 14), 2),
        ((15, 35), 10),
        ((0, 100), 30),
        ((20, 30), 0),
        ((50, 60), 0),
    ];
    for ((from, to), expected) in cases {
        assert_eq!(seen.between(from, to), expected, "{from} to {to}");
    }
    assert_eq!(seen.longest_ns(), 20);
}
