//! No deadline is missed under load, and the loop wakes up about as promptly as the machine can:
//! thousands of cycles of the daemon, in real time on processor 1, beside a load (`load`) and a
//! reference: a thread on the same processor, with the same period. Its priority is one higher, so
//! that it never waits for the loop; it takes a few us of a period.
//!
//! What the machine itself does is taken off each wake-up, also of the reference, and off each miss
//! (`watch`). A release that was missed while the processor ran is a failure, at once. The late
//! wake-ups are compared with those of the reference; chance has a part in that, so of three runs
//! one must pass. Where the processor stood still for a quarter of the period in one of four
//! cycles, nothing is shown: neither passed nor failed.
//!
//! Where `stress-ng` and `cyclictest` are installed, they load and measure, too, and the bar is
//! that of the prompter of all references.
//!
//! 1,500 cycles at 250 Hz take 6 s, 120 at the real 30 Hz four more. At full length there are
//! 18,000 of each, which take eleven minutes:
//!
//!     VPC_LONG=1 cargo test --test promises deadlines
//!
//! `VPC_WITHOUT=realtime` runs the daemon as an ordinary thread, to see the test fail.

use std::process::Stdio;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use controller::clock::sleep_until;
use ipc::now_ns;

use crate::fixture::{EndOnDrop, Running, repeats, tell, turn};
use crate::load;
use crate::machine::{keep, may_have_a_processor, take_priority};
use crate::paced::{Laps, PRIORITY, PROCESSOR, START_UP_NS, Track};
use crate::watch::Standstills;

/// SCHED_FIFO priority of the references.
const ABOVE: i32 = PRIORITY + 1;
/// Most wake-ups that are kept of a reference.
const MOST: usize = 1 << 16;
/// The limit: this factor times the reference, plus this time, us.
const BAR: (f64, f64) = (2.0, 20.0);
/// Runs at most.
const RUNS: usize = 3;
/// Most of the cycles in which the processor may stand still.
const UNFIT: f64 = 0.25;

/// A release of a reference.
#[derive(Clone, Copy, Default)]
struct WakeUp {
    release_ns: u64,
    woken_ns: u64,
}

/// Wakes up every period, until `done`.
fn wake_up(period_ns: u64, done: &AtomicBool) -> Vec<WakeUp> {
    let mut all = vec![WakeUp::default(); MOST];
    keep(None, PROCESSOR);
    take_priority(ABOVE);
    let begin_ns = now_ns();
    let (mut release_ns, mut count) = (begin_ns, 0);
    while !done.load(Ordering::Relaxed) && count < MOST {
        release_ns += period_ns;
        sleep_until(release_ns);
        let woken_ns = now_ns();
        if woken_ns > begin_ns + START_UP_NS {
            all[count] = WakeUp {
                release_ns,
                woken_ns,
            };
            count += 1;
        }
        release_ns += (woken_ns - release_ns) / period_ns * period_ns;
    }
    all.truncate(count);
    all
}

/// Latenesses of one thread after the start-up, us, ascending.
struct Reference(Vec<f64>);

impl Reference {
    fn new(late: impl Iterator<Item = f64>) -> Self {
        let mut late: Vec<f64> = late.collect();
        late.sort_unstable_by(f64::total_cmp);
        Self(late)
    }

    /// Of a thread that was woken up at these times after its releases, without the time in which
    /// its processor stood still.
    fn corrected(wake_ups: Vec<WakeUp>, seen: &Standstills) -> Self {
        let late = |wake_up: WakeUp| {
            let WakeUp {
                release_ns,
                woken_ns,
            } = wake_up;
            let late_ns = woken_ns - release_ns - seen.between(release_ns, woken_ns);
            late_ns as f64 / 1e3
        };
        Self::new(wake_ups.into_iter().map(late))
    }

    /// Of what `cyclictest --verbose` prints: `thread:wake-up:us`, a line each.
    fn parse(printed: &str, start_up: u64) -> Self {
        let late = |line: &str| {
            let mut numbers = line.split(':').map(|number| number.trim().parse::<u64>());
            let mut next = || numbers.next()?.ok();
            let (_thread, wake_up, late) = (next()?, next()?, next()?);
            (wake_up >= start_up).then_some(late as f64)
        };
        Self::new(printed.lines().filter_map(late))
    }

    /// This share of the wake-ups is not later, us.
    fn quantile(&self, share: f64) -> f64 {
        self.0[((self.0.len() - 1) as f64 * share) as usize]
    }
}

/// `stress-ng`, and `cyclictest` as another reference.
fn outside(track: &Track, cycles: u64) -> [Running; 2] {
    let seconds = (cycles + track.start_up()) * track.period_ns / 1_000_000_000 + 2;
    let mut stress = testkit::command("stress-ng");
    stress.args([
        "--cpu",
        "2",
        "--switch",
        "1",
        "--vm",
        "1",
        "--vm-bytes",
        "64M",
        "--quiet",
    ]);
    stress.args(["--timeout", &format!("{seconds}s")]);
    let mut cyclictest = testkit::command("cyclictest");
    cyclictest.args(["--verbose", "--mlockall", "--policy=fifo", "--threads=1"]);
    cyclictest.arg(format!("--affinity={PROCESSOR}"));
    cyclictest.arg(format!("--priority={ABOVE}"));
    cyclictest.arg(format!("--interval={}", track.period_ns / 1000));
    cyclictest.arg(format!("--loops={}", cycles + track.start_up()));
    let measured = std::fs::File::create(track.place.path("cyclictest.txt")).unwrap();
    stress.stdout(Stdio::null()).stderr(Stdio::null());
    cyclictest.stdout(measured).stderr(Stdio::null());
    [Running::start(stress), Running::start(cyclictest)]
}

/// Runs the daemon for `cycles` beside everything that disturbs and measures it.
fn run(track: &Track, cycles: u64, has_outside: bool) -> (Laps, Vec<Reference>) {
    let done = AtomicBool::new(false);
    let directory = track.place.path("");
    let (laps, wake_ups) = std::thread::scope(|threads| {
        let _done = EndOnDrop(&done);
        load::work(threads, &directory, &done);
        let reference = threads.spawn(|| wake_up(track.period_ns, &done));
        let (laps, outside) = track.run(cycles, || has_outside.then(|| outside(track, cycles)));
        if let Some([_stress, cyclictest]) = outside {
            let ended = cyclictest.ended_within(Duration::from_secs(30));
            assert_eq!(ended.code, Some(0));
        }
        done.store(true, Ordering::Relaxed);
        (laps, reference.join().unwrap())
    });
    let mut references = vec![Reference::corrected(wake_ups, &laps.standstills)];
    if has_outside {
        let printed = std::fs::read_to_string(track.place.path("cyclictest.txt")).unwrap();
        references.push(Reference::parse(&printed, track.start_up()));
    }
    (laps, references)
}

/// The result of a run.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Verdict {
    Passed,
    /// It woke up late, which chance can do.
    Late,
    /// The machine is unfit.
    NotShown,
}

/// Judges a run and prints the result; panics where the loop missed a release by itself.
fn judge(rate_hz: u32, cycles: u64, has_outside: bool) -> Verdict {
    let track = Track::new(rate_hz);
    let (laps, references) = run(&track, cycles, has_outside);
    let late = Reference::new(laps.late_ns().iter().map(|ns| *ns as f64 / 1e3));
    for thread in references.iter().chain([&late]) {
        let count = thread.0.len() as u64;
        assert!(count >= cycles / 2, "{count} wake-ups in {cycles} cycles");
    }
    // Ten wake-ups or one of a hundred are later.
    let share = (1.0 - 10.0 / cycles as f64).min(0.99);
    let each: Vec<f64> = references
        .iter()
        .map(|thread| thread.quantile(share))
        .collect();
    let best = each.iter().copied().fold(f64::INFINITY, f64::min);
    let (wake, bar) = (late.quantile(share), BAR.0 * best + BAR.1);
    let (report, disturbed) = (&laps.report, laps.disturbed());
    let missed = laps.missed();
    tell(format!(
        "deadlines: {rate_hz} Hz, {} cycles, {} steering: {missed} missed, and {} while the processor stood still ({:.1} ms at most, in {:.1} % of the cycles); wake-up p{:.0} {wake:.0} us (bar {bar:.0}), with the machine's part p50 {} max {} us; references {each:.0?} us; a decision p50 {} p99 {} us; busy p99 {} us",
        report.cycles,
        report.armed,
        report.overruns - missed,
        laps.standstills.longest_ns() as f64 / 1e6,
        disturbed * 100.0,
        share * 100.0,
        report.wake_ns.p50 / 1000,
        report.wake_ns.max / 1000,
        report.step_ns.p50 / 1000,
        report.step_ns.p99 / 1000,
        report.busy_ns.p99 / 1000,
    ));
    assert_eq!(
        missed, 0,
        "releases missed at {rate_hz} Hz while the processor ran"
    );
    if disturbed > UNFIT {
        return Verdict::NotShown;
    }
    match wake <= bar {
        true => Verdict::Passed,
        false => Verdict::Late,
    }
}

/// Runs until one run passes: whether one did. Panics if none did, and not all of them were unfit.
fn check(rate_hz: u32, cycles: u64, has_outside: bool) -> bool {
    let mut verdicts = Vec::new();
    for _ in 0..RUNS {
        match judge(rate_hz, cycles, has_outside) {
            Verdict::Passed => return true,
            verdict => verdicts.push(verdict),
        }
    }
    let is_shown = verdicts.iter().all(|verdict| *verdict == Verdict::NotShown);
    assert!(
        is_shown,
        "no run of {RUNS} at {rate_hz} Hz passed: {verdicts:?}"
    );
    false
}

#[test]
fn no_deadline_is_missed_under_load() {
    let _turn = turn();
    if !may_have_a_processor("deadlines") {
        return;
    }
    let programs = ["stress-ng", "cyclictest=rt-tests"];
    let has_outside =
        testkit::are_installed("deadlines beside others' load and reference", &programs);
    let mut not_shown = Vec::new();
    for (rate_hz, cycles) in [(250, 1_500), (30, 120)] {
        let cycles = repeats(
            &format!("deadlines, cycles at {rate_hz} Hz"),
            cycles,
            18_000,
        );
        if !check(rate_hz, cycles as u64, has_outside) {
            not_shown.push(format!("{rate_hz} Hz"));
        }
    }
    if !not_shown.is_empty() {
        tell(format!(
            "deadlines: NOT SHOWN on this machine, which stood still too often: {}",
            not_shown.join(", ")
        ));
    }
}
