//! SIGTERM while the camera moves, at any phase of the cycle, once or twice, and at rest: the daemon
//! ends with exit code 0 within half a second, and zero is its last command. How it brakes until
//! then the simulation shows.

use ipc::now_ns;
use messages::TwistState;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rustix::process::Signal;

use crate::fixture::{Place, Running, Stage, Witness, classes, eventually, is_still, some_time};
use crate::judge::in_time;
use crate::reference::Class;
use crate::sheet::Sheet;

const BAR_NS: u64 = 500_000_000;

/// Measures.
pub fn measure(sheet: &mut Sheet) {
    let mut random = ChaCha8Rng::seed_from_u64(1);
    for round in 0..sheet.repeats(6, 100) {
        let what = format!("SIGTERM {round}");
        let took = sheet.round(&classes(), &what, || in_motion(round, &mut random));
        if let Some(ns) = took {
            sheet.longest("ended in motion after", ns, BAR_NS);
        }
    }
    if let Some(ns) = sheet.round(&classes(), "SIGTERM at rest", at_rest) {
        sheet.longest("ended at rest after", ns, BAR_NS);
    }
}

/// Ends the daemon: when it had ended, ns.
fn ended(daemon: Running, witness: &mut Witness) -> u64 {
    let ended = daemon.ended();
    let ended_ns = now_ns();
    assert_eq!(ended.code, Some(0), "{ended:?}");
    let last = witness.commands().pop().expect("a last word");
    let ending = (last.state(), is_still(&last));
    assert_eq!(ending, (Some(TwistState::Stopped), true), "{last:?}");
    ended_ns
}

/// One SIGTERM, or two, at a random phase of the cycle: how long until the end, ns.
fn in_motion(round: usize, random: &mut impl Rng) -> anyhow::Result<u64> {
    let Stage {
        place: _place,
        mut witness,
        daemon,
        camera: _camera,
    } = Stage::in_motion(round)?;
    some_time(4, random);
    let asked_ns = now_ns();
    daemon.signal(Signal::TERM);
    if round % 2 == 1 {
        some_time(1, random);
        daemon.signal(Signal::TERM);
    }
    ended_in_time(daemon, &mut witness, asked_ns)
}

fn at_rest() -> anyhow::Result<u64> {
    let place = Place::new();
    let mut witness = Witness::new(&place);
    let daemon = Running::start(place.vpcd(""));
    eventually("a command", || witness.observer.twist.latest().unwrap());
    let asked_ns = now_ns();
    daemon.signal(Signal::TERM);
    ended_in_time(daemon, &mut witness, asked_ns)
}

/// Judges how long it took from the signal at `asked_ns` to the end of the process, ns.
fn ended_in_time(daemon: Running, witness: &mut Witness, asked_ns: u64) -> anyhow::Result<u64> {
    let ended_ns = ended(daemon, witness);
    Ok(in_time(
        "ended",
        Class::Ordinary,
        asked_ns,
        ended_ns,
        BAR_NS,
    )?)
}
