//! kill -9 of daemon, emulator and client at random moments of their start-up: the next start
//! always works, and nothing is left in shared memory.

use std::process::Stdio;
use std::time::Duration;

use ipc::Domain;
use messages::TwistState;
use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rustix::process::Signal;

use crate::fixture::{Place, Running, Witness, classes, eventually};
use crate::sheet::Sheet;

/// Kills between two tries of the whole.
const KILLS: usize = 25;

/// Measures.
pub fn measure(sheet: &mut Sheet) {
    let mut random = ChaCha8Rng::seed_from_u64(1);
    let place = Place::new();
    let rounds = sheet.repeats(3, 40);
    for round in 0..rounds {
        let what = format!("round {round}");
        sheet.round(&classes(), &what, || kills(round, &place, &mut random));
    }
    sheet.figure("kills", (rounds * KILLS) as f64, "");
}

/// Kills, and a start that works.
fn kills(round: usize, place: &Place, random: &mut impl Rng) -> anyhow::Result<()> {
    for _ in 0..KILLS {
        let mut command = match random.random_range(0..3) {
            0 => place.vpcd(""),
            1 => place.hw_sim(0),
            _ => {
                let mut client = place.vpcctl();
                client.arg("arm");
                client
            }
        };
        command.stdout(Stdio::null()).stderr(Stdio::null());
        let process = Running::start(command);
        std::thread::sleep(Duration::from_micros(random.random_range(0..60_000)));
        process.kill();
    }
    let mut witness = Witness::new(place);
    let daemon = Running::start(place.vpcd(""));
    let camera = Running::start(place.hw_sim(round % 100));
    witness.set_in_motion()?;
    daemon.signal(Signal::TERM);
    let ended = daemon.ended();
    assert_eq!(ended.code, Some(0), "round {round}: {ended:?}");
    let last = witness.commands().pop().expect("a last word");
    assert_eq!(last.state(), Some(TwistState::Stopped), "round {round}");
    camera.kill();
    // The killed camera is cleared away by who comes next.
    drop(witness);
    drop(Domain::join(&place.domain()).unwrap());
    let left = eventually("shared memory is empty", || {
        let left = Domain::segments(&place.domain()).unwrap();
        (left == 0).then_some(left)
    });
    assert_eq!(left, 0);
    // Of the domain's own files the two of the guard stay, its generation, the daemon's for its
    // process number, the stop's, and the directory of places.
    let files: Vec<_> = std::fs::read_dir(place.domain())
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect();
    assert!(files.len() <= 6, "round {round}: {files:?}");
    Ok(())
}
