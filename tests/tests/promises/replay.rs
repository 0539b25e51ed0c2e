//! Replay: ten minutes with real processes, twice. Both records and a replay are the same, and a
//! change of one bit is found. Single cycles are also replayed from the snapshot before them, which
//! would show any state that snapshots lack.

use std::path::{Path, PathBuf};
use std::process::Stdio;

use messages::{CycleRecord, RecallCode};
use messages::{Values, Wire};
use recording::{Recording, RecordingFile, Sink};
use rustix::process::Signal;
use serde_json::Value;

use crate::fixture::{
    Place, Running, Witness, ended, eventually, memory_file, program, scene_file, starts_file, turn,
};

/// Ten minutes at 30 Hz.
const CYCLES: u64 = 18_000;
/// From one cycle that is replayed by itself to the next; no multiple of the distance of snapshots.
const APART: usize = 1999;
/// Cycles from one snapshot to the next.
const SNAPSHOTS: usize = 32;

/// Fields in which two runs may differ: times and what follows from them, properties of the
/// machine, and the messages of robot and policy, which are not synchronised.
const OWN: [&str; 14] = [
    "stamp",
    "overruns",
    "lost_records",
    "phase",
    "minor_faults",
    "major_faults",
    "blocked",
    "allocations",
    "realtime",
    "robot_input",
    "robot_seen",
    "desired_input",
    "desired_seen",
    "features_seen",
];

/// The bits of the fields of a record that every run has in common, with their names.
fn common(record: &CycleRecord) -> Vec<(&'static str, Vec<u64>)> {
    let fields = record.fields();
    let common =
        fields.filter(|(field, _)| !OWN.contains(&field.name) && !field.name.ends_with("_ns"));
    common
        .map(|(field, values)| (field.name, bits(values)))
        .collect()
}

fn bits(values: Values<'_>) -> Vec<u64> {
    match values {
        Values::U32(numbers) => numbers.iter().map(|&number| number.into()).collect(),
        Values::U64(numbers) => numbers.to_vec(),
        Values::F64(numbers) => numbers.iter().map(|number| number.to_bits()).collect(),
        other => panic!("{other:?} is one of those that runs need not have in common"),
    }
}

/// Cameras one after the other, each on another start with noise and lost frames, until the daemon
/// has made its cycles; its flight record.
fn fly(place: &Place) -> PathBuf {
    let text = "[flight]\ndirectory = 'records'\nminutes = 11\nat_exit = true\n";
    let mut command = testkit::command(program("vpcd"));
    command
        .arg("--config")
        .arg(place.file("lockstep.toml", text));
    command.arg("--scene").arg(scene_file());
    command.arg("--memory").arg(memory_file());
    command.args(["--strategy", "gpr", "--clock", "lockstep"]);
    command.arg("--domain").arg(place.domain());
    command.args(["--cycles", &CYCLES.to_string()]);
    command.stdout(Stdio::null()).stderr(Stdio::piped());
    let mut daemon = Running::start(command);
    for start in (0..100).cycle() {
        let mut camera = testkit::command(program("hw-sim"));
        let number = start.to_string();
        camera.arg("--scene").arg(scene_file());
        camera
            .arg("--starts")
            .arg(starts_file())
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
    newest(place).unwrap_or_else(|| panic!("no flight record: {}", ended.stderr))
}

fn newest(place: &Place) -> Option<PathBuf> {
    let entries = std::fs::read_dir(place.path("records")).ok()?;
    let paths = entries.map(|entry| entry.unwrap().path());
    paths
        .filter(|path| path.extension().is_some_and(|end| end == "mcap"))
        .max()
}

/// `vpcd replay` with more flags: exit code, and what it prints.
fn replayed(file: &Path, more: &[&str]) -> (i32, String) {
    let mut command = testkit::command(program("vpcd"));
    command.arg("replay").arg(file).arg("--json").args(more);
    let ended = ended(command);
    (ended.code.unwrap(), ended.stdout + &ended.stderr)
}

fn report(file: &Path, more: &[&str]) -> Value {
    let (code, words) = replayed(file, more);
    assert_eq!(code, 0, "{words}");
    let mut told: Value = serde_json::from_str(&words).unwrap();
    told["report"].take()
}

/// Writes a flight record again, with what was changed in it.
fn write(place: &Place, flight: &Recording) -> PathBuf {
    let path = place.path("forged.mcap");
    let mut file = RecordingFile::create(&path, true).unwrap();
    for key in ["cause", "executable", "memory_sha256"] {
        let entry = flight.origin(key).unwrap().to_owned();
        file.origin([(key, entry)]).unwrap();
    }
    for (name, data) in &flight.attachments {
        file.attach(name, data).unwrap();
    }
    flight.snapshots.iter().for_each(|m| file.write(m).unwrap());
    flight.features.iter().for_each(|m| file.write(m).unwrap());
    flight.robot.iter().for_each(|m| file.write(m).unwrap());
    flight.replies.iter().for_each(|m| file.write(m).unwrap());
    flight.cycles.iter().for_each(|m| file.write(m).unwrap());
    file.finish().unwrap();
    path
}

fn flip(number: &mut f64) {
    *number = f64::from_bits(number.to_bits() ^ 1);
}

#[test]
#[ignore = "two minutes: CI runs it in a line of its own"]
fn run_a_is_run_b_is_the_replay_of_a_and_one_bit_more_is_told() {
    let _turn = turn();
    let (place_a, place_b) = (Place::new(), Place::new());
    let (file_a, file_b) = std::thread::scope(|threads| {
        let b = threads.spawn(|| fly(&place_b));
        (fly(&place_a), b.join().unwrap())
    });
    let read = |path: &Path| Recording::read(path).unwrap();
    let (a, b) = (read(&file_a), read(&file_b));
    assert_eq!((a.cycles.len(), b.cycles.len()), (18_000, 18_000));
    for (of_a, of_b) in a.cycles.iter().zip(&b.cycles) {
        let cycle = of_a.cycle;
        let (of_a, of_b) = (common(of_a), common(of_b));
        assert!(of_a.len() > 20);
        if let Some(k) = of_a.iter().zip(&of_b).position(|(a, b)| a != b) {
            panic!("cycle {cycle}: {:?} and {:?}", of_a[k], of_b[k]);
        }
    }
    // Equality is not for want of life.
    let is_asked = |r: &&CycleRecord| r.recalled == RecallCode::Followed.code();
    assert!(a.cycles.iter().filter(is_asked).count() > 500);

    for file in [&file_a, &file_b] {
        let told = report(file, &[]);
        assert_eq!(
            (&told["cycles"], &told["skipped"]),
            (&CYCLES.into(), &0.into())
        );
    }

    for cycle in (APART as u64..CYCLES).step_by(APART) {
        let told = report(&file_a, &["--until", &cycle.to_string()]);
        assert_eq!(
            (&told["last"], &told["snapshots_restored"]),
            (&cycle.into(), &1.into())
        );
    }

    let moving = a.cycles[9000..].iter().position(|r| r.iterations > 1);
    let moving = 9000 + moving.unwrap();
    let seen = a.cycles[moving].features_seen;
    type Change = fn(&mut Recording, usize);
    // Where it shows first: an input in what comes of it, the clock's reading in the state that the
    // next snapshot holds. No decision in lockstep depends on it, so the cycle before a snapshot is
    // the one that leaves a trace.
    let cases: [(&str, Change, Option<&str>); 6] = [
        (
            "instant",
            |f, at| {
                let after = f.cycles[at].cycle;
                let next = f.snapshots.iter().find(|snapshot| snapshot.cycle > after);
                let before_next = next.unwrap().cycle - 1;
                let mut cycles = f.cycles.iter_mut();
                cycles
                    .find(|record| record.cycle == before_next)
                    .unwrap()
                    .receive_ns ^= 1;
            },
            None,
        ),
        (
            "twist",
            |f, at| flip(&mut f.cycles[at].twist[0]),
            Some("twist[0]"),
        ),
        ("cost", |f, at| flip(&mut f.cycles[at].cost), Some("cost")),
        (
            "iterations",
            |f, at| f.cycles[at].iterations ^= 1,
            Some("iterations"),
        ),
        ("hold", |f, at| f.cycles[at].hold ^= 1, Some("hold")),
        (
            "pixel",
            |f, at| {
                let seen = f.cycles[at].features_seen;
                let mut features = f.features.iter_mut();
                let message = features.find(|m| m.stamp == seen).unwrap();
                flip(&mut message.points[0]);
            },
            Some("points[0]"),
        ),
    ];
    assert!(seen.sequence > 0);
    for (name, change, field) in cases {
        let mut forged = a.clone();
        change(&mut forged, moving);
        let place = Place::new();
        let (code, words) = replayed(&write(&place, &forged), &[]);
        assert_eq!(code, 1, "{name}: {words}");
        let words: Value = serde_json::from_str(&words).unwrap();
        let difference = &words["difference"];
        let cycle = difference["cycle"].as_u64().unwrap() as usize;
        match field {
            Some(field) => {
                assert_eq!(difference["field"], field, "{name}: {words}");
                assert_eq!(cycle, moving + 1, "{name}: {words}");
            }
            None => {
                let shows = moving + 1..=moving + 1 + SNAPSHOTS;
                assert!(shows.contains(&cycle), "{name}: {words}");
            }
        }
    }

    // A byte of the file, anywhere.
    let bytes = std::fs::read(&file_a).unwrap();
    for part in 1..8 {
        let mut damaged = bytes.clone();
        damaged[part * bytes.len() / 8] ^= 1;
        let place = Place::new();
        let (code, words) = replayed(&place.file("damaged.mcap", damaged), &[]);
        assert_eq!(code, 65, "{words}");
        assert!(words.contains("damaged.mcap: "), "{words}");
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
    let flight = Recording::read(&file).unwrap();
    assert_eq!(flight.origin("cause"), Some("fault: stale features"));
    // The arming is in it.
    assert!(flight.cycles.iter().map(|r| r.requests).sum::<u32>() >= 1);
    assert!(!flight.replies.is_empty());
    daemon.signal(Signal::TERM);
    let ended = daemon.ended();
    assert_eq!(ended.code, Some(0), "{ended:?}");
}
