//! No deadline is missed under load: five seconds of the daemon beside a load of this process
//! (`load`) and a reference of the same scheduling class (`reference`): SCHED_FIFO where that is
//! permitted, else ordinary threads.
//!
//! Red only where the loop missed a release through no fault of the machine: where it would have
//! missed it also if it had not been as late as the reference was in that time. How promptly it
//! wakes up is measured by `cargo xtask measure deadlines`.

use std::sync::atomic::{AtomicBool, Ordering};

use crate::load::{self, EndOnDrop};
use crate::paced::Track;
use crate::reference::Class;

/// Rate, Hz, and cycles: in real time, and as an ordinary thread.
const FIFO: (u32, u64) = (250, 800);
const ORDINARY: (u32, u64) = (30, 100);

#[test]
fn no_release_is_missed_that_a_reference_beside_does_not_miss() {
    let (rate_hz, cycles) = match Class::of_vpcd() {
        Class::Fifo => FIFO,
        Class::Ordinary => ORDINARY,
    };
    let track = Track::new(rate_hz);
    let (done, directory) = (AtomicBool::new(false), track.place.path(""));
    let laps = std::thread::scope(|threads| {
        let _done = EndOnDrop(&done);
        load::work(threads, &directory, &done);
        let (laps, ()) = track.run(cycles, || ());
        done.store(true, Ordering::Relaxed);
        laps
    });
    assert!(laps.report.cycles >= cycles, "{:#?}", laps.report);
    let missed = laps.missed();
    let [ours, machines]: [Vec<_>; 2] = [false, true].map(|is_so| {
        missed
            .iter()
            .filter(|m| m.is_the_machines == is_so)
            .collect()
    });
    testkit::tell(format!(
        "deadlines: {rate_hz} Hz, {:?}: {} cycles, {} steering; {} missed a release, and {} where the reference was late; wake-up p99 {} us, busy p99 {} us",
        track.class,
        laps.count(),
        laps.report.armed,
        ours.len(),
        machines.len(),
        laps.report.wake_ns.p99 / 1000,
        laps.report.busy_ns.p99 / 1000,
    ));
    assert!(ours.is_empty(), "{ours:?}");
}
