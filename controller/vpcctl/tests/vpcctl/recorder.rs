//! `record` as a process that is killed, or hangs.

use std::path::Path;
use std::process::Stdio;

use ipc::{CameraPorts, Domain, RecorderPort, Sent};
use messages::{CycleRecord, Features};
use recording::Recording;
use rustix::process::Signal;
use testkit::{Place, Running, eventually};

const FILE: &str = "run.mcap";

/// Who publishes, in this thread.
struct Stage {
    camera: CameraPorts,
    telemetry: RecorderPort,
    published: u64,
}

impl Stage {
    fn open(directory: &Path) -> Self {
        let domain = Domain::join(directory).unwrap();
        Self {
            camera: CameraPorts::open(&domain).unwrap(),
            telemetry: RecorderPort::open(&domain).unwrap(),
            published: 0,
        }
    }

    /// Publishes features and a record that carry their number.
    fn publish(&mut self) -> Sent {
        self.published += 1;
        let number = self.published;
        let features = Features::new(&[[number as f64, 1.5]; 4], ipc::now_ns());
        self.camera.features.publish(&features).unwrap();
        let cycle = CycleRecord {
            cycle: number,
            ..CycleRecord::default()
        };
        self.telemetry.cycles.publish(&cycle).unwrap()
    }
}

/// A recorder that has taken some of what the stage publishes, and handed it to the system, as it
/// does once a second.
fn recorder(place: &Place, stage: &mut Stage) -> Running {
    let mut command = testkit::command(env!("CARGO_BIN_EXE_vpcctl"));
    command.arg("--domain").arg(place.domain()).arg("record");
    command.arg(place.path(FILE)).stdout(Stdio::piped());
    let recorder = Running::start(command.stderr(Stdio::piped()));
    // Also while the file has no head yet, or a half.
    let has_both = |file: &Recording| !file.features.is_empty() && !file.cycles.is_empty();
    eventually("a flush of both", || {
        stage.publish();
        let file = Recording::read(&place.path(FILE)).ok();
        file.filter(has_both).map(|_| ())
    });
    recorder
}

/// What was read is what was published under that number.
fn check(recording: &Recording) {
    for message in &recording.features {
        assert_eq!(message.points[0], message.stamp.sequence as f64);
    }
    for cycle in &recording.cycles {
        assert_eq!(cycle.cycle, cycle.stamp.sequence);
    }
}

#[test]
fn a_killed_recorder_leaves_a_file_that_can_be_read() {
    let place = Place::new();
    let mut stage = Stage::open(&place.domain());
    let recorder = recorder(&place, &mut stage);
    recorder.kill();
    let recording = Recording::read(&place.path(FILE)).unwrap();
    assert!(recording.cut.is_some() && !recording.metadata.contains_key("vpc.ledger"));
    assert!(!recording.features.is_empty() && !recording.cycles.is_empty());
    check(&recording);
}

#[test]
fn a_recorder_that_hangs_delays_nobody_and_counts_losses() {
    /// More than the longest queue holds.
    const MISSED: u64 = 2_000;
    let place = Place::new();
    let mut stage = Stage::open(&place.domain());
    let recorder = recorder(&place, &mut stage);
    recorder.halt(Signal::STOP);
    let before = stage.published;
    while stage.published < before + MISSED {
        // Succeeds.
        stage.publish();
    }
    recorder.signal(Signal::CONT);
    let ended = recorder.terminated();
    assert_eq!(ended.code, Some(0), "{ended:?}");

    let recording = Recording::read(&place.path(FILE)).unwrap();
    check(&recording);
    let ledger = &recording.metadata["vpc.ledger"];
    for (topic, missing, last) in [
        (
            "/vpc/features",
            Recording::missing(&recording.features),
            recording.features.last().map(|m| m.stamp),
        ),
        (
            "/vpc/cycles",
            Recording::missing(&recording.cycles),
            recording.cycles.last().map(|m| m.stamp),
        ),
    ] {
        let count = |name| ledger[&format!("{topic}.{name}")].parse::<u64>().unwrap();
        let (recorded, lost) = (count("recorded"), count("lost"));
        assert!(lost >= MISSED - 1024, "{topic}: {lost}");
        assert_eq!(lost, missing, "{topic}");
        assert_eq!(last.unwrap().sequence, stage.published, "{topic}");
        let words = format!(" {topic} {recorded} (lost {lost})");
        assert!(ended.stdout.contains(&words), "{}", ended.stdout);
    }
}
