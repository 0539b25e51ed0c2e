//! No deadline is missed under load, and the loop wakes up about as promptly as the machine can:
//! thousands of cycles of the daemon, in real time on a processor of its own, beside a load
//! (`load`) and a reference on that processor with the same period. Its priority is one higher, so
//! that it never waits for the loop; it takes a few us of a period.
//!
//! `VPC_WITHOUT=realtime` runs the daemon as an ordinary thread, to see this break.

use std::sync::atomic::{AtomicBool, Ordering};

use controller::clock::sleep_until;
use ipc::now_ns;

use crate::load;
use crate::load::EndOnDrop;
use crate::machine::{keep, take_priority};
use crate::paced::{Laps, START_UP_NS, Track, processor};
use crate::reference::Class;
use crate::sheet::Sheet;

/// SCHED_FIFO priority of the thread that wakes up beside the loop.
const ABOVE: i32 = 81;
/// Most of its wake-ups that are kept.
const MOST: usize = 1 << 16;
/// The limit of the late wake-ups: this factor times those of the reference, plus this time, us.
const BAR: (f64, f64) = (2.0, 20.0);
/// Beyond so many times the limit they are no chance.
const CHANCE: f64 = 3.0;
/// Most of the cycles in which the reference may be late by a quarter of the period.
const UNFIT: f64 = 0.25;

/// Wakes up every period, until `done`: how late, us, ascending.
fn wake_up(track: &Track, done: &AtomicBool) -> Vec<f64> {
    let mut all = vec![f64::NAN; MOST];
    all.clear();
    if track.class == Class::Fifo {
        keep(None, processor());
        take_priority(ABOVE);
    }
    let begin_ns = now_ns();
    let mut release_ns = begin_ns;
    while !done.load(Ordering::Relaxed) && all.len() < MOST {
        release_ns += track.period_ns;
        sleep_until(release_ns);
        let woken_ns = now_ns();
        if woken_ns > begin_ns + START_UP_NS {
            all.push((woken_ns - release_ns) as f64 / 1e3);
        }
        release_ns += (woken_ns - release_ns) / track.period_ns * track.period_ns;
    }
    all.sort_unstable_by(f64::total_cmp);
    all
}

/// This share of the sorted values is not larger.
fn quantile(sorted: &[f64], share: f64) -> f64 {
    sorted[((sorted.len() - 1) as f64 * share) as usize]
}

/// Runs the daemon for so many cycles beside everything that disturbs and measures it; with how
/// late the reference woke up, us, ascending.
fn run(track: &Track, cycles: u64) -> (Laps, Vec<f64>) {
    let done = AtomicBool::new(false);
    let directory = track.place.path("");
    std::thread::scope(|threads| {
        let _done = EndOnDrop(&done);
        load::work(threads, &directory, &done);
        let reference = threads.spawn(|| wake_up(track, &done));
        let (laps, ()) = track.run(cycles, || ());
        done.store(true, Ordering::Relaxed);
        (laps, reference.join().unwrap())
    })
}

/// Measures at this rate.
pub fn measure(rate_hz: u32, sheet: &mut Sheet) {
    let short = if rate_hz > 100 { 1_500 } else { 120 };
    let cycles = sheet.repeats(short, 18_000) as u64;
    let track = Track::new(rate_hz);
    let (laps, reference) = run(&track, cycles);
    // Ten wake-ups or one of a hundred are later.
    let share = (1.0 - 10.0 / cycles as f64).min(0.99);
    let late: Vec<f64> = laps.late_ns().iter().map(|ns| *ns as f64 / 1e3).collect();
    let (wake, beside) = (quantile(&late, share), quantile(&reference, share));
    let bar = BAR.0 * beside + BAR.1;
    let missed = laps.missed();
    let count = |is_the_machines| -> u64 {
        let ours = missed
            .iter()
            .filter(|m| m.is_the_machines == is_the_machines);
        ours.map(|m| m.count).sum()
    };
    let (own, machines) = (count(false), count(true));
    let (report, disturbed) = (&laps.report, laps.disturbed());
    sheet.figure("cycles", laps.count() as f64, "");
    sheet.figure("steering", report.armed as f64, "");
    sheet.bar("releases missed", own as f64, "", 0.0);
    sheet.figure("missed where the reference was late", machines as f64, "");
    sheet.bar(&format!("wake-up p{:.0}", share * 100.0), wake, "us", bar);
    sheet.figure("reference", beside, "us");
    sheet.figure("decision p99", report.step_ns.p99 as f64 / 1e3, "us");
    sheet.figure("busy p99", report.busy_ns.p99 as f64 / 1e3, "us");
    sheet.figure("cycles disturbed", disturbed * 100.0, "%");
    if laps.count() < cycles / 2 {
        sheet.lacks(format!("{} records of {cycles} cycles", laps.count()));
    }
    sheet.check(own == 0, || {
        let first = missed.iter().find(|m| !m.is_the_machines);
        format!("{own} releases missed, first {first:?}")
    });
    if track.class == Class::Ordinary {
        return sheet.lacks("no right to real time (vpcd --preflight)");
    }
    let faults = [report.minor_faults, report.major_faults];
    let counted = (faults, report.blocked, report.allocations);
    sheet.check(counted == ([0; 2], 0, 0), || {
        format!("faults, blocking calls, heap calls: {counted:?}")
    });
    if disturbed > UNFIT {
        let share = disturbed * 100.0;
        return sheet.lacks(format!(
            "the reference was late in {share:.0} % of the cycles"
        ));
    }
    let said = format!("wake-up p{:.0} {wake:.0} us, bar {bar:.0}", share * 100.0);
    sheet.check(wake <= CHANCE * bar, || said.clone());
    if wake > bar {
        sheet.lacks(format!("{said}: may be chance"));
    }
}
