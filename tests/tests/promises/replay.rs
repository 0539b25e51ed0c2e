//! Replay: ten minutes of flight with real processes, twice; both records say the same, a replay says the same again,
//! and one bit more or less in any of it is told. Any cycle is replayed from the key before it, too: what the pilot
//! remembers beside its keys would show there.
//!
//! The records are read here as `controller/FLIGHT.md` says that anybody can.

use std::ops::Range;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use rustix::process::Signal;
use serde_json::Value;

use crate::fixture::{Place, Running, Witness, eventually, program, root, scene_file, turn};

/// Ten minutes at 30 Hz.
const CYCLES: u64 = 18_000;
/// From one cycle that is replayed by itself to the next; no multiple of the distance of keys.
const APART: usize = 1999;

/// What two runs need not have in common, by the beginning of the field's name or its end: clocks and what hangs on
/// them, the machine, and the robot's words, which nobody waits for.
const OWN: [&str; 14] = [
    "before",
    "seal",
    "inputs.robot.",
    "told.overruns",
    "told.phase",
    "told.minor_faults",
    "told.major_faults",
    "told.blocked",
    "told.allocations",
    "told.realtime",
    "told.lost_records",
    "told.stamp.",
    "_ns",
    "told.robot_",
];

/// A file of a flight record, taken apart by its own description.
struct Flight {
    header: Value,
    bytes: Vec<u8>,
    records: usize,
    size: usize,
    /// Name of each word of a record.
    names: Vec<String>,
}

impl Flight {
    fn read(path: &Path) -> Self {
        let bytes = std::fs::read(path).unwrap();
        let length = u64::from_le_bytes(bytes[8..16].try_into().unwrap()) as usize;
        let header: Value = serde_json::from_slice(&bytes[64..64 + length]).unwrap();
        let names = |fields: &str| -> Vec<String> {
            let fields = header[fields].as_array().unwrap().iter();
            fields
                .flat_map(|field| {
                    let count = field["count"].as_u64().unwrap() as usize;
                    vec![field["name"].as_str().unwrap().to_owned(); count]
                })
                .collect()
        };
        let keys = header["keys"].as_u64().unwrap() as usize * 8 * names("key_fields").len();
        let names = names("record_fields");
        Self {
            records: 64 + length + keys,
            size: 8 * names.len(),
            header,
            bytes,
            names,
        }
    }

    fn count(&self) -> usize {
        self.header["records"].as_u64().unwrap() as usize
    }

    fn word(&self, record: usize, word: usize) -> Range<usize> {
        let start = self.records + record * self.size + 8 * word;
        start..start + 8
    }

    fn value(&self, record: usize, word: usize) -> u64 {
        u64::from_le_bytes(self.bytes[self.word(record, word)].try_into().unwrap())
    }

    /// The words of a record that every run has in common.
    fn common(&self, record: usize) -> Vec<(&str, u64)> {
        let words = self.names.iter().enumerate();
        let common = words.filter(|(_, name)| {
            !OWN.iter()
                .any(|own| name.starts_with(own) || name.ends_with(own))
        });
        common
            .map(|(word, name)| (name.as_str(), self.value(record, word)))
            .collect()
    }

    /// Index of the first word of a field.
    fn find(&self, field: &str) -> usize {
        self.names.iter().position(|name| name == field).unwrap()
    }

    /// The file with the last bit of a word changed, and a seal that fits where `sealed`.
    fn forged(&self, record: usize, word: usize, sealed: bool) -> Vec<u8> {
        let mut bytes = self.bytes.clone();
        bytes[self.word(record, word).start] ^= 1;
        if sealed {
            let last = self.names.len() - 1;
            let mut seal: u64 = 0x7670_6364_2066_6c74;
            for word in 0..last {
                let word = bytes[self.word(record, word)].try_into().unwrap();
                seal = (seal.rotate_left(29) ^ u64::from_le_bytes(word))
                    .wrapping_mul(0x9e37_79b9_7f4a_7c15);
            }
            bytes[self.word(record, last)].copy_from_slice(&seal.to_le_bytes());
        }
        bytes
    }
}

/// Cameras one after the other, each on another start with noise and lost frames, until the daemon has made its
/// cycles; its flight record.
fn fly(place: &Place) -> PathBuf {
    let memory = root().join("memory-blob/default/paper-sim.vpcmem");
    let text = "[flight]\ndirectory = 'records'\nminutes = 11\nat_exit = true\n";
    let mut command = Command::new(program("vpcd"));
    command
        .arg("--config")
        .arg(place.file("lockstep.toml", text));
    command.arg("--scene").arg(scene_file());
    command.arg("--memory").arg(memory);
    command.args(["--strategy", "gpr", "--clock", "lockstep"]);
    command.arg("--domain").arg(place.domain());
    command.args(["--cycles", &CYCLES.to_string()]);
    command.stdout(Stdio::null()).stderr(Stdio::piped());
    let mut daemon = Running::start(command);
    for start in (0..100).cycle() {
        let mut camera = Command::new(program("hw-sim"));
        let number = start.to_string();
        let starts = root().join("ipc/scene/scenes/paper-sim-starts.csv");
        camera.arg("--scene").arg(scene_file());
        camera
            .arg("--starts")
            .arg(starts)
            .args(["--start", &number]);
        camera.args(["--clock", "lockstep", "--time-limit", "30"]);
        camera.args(["--noise", "0.3", "--drop", "0.01", "--seed", &number]);
        camera.arg("--domain").arg(place.domain());
        camera.stdout(Stdio::null()).stderr(Stdio::null());
        let mut camera = Running::start(camera);
        while camera.is_running() && daemon.is_running() {
            std::thread::sleep(std::time::Duration::from_millis(2));
        }
        if !daemon.is_running() {
            break;
        }
    }
    let ended = daemon.ended();
    assert_eq!(ended.code, Some(0), "{ended:?}");
    newest(place).expect("a flight record")
}

fn newest(place: &Place) -> Option<PathBuf> {
    let entries = std::fs::read_dir(place.path("records")).ok()?;
    let paths = entries.map(|entry| entry.unwrap().path());
    paths
        .filter(|path| path.extension().is_some_and(|end| end == "flight"))
        .max()
}

/// `vpcd replay`, with these words more: exit code, and what it says.
fn replayed(file: &Path, more: &[&str]) -> (i32, String) {
    let mut command = Command::new(program("vpcd"));
    command.arg("replay").arg(file).arg("--json").args(more);
    let output = command.output();
    let output = output.unwrap();
    let mut words = String::from_utf8(output.stdout).unwrap();
    words.push_str(&String::from_utf8(output.stderr).unwrap());
    (output.status.code().unwrap(), words)
}

fn report(file: &Path, more: &[&str]) -> Value {
    let (code, words) = replayed(file, more);
    assert_eq!(code, 0, "{words}");
    let mut told: Value = serde_json::from_str(&words).unwrap();
    told["report"].take()
}

#[test]
fn run_a_is_run_b_is_the_replay_of_a_and_one_bit_more_is_told() {
    let _turn = turn();
    let (place_a, place_b) = (Place::new(), Place::new());
    let (file_a, file_b) = std::thread::scope(|threads| {
        let b = threads.spawn(|| fly(&place_b));
        (fly(&place_a), b.join().unwrap())
    });
    let (a, b) = (Flight::read(&file_a), Flight::read(&file_b));
    assert_eq!((a.count(), b.count()), (18_000, 18_000));
    assert_eq!(a.names, b.names);
    for record in 0..a.count() {
        let (of_a, of_b) = (a.common(record), b.common(record));
        assert!(of_a.len() > 100);
        if let Some(k) = of_a.iter().zip(&of_b).position(|(a, b)| a != b) {
            panic!("record {record}: {:?} and {:?}", of_a[k], of_b[k]);
        }
    }
    // Equality is not for want of life.
    let recalled = a.find("told.recalled");
    let asked = (0..a.count()).filter(|&record| a.value(record, recalled) == 1);
    assert!(asked.count() > 500);

    for file in [&file_a, &file_b] {
        let told = report(file, &[]);
        assert_eq!(
            (&told["cycles"], &told["skipped"]),
            (&CYCLES.into(), &0.into())
        );
    }

    for cycle in (APART as u64..CYCLES).step_by(APART) {
        let told = report(&file_a, &["--cycle", &cycle.to_string()]);
        assert_eq!(
            (&told["last"], &told["keys_restored"]),
            (&cycle.into(), &1.into())
        );
    }

    let moving = (9000..).find(|&record| a.value(record, a.find("told.iterations")) > 1);
    let moving = moving.unwrap();
    // Where it shows first: an input in what comes of it, the clock's reading in the state after the cycle at the latest.
    for (field, told) in [
        ("inputs.now_ns", None),
        ("inputs.features.message.points", None),
        ("answer.twist", Some("answer.twist[0]")),
        ("told.twist", Some("told.twist[0]")),
        ("told.cost", Some("told.cost")),
        ("told.iterations", Some("told.iterations")),
        ("before", Some("before")),
    ] {
        let word = a.find(field);
        let place = Place::new();
        let damaged = place.file("damaged.flight", a.forged(moving, word, false));
        let (code, words) = replayed(&damaged, &[]);
        assert_eq!(code, 65, "{field}: {words}");
        assert!(
            words.contains(&format!("record {moving}: seal = ")),
            "{words}"
        );
        let forged = place.file("forged.flight", a.forged(moving, word, true));
        let (code, words) = replayed(&forged, &[]);
        assert_eq!(code, 1, "{field}: {words}");
        let words: Value = serde_json::from_str(&words).unwrap();
        let difference = &words["difference"];
        let cycle = difference["cycle"].as_u64().unwrap() as usize;
        assert!(
            (moving + 1..=moving + 2).contains(&cycle),
            "{field}: {words}"
        );
        if let Some(told) = told {
            assert_eq!(difference["field"], told, "{field}: {words}");
        }
    }
}

#[test]
fn a_fault_in_real_time_leaves_a_record_that_replays() {
    let _turn = turn();
    let place = Place::new();
    let daemon = Running::start(place.vpcd("[flight]\ndirectory = 'records'"));
    let camera = Running::start(place.hw_sim(3));
    let mut witness = Witness::new(&place);
    witness.set_in_motion();
    camera.kill();
    let file = eventually("a flight record", || newest(&place));
    let told = report(&file, &[]);
    assert!(told["cycles"].as_u64().unwrap() > 3, "{told}");
    let flight = Flight::read(&file);
    assert_eq!(flight.header["cause"], "fault: stale features");
    // The arming is in it.
    let count = flight.find("asked.count");
    let asked = (0..flight.count()).map(|record| flight.value(record, count));
    assert!(asked.sum::<u64>() >= 1);
    daemon.signal(Signal::TERM);
    let ended = daemon.ended();
    assert_eq!(ended.code, Some(0), "{ended:?}");
}
