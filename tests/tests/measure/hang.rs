//! When the daemon hangs, the emulated robot stops by itself. What the daemon does when it goes on
//! after such a gap the simulation shows; that the watchdog is no longer fed, `watchdog`.

use ipc::now_ns;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rustix::process::Signal;

use crate::fixture::{Stage, WAKE_NS, classes, some_time};
use crate::judge::in_time;
use crate::reference::Class;
use crate::sheet::Sheet;

/// From the hang to standstill, ns.
const STANDS_NS: u64 = 100_000_000 + WAKE_NS;

/// Measures.
pub fn measure(sheet: &mut Sheet) {
    let mut random = ChaCha8Rng::seed_from_u64(1);
    for round in 0..sheet.repeats(3, 20) {
        let what = format!("hang {round}");
        if let Some(ns) = sheet.round(&classes(), &what, || hang(round, &mut random)) {
            sheet.longest("the robot stands after", ns, STANDS_NS);
        }
    }
}

/// One hang, at a random phase of the cycle: how long until the robot stood, ns.
fn hang(round: usize, random: &mut impl Rng) -> anyhow::Result<u64> {
    let mut stage = Stage::in_motion(round)?;
    some_time(4, random);
    stage.daemon.halt(Signal::STOP);
    let stopped_ns = now_ns();
    let stands_ns = stage.witness.until_it_stands(stopped_ns, &mut stage.camera);
    let class = Class::of_vpcd();
    Ok(in_time(
        "the robot stands",
        class,
        stopped_ns,
        stands_ns,
        STANDS_NS,
    )?)
}
