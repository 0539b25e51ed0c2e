//! How late the machine was.
//!
//! A *reference* is a thread on each processor in the scheduling class of whom it stands for. Where
//! it was late, a participant of that class may have been late by as much, through no fault of its
//! own; where it was not, only the participant is to blame.
//!
//! - In real time ([`Class::Fifo`]) it wakes up each half a millisecond, one priority above whom it
//!   stands for, so that it never waits for that. Only the machine can make it late.
//! - As an ordinary thread ([`Class::Ordinary`]) it also works for a quarter of the time, as
//!   whoever has something to do, since such a thread loses time in both: until it is woken up, and
//!   while others have its processor. What share of the time it lost while it wanted to run counts
//!   until it wants to run again, for then it cannot tell.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Barrier};
use std::thread::JoinHandle;

use controller::clock::sleep_until;
use ipc::now_ns;

use crate::machine::{keep, may_be_real_time, processors, take_priority};

/// SCHED_FIFO priority of a reference: one above the loop that has the highest.
const ABOVE: i32 = 81;
/// Time between two wake-ups in real time, and lateness from which on one counts, ns.
const FIFO_NS: [u64; 2] = [500_000, 50_000];
/// The same of an ordinary thread, and its work at each wake-up.
const ORDINARY_NS: [u64; 3] = [4_000_000, 200_000, 1_000_000];
/// Two looks at the clock that are farther apart than this had somebody else between them, ns.
const GAP_NS: u64 = 20_000;
/// Most times that are kept of a thread.
const MOST: usize = 1 << 20;

/// A scheduling class.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Class {
    /// SCHED_FIFO.
    Fifo,
    /// SCHED_OTHER.
    Ordinary,
}

impl Class {
    /// That of `vpcd`, and of whom the measurements run in real time, on this machine.
    pub fn of_vpcd() -> Self {
        match may_be_real_time() {
            true => Self::Fifo,
            false => Self::Ordinary,
        }
    }
}

/// A time of which a share was lost, CLOCK_MONOTONIC, ns.
#[derive(Clone, Copy, Debug, Default)]
struct Loss {
    from_ns: u64,
    to_ns: u64,
    share: f64,
}

/// A thread of the reference at work.
struct Thread {
    class: Class,
    losses: JoinHandle<Vec<Loss>>,
}

/// Threads at work.
pub struct Reference {
    end: Arc<AtomicBool>,
    threads: Vec<Thread>,
}

impl Reference {
    /// Begins on all processors that this process may use, in these classes. When this returns,
    /// every thread has begun.
    pub fn start(classes: &[Class]) -> Self {
        let processors = processors();
        let end = Arc::new(AtomicBool::new(false));
        let begun = Arc::new(Barrier::new(classes.len() * processors.len() + 1));
        let thread = |class, processor: usize| {
            let (end, begun) = (Arc::clone(&end), Arc::clone(&begun));
            let losses = std::thread::spawn(move || watch(class, processor, &begun, &end));
            Thread { class, losses }
        };
        let each = classes.iter().flat_map(|class| {
            let on = processors.iter();
            on.map(move |processor| (*class, *processor))
        });
        let threads = each
            .map(|(class, processor)| thread(class, processor))
            .collect();
        begun.wait();
        Self { end, threads }
    }

    /// What was seen.
    pub fn end(mut self) -> Lateness {
        self.end.store(true, Ordering::Relaxed);
        let threads = std::mem::take(&mut self.threads).into_iter();
        Lateness(
            threads
                .map(|thread| (thread.class, thread.losses.join().unwrap()))
                .collect(),
        )
    }
}

impl Drop for Reference {
    fn drop(&mut self) {
        self.end.store(true, Ordering::Relaxed);
    }
}

fn watch(class: Class, processor: usize, begun: &Barrier, end: &AtomicBool) -> Vec<Loss> {
    // Room for a minute, touched before it counts: a page fault in here would look like lateness.
    let mut losses = vec![Loss::default(); 1 << 17];
    losses.clear();
    keep(None, processor);
    let [tick_ns, late_ns, work_ns] = match class {
        Class::Fifo => {
            take_priority(ABOVE);
            [FIFO_NS[0], FIFO_NS[1], 0]
        }
        Class::Ordinary => {
            take_priority(0);
            ORDINARY_NS
        }
    };
    let mut release_ns = now_ns();
    begun.wait();
    while !end.load(Ordering::Relaxed) && losses.len() < MOST {
        release_ns += tick_ns;
        sleep_until(release_ns);
        let done_ns = worked(work_ns);
        let lost_ns = done_ns - release_ns - work_ns.min(done_ns - release_ns);
        if lost_ns > late_ns {
            let to_ns = match work_ns {
                0 => done_ns,
                _ => done_ns.max(release_ns + tick_ns),
            };
            losses.push(Loss {
                from_ns: release_ns,
                to_ns,
                share: lost_ns as f64 / (done_ns - release_ns) as f64,
            });
        }
        // Of a release that passed meanwhile the lateness is counted already.
        release_ns = done_ns.max(release_ns + tick_ns) - tick_ns;
    }
    losses
}

/// Works until it has had a processor for this time: when that was, ns.
fn worked(work_ns: u64) -> u64 {
    let (mut last_ns, mut had_ns) = (now_ns(), 0);
    while had_ns < work_ns {
        let now = now_ns();
        if now - last_ns < GAP_NS {
            had_ns += now - last_ns;
        }
        last_ns = now;
    }
    last_ns
}

/// When the threads of a reference were late.
#[derive(Debug, Default)]
pub struct Lateness(Vec<(Class, Vec<Loss>)>);

impl Lateness {
    /// How much of the time between two instants a thread of this class lost, on the worst
    /// processor, ns. Where none of this class was at work, of any class.
    pub fn between(&self, class: Class, from_ns: u64, to_ns: u64) -> u64 {
        let lost = |losses: &Vec<Loss>| {
            let first = losses.partition_point(|loss| loss.to_ns <= from_ns);
            let inside = losses[first..]
                .iter()
                .take_while(|loss| loss.from_ns < to_ns);
            let each = inside.map(|loss| {
                let ns = loss.to_ns.min(to_ns) - loss.from_ns.max(from_ns);
                loss.share * ns as f64
            });
            each.sum::<f64>() as u64
        };
        self.of(class).map(lost).max().unwrap_or(0)
    }

    /// The longest time that a thread of this class lost at once between two instants, ns.
    pub fn longest_ns(&self, class: Class, from_ns: u64, to_ns: u64) -> u64 {
        let all = self.of(class).flatten();
        let inside = all.filter(|loss| loss.from_ns < to_ns && loss.to_ns > from_ns);
        let each = inside.map(|loss| loss.share * (loss.to_ns - loss.from_ns) as f64);
        each.fold(0.0, f64::max) as u64
    }

    fn of(&self, class: Class) -> impl Iterator<Item = &Vec<Loss>> {
        let is_there = self.0.iter().any(|(of, _)| *of == class);
        let threads = self.0.iter();
        threads
            .filter(move |(of, _)| *of == class || !is_there)
            .map(|(_, losses)| losses)
    }
}

#[test]
fn lost_time_counts_by_its_share_on_the_worst_processor() {
    let loss = |from_ns, to_ns, share| Loss {
        from_ns,
        to_ns,
        share,
    };
    let first = vec![loss(10, 20, 1.0), loss(30, 50, 0.5)];
    let second = vec![loss(32, 36, 1.0)];
    let seen = Lateness(vec![(Class::Fifo, first), (Class::Fifo, second)]);
    let cases = [
        ((0, 5), 0),
        ((0, 15), 5),
        ((12, 14), 2),
        ((15, 40), 10),
        ((31, 37), 4),
        ((0, 100), 20),
        ((20, 30), 0),
        ((50, 60), 0),
    ];
    for ((from, to), expected) in cases {
        // Nobody else was at work: the same for either class.
        for class in [Class::Fifo, Class::Ordinary] {
            assert_eq!(seen.between(class, from, to), expected, "{from} to {to}");
        }
    }
    assert_eq!(seen.longest_ns(Class::Fifo, 0, 100), 10);
    assert_eq!(seen.longest_ns(Class::Fifo, 33, 35), 10);
    assert_eq!(seen.longest_ns(Class::Fifo, 20, 30), 0);
}

#[test]
fn a_thread_that_others_keep_from_its_processor_is_late() {
    // Ordinary threads, on any machine, beside more work than it has processors for.
    let end = AtomicBool::new(false);
    let (from_ns, to_ns, seen) = std::thread::scope(|threads| {
        let _end = crate::load::EndOnDrop(&end);
        for _ in 0..4 * processors().len() {
            threads.spawn(|| {
                while !end.load(Ordering::Relaxed) {
                    std::hint::spin_loop();
                }
            });
        }
        let reference = Reference::start(&[Class::Ordinary]);
        let from_ns = now_ns();
        std::thread::sleep(std::time::Duration::from_millis(500));
        (from_ns, now_ns(), reference.end())
    });
    let lost_ns = seen.between(Class::Ordinary, from_ns, to_ns);
    assert!(lost_ns > (to_ns - from_ns) / 4, "{lost_ns} ns");
}
