//! A corrupt memory of motion is refused before anything is armed; a file that is changed, cut or
//! removed while the daemon runs does not reach the loop.

use std::path::Path;
use std::process::{Command, Stdio};
use std::time::Duration;

use ipc::{CameraPorts, Domain};
use memory_blob::MemoryFile;
use messages::Features;
use rand::seq::SliceRandom;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use scene::Scene;
use serde_json::Value;

use crate::fixture::{
    Ended, PERIOD_NS, Place, Running, ended, memory_file, program, repeats, scene_file, turn,
};

const PATIENCE: Duration = Duration::from_secs(10);

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
pub fn judged(place: &Place, name: &str) -> Ended {
    let mut command = vpcd(place, &scene_file(), name);
    command.args(["--arm", "--cycles", "1"]);
    ended(command)
}

#[test]
fn every_damaged_header_byte_and_body_bit_is_refused() {
    let _turn = turn();
    let place = Place::new();
    let good = shipped();
    let scene = Scene::read(&scene_file()).unwrap();
    let task = scene.fingerprint();
    let opens = |bytes: &[u8], random: u64| {
        let path = place.file("forged.vpcmem", bytes);
        let opened = MemoryFile::open(&path, Some(task.bytes()));
        assert!(opened.is_err(), "damage {random} was not seen");
    };
    assert!(MemoryFile::open(&place.file("good.vpcmem", &good), Some(task.bytes())).is_ok());
    // In process: what the daemon calls. Digests of megabytes take time; a few bytes of the header
    // are sampled where the full length was not asked for.
    let header = 8 + u64::from_le_bytes(good[..8].try_into().unwrap()) as usize;
    let mut random = ChaCha8Rng::seed_from_u64(1);
    let mut bytes = good.clone();
    let count = repeats("damaged header bytes", 60, header);
    let mut places: Vec<usize> = (0..header).collect();
    places.shuffle(&mut random);
    for at in places.into_iter().take(count) {
        let bit = 1 << random.random_range(0..8);
        bytes[at] ^= bit;
        // White space may stand for white space: what changed must then mean the same.
        if !(good[at].is_ascii_whitespace() && bytes[at].is_ascii_whitespace()) {
            opens(&bytes, at as u64);
        }
        bytes[at] ^= bit;
    }
    for _ in 0..repeats("flipped body bits", 60, 10_000) {
        let at = random.random_range(header..good.len());
        bytes[at] ^= 1 << random.random_range(0..8);
        opens(&bytes, at as u64);
        bytes[at] = good[at];
    }
    // At each boundary of the format, one byte before and after, and somewhere.
    let layout: Value = serde_json::from_slice(&good[8..header]).unwrap();
    let tensors = layout.as_object().unwrap().values();
    let ends = tensors.filter_map(|tensor| tensor["data_offsets"].as_array());
    let mut cuts: Vec<usize> = ends
        .flatten()
        .map(|offset| header + offset.as_u64().unwrap() as usize)
        .chain([8, header])
        .flat_map(|at| [at - 1, at, at + 1])
        .filter(|at| *at < good.len())
        .collect();
    assert!(cuts.len() > 20, "{layout}");
    cuts.extend(
        (0..repeats("cuts elsewhere", 20, 500)).map(|_| random.random_range(0..good.len())),
    );
    for at in cuts {
        opens(&good[..at], at as u64);
    }
}

#[test]
fn the_daemon_refuses_it_with_its_exit_code_before_a_cycle() {
    let _turn = turn();
    let place = Place::new();
    let good = shipped();
    place.file("good.vpcmem", &good);
    assert_eq!(judged(&place, "good.vpcmem").code, Some(0));
    let header = 8 + u64::from_le_bytes(good[..8].try_into().unwrap()) as usize;
    let mut flipped = good.clone();
    flipped[header + 1000] ^= 1;
    let mut longer = good.clone();
    longer.extend([0; 64]);
    let cases: [(&str, &[u8]); 7] = [
        ("empty", &[]),
        ("seven bytes", &good[..7]),
        ("head only", &good[..header]),
        ("one byte short", &good[..good.len() - 1]),
        ("longer", &longer),
        ("flipped", &flipped),
        (
            "text",
            b"not a memory at all, but long enough to look like one",
        ),
    ];
    for (what, bytes) in cases {
        place.file("bad.vpcmem", bytes);
        let said = judged(&place, "bad.vpcmem");
        assert_eq!(said.code, Some(65), "{what}: {said:?}");
        assert!(said.stderr.contains("bad.vpcmem"), "{what}: {said:?}");
    }
    let other = scene::PAPER_SIM.replacen("fx = 800.0", "fx = 801.0", 1);
    let other = place.file("other.toml", other);
    let mut command = vpcd(&place, &other, "good.vpcmem");
    command.args(["--cycles", "1"]);
    let said = ended(command);
    assert_eq!(said.code, Some(65), "{said:?}");
    assert!(said.stderr.contains("another task"), "{said:?}");
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
    let twists = (0..200)
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
    let _turn = turn();
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
