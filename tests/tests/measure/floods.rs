//! Floods of requests, subscribers that never read, and peers that come and go: no release is
//! missed.

use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use ipc::{CameraPorts, Domain, Observer, OperatorPorts, now_ns};
use messages::{Features, Request};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::fixture::{PERIOD_NS, Place, Running, Witness, classes};
use crate::judge::Miss;
use crate::load::EndOnDrop;
use crate::reference::Class;
use crate::sheet::Sheet;

/// A camera at its rate, for a daemon on the fixed clock.
fn film(place: &Path, rate_hz: f64, end: &AtomicBool) {
    let domain = Domain::join(place).unwrap();
    let mut camera = CameraPorts::open(&domain).unwrap();
    let far = [
        [250.0, 250.0],
        [420.0, 260.0],
        [410.0, 430.0],
        [240.0, 420.0],
    ];
    let mut random = ChaCha8Rng::seed_from_u64(4);
    while !end.load(Ordering::Relaxed) {
        // Real images are never the same.
        let points = far.map(|point| point.map(|x| x + random.random_range(-0.1..0.1)));
        camera
            .features
            .publish(&Features::new(&points, now_ns()))
            .unwrap();
        std::thread::sleep(Duration::from_secs_f64(1.0 / rate_hz));
    }
}

/// Operators who ask without a pause.
fn flood(place: &Path, end: &AtomicBool) {
    let domain = Domain::join(place).unwrap();
    let mut operator = OperatorPorts::open(&domain).unwrap();
    let mut id = 0;
    while !end.load(Ordering::Relaxed) {
        id += 1;
        let request = Request::new(id, messages::Action::Status);
        operator.requests.publish(&request).unwrap();
        // A processor of its own it does not get.
        if id % 64 == 0 {
            std::thread::sleep(Duration::from_millis(1));
        }
    }
}

/// Peers that come and go.
fn churn(place: &Path, end: &AtomicBool) {
    while !end.load(Ordering::Relaxed) {
        let domain = Domain::join(place).unwrap();
        // Where all places are taken it is refused: as good as a visit.
        let _ = Observer::open(&domain);
    }
}

/// Cycles in some seconds of attack, none of which missed a release.
fn attacked(seconds: u64) -> anyhow::Result<u64> {
    let place = Place::new();
    let mut witness = Witness::new(&place);
    let daemon =
        Running::start(place.vpcd("[law]\nstrategy = 'previous'\n[safety]\nrobot = 'optional'"));
    let end = AtomicBool::new(false);
    let domain = place.domain();
    let cycles = std::thread::scope(|threads| {
        let _end = EndOnDrop(&end);
        let (domain, end) = (&domain, &end);
        threads.spawn(move || film(domain, 30.0, end));
        witness.set_in_motion()?;
        threads.spawn(move || flood(domain, end));
        threads.spawn(move || churn(domain, end));
        // Never read: hoards whatever is sent.
        let hoarders = Domain::join(domain)?;
        let _hoarders: Vec<_> = (0..3)
            .map_while(|_| Observer::open(&hoarders).ok())
            .collect();
        witness.records();
        let (begin_ns, mut records) = (now_ns(), Vec::new());
        for _ in 0..seconds {
            // Half a minute of records waits at most.
            std::thread::sleep(Duration::from_secs(1));
            records.extend(witness.records());
        }
        let missed: Vec<_> = records
            .windows(2)
            .filter(|pair| pair[1].overruns > pair[0].overruns)
            .collect();
        if let [first, ..] = missed[..] {
            let what = format!("{} cycles missed a release", missed.len());
            let from_ns = first[1].stamp.data_ns - first[1].wake_latency_ns;
            let to_ns = from_ns + 2 * PERIOD_NS;
            return Err(Miss::upset(what, Class::of_vpcd(), from_ns, to_ns).into());
        }
        let (Some(first), Some(last)) = (records.first(), records.last()) else {
            let what = "no record";
            return Err(Miss::upset(what, Class::Ordinary, begin_ns, now_ns()).into());
        };
        Ok(last.cycle - first.cycle)
    });
    daemon.kill();
    cycles
}

/// Measures.
pub fn measure(sheet: &mut Sheet) {
    let seconds = sheet.repeats(3, 60) as u64;
    if let Some(cycles) = sheet.round(&classes(), "floods", || attacked(seconds)) {
        sheet.figure("cycles", cycles as f64, "");
        sheet.bar("releases missed", 0.0, "", 0.0);
        let least = 0.9 * 30.0 * (seconds - 1) as f64;
        if (cycles as f64) < least {
            sheet.lacks(format!("records of {cycles} cycles"));
        }
    }
}
