//! Replay: a run with the real daemon in lockstep, twice; with `VPC_LONG=1` ten minutes. Both records
//! and a replay are the same, and a change of one bit is found. Single cycles are also replayed from
//! the snapshot before them, which would show any state that snapshots lack. What else a record
//! shows, `cargo test --test daemon -- flight record` says.

use std::path::{Path, PathBuf};
use std::process::Stdio;

use hw_sim::FreeCamera;
use ipc::{CameraPorts, Domain, Observer};
use messages::{CycleRecord, Features, RecallCode, Stamp, Values, Wire};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal};
use recording::{Recording, RecordingFile, Sink};
use scene::{Scene, read_starts};
use serde_json::Value;

use crate::fixture::{
    PATIENCE, PERIOD_NS, Place, Running, ended, eventually, memory_file, program, repeats,
    scene_file, starts_file,
};

/// Frames from one start.
const FRAMES: u32 = 100;

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

/// A camera with noise and lost frames, on one start after the other, and a daemon in lockstep, until
/// it has made its cycles; its flight record.
fn fly(place: &Place, cycles: u64) -> PathBuf {
    let text = "[flight]\ndirectory = 'records'\nminutes = 11\nat_exit = true\n";
    let mut command = testkit::command(program("vpcd"));
    command
        .arg("--config")
        .arg(place.file("lockstep.toml", text));
    command.arg("--scene").arg(scene_file());
    command.arg("--memory").arg(memory_file());
    command.args(["--strategy", "gpr", "--clock", "lockstep"]);
    command.arg("--domain").arg(place.domain());
    command.args(["--cycles", &cycles.to_string()]);
    command.stdout(Stdio::null()).stderr(Stdio::piped());
    let domain = Domain::join(&place.domain()).unwrap();
    let mut ports = CameraPorts::open(&domain).unwrap();
    let mut observer = Observer::open(&domain).unwrap();
    let daemon = Running::start(command);
    let scene = Scene::read(&scene_file()).unwrap();
    let mut starts = read_starts(&starts_file()).unwrap().into_iter().cycle();
    let mut random = ChaCha8Rng::seed_from_u64(17);
    let noise = Normal::new(0.0, 0.3).unwrap();
    let (mut camera, mut twist, mut at_ns) = (None, [0.0; 6], 0);
    let mut sequence = 0;
    while sequence < cycles {
        at_ns += PERIOD_NS;
        let from_here = camera
            .get_or_insert_with(|| (FreeCamera::new(&scene, &starts.next().unwrap()), FRAMES));
        from_here.0.advance(&twist, scene.sampling_time());
        from_here.1 -= 1;
        let points = from_here.0.features().ok().filter(|_| from_here.1 > 0);
        let Some(mut points) = points else {
            (camera, twist) = (None, [0.0; 6]);
            continue;
        };
        let coordinates = points.iter_mut().flatten();
        coordinates.for_each(|x| *x += noise.sample(&mut random));
        if random.random_bool(0.01) {
            continue;
        }
        sequence += 1;
        let mut features = Features::new(&points, at_ns);
        features.stamp = Stamp {
            sequence,
            published_ns: at_ns,
            data_ns: at_ns,
        };
        let sent = ports.features.publish_verbatim(&features).unwrap();
        let answer = ports.wait_for_answer(&sent, PATIENCE).unwrap();
        twist = answer.expect("an answer").message.twist;
        // The recorder, which in lockstep nothing holds back, comes after.
        if sequence.is_multiple_of(1_000) {
            eventually("the record", || {
                let newest = observer.cycles.latest().unwrap()?.message;
                (newest.features_seen.sequence >= sequence).then_some(())
            });
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

#[test]
fn run_a_is_run_b_is_the_replay_of_a_and_one_bit_more_is_told() {
    let cycles = repeats("cycles of each run", 320, 18_000) as u64;
    let (place_a, place_b) = (Place::new(), Place::new());
    let (file_a, file_b) = (fly(&place_a, cycles), fly(&place_b, cycles));
    let read = |path: &Path| Recording::read(path).unwrap();
    let (a, b) = (read(&file_a), read(&file_b));
    for run in [&a, &b] {
        assert_eq!(run.cycles.len() as u64, cycles);
    }
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
    let asked = a.cycles.iter().filter(is_asked).count() as u64;
    assert!(asked > cycles / 36, "{asked}");

    for file in [&file_a, &file_b] {
        let told = report(file, &[]);
        assert_eq!(
            (&told["cycles"], &told["skipped"]),
            (&cycles.into(), &0.into())
        );
    }
    let apart = repeats("cycles from one replayed by itself to the next", 149, 1_999);
    for cycle in (apart as u64..cycles).step_by(apart) {
        let told = report(&file_a, &["--until", &cycle.to_string()]);
        assert_eq!(
            (&told["last"], &told["snapshots_restored"]),
            (&cycle.into(), &1.into())
        );
    }

    // One bit of one pixel.
    let half = a.cycles.len() / 2;
    let moving = a.cycles[half..].iter().position(|r| r.iterations > 1);
    let moving = half + moving.unwrap();
    let mut forged = a.clone();
    let mut features = forged.features.iter_mut();
    let seen = features.find(|features| features.stamp == a.cycles[moving].features_seen);
    let pixel = &mut seen.unwrap().points[0];
    *pixel = f64::from_bits(pixel.to_bits() ^ 1);
    let (code, words) = replayed(&write(&place_a, &forged), &[]);
    assert_eq!(code, 1, "{words}");
    let words: Value = serde_json::from_str(&words).unwrap();
    let difference = (&words["difference"]["field"], &words["difference"]["cycle"]);
    assert_eq!(
        difference,
        (&"points[0]".into(), &(moving + 1).into()),
        "{words}"
    );
}
