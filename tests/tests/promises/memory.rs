//! A corrupt memory of motion is refused before anything is armed; a file that is changed, cut or
//! removed while the daemon runs does not reach the loop. Every damaged byte of a file:
//! `cargo test -p memory-blob`.

use std::path::Path;
use std::process::{Command, Stdio};

use ipc::{CameraPorts, Domain};
use messages::Features;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::fixture::{
    Ended, PATIENCE, PERIOD_NS, Place, Running, ended, memory_file, program, scene_file,
};

/// The memory that ships.
fn shipped() -> Vec<u8> {
    std::fs::read(memory_file()).unwrap()
}

/// The daemon, of this scene, with this memory of the place.
fn vpcd(place: &Place, scene: &Path, memory: &str) -> Command {
    let mut command = testkit::command(program("vpcd"));
    command.arg("--scene").arg(scene);
    command.arg("--domain").arg(place.domain());
    command.args(["--strategy", "gpr", "--memory"]);
    command.arg(place.path(memory));
    command.stdout(Stdio::null()).stderr(Stdio::piped());
    command
}

/// The daemon's answer to a memory: exit code and message.
fn judged(place: &Place, name: &str) -> Ended {
    let mut command = vpcd(place, &scene_file(), name);
    command.args(["--arm", "--cycles", "1"]);
    ended(command)
}

#[test]
fn the_daemon_refuses_a_damaged_memory_before_a_cycle() {
    let place = Place::new();
    let mut bytes = shipped();
    place.file("good.vpcmem", &bytes);
    assert_eq!(judged(&place, "good.vpcmem").code, Some(0));
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    place.file("bad.vpcmem", bytes);
    let said = judged(&place, "bad.vpcmem");
    assert_eq!(said.code, Some(65), "{said:?}");
    assert!(said.stderr.contains("bad.vpcmem"), "{said:?}");
}

/// Twists that answer some features, with something done to the memory file on the way.
fn answers(meddle: impl Fn(&Path, usize)) -> Vec<[f64; 6]> {
    let place = Place::new();
    let memory = place.file("m.vpcmem", shipped());
    let domain = Domain::join(&place.domain()).unwrap();
    let mut camera = CameraPorts::open(&domain).unwrap();
    let mut command = vpcd(&place, &scene_file(), "m.vpcmem");
    command.args(["--clock", "lockstep"]).stderr(Stdio::null());
    let mut daemon = Running::start(command);
    let mut random = ChaCha8Rng::seed_from_u64(3);
    let twists = (0..60)
        .map(|k| {
            let (u, v) = (
                random.random_range(200.0..800.0),
                random.random_range(200.0..800.0),
            );
            let square = [[-60.0, -60.0], [60.0, -60.0], [60.0, 60.0], [-60.0, 60.0]];
            let points = square.map(|[x, y]: [f64; 2]| [u + x, v + y]);
            // On the simulated clock of lockstep, so that every run is told the same.
            let at_ns = (k as u64 + 1) * PERIOD_NS;
            let mut features = Features::new(&points, at_ns);
            features.stamp.sequence = k as u64 + 1;
            features.stamp.published_ns = at_ns;
            let sent = camera.features.publish_verbatim(&features).unwrap();
            let answer = camera.wait_for_answer(&sent, PATIENCE).unwrap();
            meddle(&memory, k);
            answer.expect("an answer").message.twist
        })
        .collect();
    assert!(daemon.is_running());
    twists
}

#[test]
fn a_changed_file_does_not_reach_the_running_loop() {
    let undisturbed = answers(|_, _| ());
    assert!(
        undisturbed
            .iter()
            .any(|twist| twist.iter().any(|v| *v != 0.0))
    );
    let overwritten = answers(|memory, k| {
        if k == 20 {
            let size = std::fs::metadata(memory).unwrap().len() as usize;
            std::fs::write(memory, vec![0xff; size]).unwrap();
        }
    });
    assert_eq!(overwritten, undisturbed);
    let cut = answers(|memory, k| {
        if k == 20 {
            std::fs::File::options()
                .write(true)
                .open(memory)
                .unwrap()
                .set_len(0)
                .unwrap();
        }
    });
    assert_eq!(cut, undisturbed);
    let removed = answers(|memory, k| {
        if k == 20 {
            std::fs::remove_file(memory).unwrap();
        }
    });
    assert_eq!(removed, undisturbed);
}
