//! The ordinary thread's part: keeps the ring, sees faults and requests, and has files written by a
//! thread that may wait for the disk.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use messages::{CycleRecord, Hold, Reply, Snapshot, TwistState};
use tracing::{info, warn};

use super::file::{self, About};
use super::queue::FlightCycle;
use super::ring::Ring;
use super::store::Store;
use crate::config::{Config, ConfigError, FlightConfig};

/// A fault within this time of the last written one is only logged: features that come and go must
/// not fill a disk. A fault that disarms is always written, because it may be the last one.
const BETWEEN_FAULTS: Duration = Duration::from_secs(60);

/// Longest wait for a file when the daemon ends, while nothing more is written, and in all: less
/// than `TimeoutStopSec` of the unit.
const PATIENCE: Duration = Duration::from_secs(2);
const LONGEST: Duration = Duration::from_secs(8);

/// Why a record is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cause {
    /// An operator or a signal asked.
    Request,
    /// The camera was moving and was held.
    Fault(Hold),
    /// The daemon ends.
    Exit,
}

impl Cause {
    /// In file names.
    const fn word(self) -> &'static str {
        match self {
            Self::Request => "request",
            Self::Fault(_) => "fault",
            Self::Exit => "exit",
        }
    }

    /// In headers and logs.
    fn text(self) -> String {
        match self {
            Self::Fault(hold) => format!("fault: {hold}"),
            _ => self.word().to_owned(),
        }
    }
}

/// Keeps the last minutes.
pub struct Recorder {
    ring: Ring,
    /// Where files go, and what they say about the daemon; `None`: nowhere.
    store: Option<(Store, About)>,
    at_exit: bool,
    was_moving: bool,
    was_armed: bool,
    /// Whether the camera moved since the start: before, there is nothing to explain.
    has_moved: bool,
    /// The file that is due: for a request; for a moving camera that was held; for one that was
    /// disarmed.
    requested: bool,
    fault: Option<Hold>,
    disarmed: Option<Hold>,
    /// Whether a file was made of a fault since the camera last moved.
    is_told: bool,
    written: Option<Instant>,
    writer: Option<JoinHandle<()>>,
    /// Cycles that writers have written.
    progress: Arc<AtomicU64>,
}

impl Recorder {
    /// A recorder for this configuration at this rate of cycles, Hz.
    pub fn new(config: &Config, about: About, rate_hz: f64) -> Self {
        let flight = &config.flight;
        let store = Store::new(flight.directory.clone(), flight.keep);
        Self {
            store: Some((store, about)),
            at_exit: flight.at_exit,
            ..Self::nowhere(flight.cycles(rate_hz))
        }
    }

    /// Whether the cycles that are to be kept at this rate (Hz) fit in a quarter of a machine's
    /// memory (bytes): while a file is written there are two of each, and the rest is not ours.
    /// `source` names the configuration in messages.
    ///
    /// # Errors
    /// [`ConfigError::Value`] names the minutes that fit.
    pub fn check_room(
        flight: &FlightConfig,
        rate_hz: f64,
        memory_bytes: u64,
        source: String,
    ) -> Result<(), ConfigError> {
        let fitting = memory_bytes / 4 / Ring::BYTES_PER_CYCLE as u64;
        if flight.cycles(rate_hz) as u64 <= fitting {
            return Ok(());
        }
        let minutes = (fitting as f64 / rate_hz / 6.0).floor() / 10.0;
        let memory_gb = memory_bytes as f64 / 1e9;
        let allowed = format!(
            "at most {minutes} min at the scene's {rate_hz} Hz, a quarter of this machine's {memory_gb:.1} GB"
        );
        Err(ConfigError::value(
            &source,
            "flight.minutes",
            flight.minutes,
            allowed,
        ))
    }

    /// A recorder that keeps `cycles` and writes nothing.
    pub fn nowhere(cycles: usize) -> Self {
        Self {
            ring: Ring::new(cycles),
            store: None,
            at_exit: false,
            was_moving: false,
            was_armed: false,
            has_moved: false,
            requested: false,
            fault: None,
            disarmed: None,
            is_told: false,
            written: None,
            writer: None,
            progress: Arc::default(),
        }
    }

    /// Takes in a cycle.
    pub fn push(&mut self, cycle: FlightCycle) {
        let record = &cycle.record;
        let (is_moving, is_armed) = (is_moving(record), is_armed(record));
        if is_moving {
            (self.is_told, self.has_moved) = (false, true);
        }
        if let Some(reason) = unwanted(record) {
            if self.was_moving {
                self.fault.get_or_insert(reason);
            }
            if self.has_moved && self.was_armed && !is_armed {
                self.disarmed.get_or_insert(reason);
            }
        }
        (self.was_moving, self.was_armed) = (is_moving, is_armed);
        self.ring.push(cycle);
    }

    /// Takes in a reply.
    pub fn push_reply(&mut self, reply: Reply) {
        self.ring.push_reply(reply);
    }

    /// Takes in a snapshot.
    pub fn push_snapshot(&mut self, snapshot: Snapshot) {
        self.ring.push_snapshot(snapshot);
    }

    /// Has the file written that is due: on request, or on a fault since the last call. While a
    /// file is being written the next one waits.
    pub fn tend(&mut self, requested: bool, now: Instant) {
        self.requested |= requested;
        if self.is_writing() {
            return;
        }
        let (fault, disarmed) = (self.fault.take(), self.disarmed.take());
        if std::mem::take(&mut self.requested) {
            self.write(Cause::Request);
            return;
        }
        let is_soon = |last| now.saturating_duration_since(last) < BETWEEN_FAULTS;
        let is_soon = self.written.is_some_and(is_soon);
        let disarmed = disarmed.filter(|_| !self.is_told);
        if let Some(hold) = disarmed.or(fault.filter(|_| !is_soon)) {
            (self.written, self.is_told) = (Some(now), true);
            self.write(Cause::Fault(hold));
        }
    }

    /// Has written what is requested at the end, and waits for it.
    pub fn end(&mut self) {
        if !self.wait() {
            return;
        }
        self.tend(false, Instant::now());
        if self.at_exit && self.wait() {
            self.write(Cause::Exit);
        }
        self.wait();
    }

    fn is_writing(&self) -> bool {
        self.writer.as_ref().is_some_and(|w| !w.is_finished())
    }

    /// Waits for the writer, but not for a disk that hangs; a part of a file is then removed with
    /// the next file. Returns whether the writer is done.
    fn wait(&mut self) -> bool {
        let begun = Instant::now();
        let (mut written, mut last) = (self.progress.load(Ordering::Relaxed), begun);
        while self.is_writing() && last.elapsed() < PATIENCE && begun.elapsed() < LONGEST {
            std::thread::sleep(Duration::from_millis(2));
            let now = self.progress.load(Ordering::Relaxed);
            if now != written {
                (written, last) = (now, Instant::now());
            }
        }
        let is_writing = self.is_writing();
        if is_writing {
            warn!(
                "flight record given up after {:?}: the disk is too slow",
                begun.elapsed()
            );
        }
        !is_writing
    }

    /// Passes a copy to a thread of its own, so that a disk that hangs delays neither telemetry nor
    /// the watchdog.
    fn write(&mut self, cause: Cause) {
        let Some((store, about)) = &self.store else {
            return;
        };
        let (store, about, ring) = (store.clone(), about.clone(), self.ring.clone());
        let progress = Arc::clone(&self.progress);
        let work = move || write(&store, &about, cause, &ring, &progress);
        match std::thread::Builder::new()
            .name("flight".to_owned())
            .spawn(work)
        {
            Ok(writer) => self.writer = Some(writer),
            Err(error) => warn!(%error, "flight record not written: no thread"),
        }
    }
}

fn write(store: &Store, about: &About, cause: Cause, ring: &Ring, progress: &AtomicU64) {
    let since = SystemTime::now().duration_since(UNIX_EPOCH);
    let unix_ms = since.map_or(0, |since| since.as_millis() as u64);
    let (cycles, text) = (ring.len(), cause.text());
    let fill = |path: &Path| file::write(path, about, &text, ring, progress);
    let most = (cycles * Ring::BYTES_PER_CYCLE) as u64;
    match store.write(unix_ms, cause.word(), most, fill) {
        Ok(path) => info!(
            cycles,
            cause = text,
            "flight record written: {}",
            path.display()
        ),
        Err(error) => warn!(cause = text, "flight record not written: {error}"),
    }
}

fn is_moving(record: &CycleRecord) -> bool {
    let state = TwistState::from_code(record.state);
    matches!(state, Some(TwistState::Moving | TwistState::Arrived))
}

fn is_armed(record: &CycleRecord) -> bool {
    let state = TwistState::from_code(record.state);
    !matches!(state, Some(TwistState::Disarmed | TwistState::Stopped))
}

/// What holds, unless it is how vpcd began, or an operator or a shutdown asked for it.
fn unwanted(record: &CycleRecord) -> Option<Hold> {
    use Hold::{NotArmed, Operator, Shutdown, Unclean, Unwanted};
    let hold = record.hold()?;
    (!matches!(hold, NotArmed | Operator | Shutdown | Unclean | Unwanted)).then_some(hold)
}

#[cfg(test)]
mod tests {
    use super::*;

    use recording::Recording;

    use super::super::file::origin;
    use crate::arguments::Arguments;
    use crate::loaded::Loaded;

    fn cycle(number: u64, state: TwistState, hold: Option<Hold>) -> FlightCycle {
        let record = CycleRecord {
            cycle: number,
            state: state.code(),
            hold: Hold::number(hold),
            ..CycleRecord::default()
        };
        FlightCycle {
            record,
            features: None,
            robot: None,
            desired: None,
        }
    }

    /// A recorder that was told these cycles, one after another.
    fn told_of(cycles: &[(TwistState, Option<Hold>)]) -> Recorder {
        let mut recorder = Recorder::nowhere(10);
        for (state, hold) in cycles {
            recorder.push(cycle(1, *state, *hold));
        }
        recorder
    }

    #[test]
    fn a_fault_is_a_motion_that_ends_unwanted() {
        let moving = (TwistState::Moving, None);
        let fault = |before, state, hold| told_of(&[before, (state, hold)]).fault;
        let stale = fault(moving, TwistState::Braking, Some(Hold::Stale));
        assert_eq!(stale, Some(Hold::Stale));
        let still = (TwistState::Holding, Some(Hold::Stale));
        assert_eq!(fault(still, TwistState::Holding, Some(Hold::Stale)), None);
        assert_eq!(fault(moving, TwistState::Moving, None), None);
        assert_eq!(
            fault(moving, TwistState::Disarmed, Some(Hold::Operator)),
            None
        );
    }

    #[test]
    fn a_camera_is_disarmed_once_and_never_by_its_start() {
        let (disarmed, lost) = (TwistState::Disarmed, Some(Hold::Lost));
        let (moving, braking) = ((TwistState::Moving, None), (TwistState::Braking, lost));
        assert_eq!(
            told_of(&[moving, braking, (disarmed, lost)]).disarmed,
            Some(Hold::Lost)
        );
        assert_eq!(
            told_of(&[(disarmed, lost), (disarmed, lost)]).disarmed,
            None
        );
        let wanted = (disarmed, Some(Hold::Operator));
        assert_eq!(told_of(&[moving, braking, wanted]).disarmed, None);
        // Armed from the start, and disarmed while it still waited for features.
        for cause in [Hold::RobotLost, Hold::Overruns, Hold::Standstill] {
            let waiting = (TwistState::Holding, Some(Hold::NoFeatures));
            let recorder = told_of(&[waiting, (disarmed, Some(cause))]);
            assert_eq!((recorder.disarmed, recorder.fault), (None, None));
        }
    }

    #[test]
    fn faults_that_come_and_go_are_written_once_a_minute() {
        let place = tempfile::tempdir().unwrap();
        let scene =
            Path::new(env!("CARGO_MANIFEST_DIR")).join("../ipc/scene/scenes/paper-sim.toml");
        let text = format!(
            "scene = '{}'\n[flight]\ndirectory = 'records'",
            scene.display()
        );
        let config = Config::parse(&text, "v.toml", place.path(), &Arguments::default()).unwrap();
        let loaded = Loaded::open(&config.scene, None, config.settings).unwrap();
        let mut recorder = Recorder::new(&config, About::new(text, &loaded), 30.0);
        let store = Store::new(config.flight.directory.clone(), 10);
        let start = Instant::now();
        let mut number = 0;
        let mut look = |after: u64, state, hold, requested| {
            number += 1;
            recorder.push(cycle(number, state, hold));
            recorder.tend(requested, start + Duration::from_secs(after));
            recorder.wait();
            store.files().len()
        };
        let cause = || {
            let newest = Recording::read(store.files().last().unwrap()).unwrap();
            newest.origin(origin::CAUSE).unwrap().to_owned()
        };
        assert_eq!(look(0, TwistState::Moving, None, false), 0);
        assert_eq!(look(1, TwistState::Holding, Some(Hold::Stale), false), 1);
        assert_eq!(look(2, TwistState::Holding, Some(Hold::Stale), false), 1);
        assert_eq!(look(3, TwistState::Moving, None, false), 1);
        assert_eq!(look(4, TwistState::Holding, Some(Hold::Hidden), false), 1);
        // A request is always fulfilled.
        assert_eq!(look(5, TwistState::Moving, None, true), 2);
        assert_eq!(look(62, TwistState::Holding, Some(Hold::Stale), false), 3);
        assert_eq!(cause(), "fault: stale features");
        // One that disarms is written in any case, and once.
        assert_eq!(look(63, TwistState::Moving, None, false), 3);
        assert_eq!(
            look(64, TwistState::Braking, Some(Hold::Overruns), false),
            3
        );
        assert_eq!(
            look(64, TwistState::Disarmed, Some(Hold::Overruns), false),
            4
        );
        assert_eq!(look(65, TwistState::Moving, None, false), 4);
        assert_eq!(
            look(66, TwistState::Disarmed, Some(Hold::RobotFault), false),
            5
        );
        assert_eq!(cause(), "fault: robot fault");
        assert_eq!(look(200, TwistState::Moving, None, false), 5);
        assert_eq!(look(200, TwistState::Braking, Some(Hold::Solver), false), 6);
        assert_eq!(
            look(200, TwistState::Disarmed, Some(Hold::Solver), false),
            6
        );
    }

    #[test]
    fn more_minutes_than_the_machine_holds_are_refused() {
        let flight = |minutes| FlightConfig {
            directory: "nowhere".into(),
            minutes,
            keep: 1,
            at_exit: false,
        };
        let check = |minutes, rate_hz| {
            Recorder::check_room(&flight(minutes), rate_hz, 8_000_000_000, "v.toml".into())
        };
        check(60.0, 30.0).unwrap();
        check(5.0, 1000.0).unwrap();
        let message = check(60.0, 1000.0).unwrap_err().to_string();
        let start = "v.toml: flight.minutes = 60; allowed: at most ";
        let end = " min at the scene's 1000 Hz, a quarter of this machine's 8.0 GB";
        let fitting = message.strip_prefix(start).unwrap().strip_suffix(end);
        let fitting: f64 = fitting.unwrap().parse().unwrap();
        check(fitting, 1000.0).unwrap();
        check(fitting + 0.2, 1000.0).unwrap_err();
    }

    #[test]
    fn what_comes_while_a_file_is_written_is_written_after_it() {
        let now = Instant::now();
        let moving = (TwistState::Moving, None);
        let fault = (TwistState::Disarmed, Some(Hold::RobotFault));
        let mut recorder = told_of(&[moving, fault]);
        let (disk, is_slow) = std::sync::mpsc::channel::<()>();
        recorder.writer = Some(std::thread::spawn(move || _ = is_slow.recv()));
        recorder.tend(true, now);
        recorder.tend(false, now);
        assert!(recorder.requested && recorder.disarmed == Some(Hold::RobotFault));
        drop(disk);
        assert!(recorder.wait());
        recorder.tend(false, now);
        assert!(!recorder.requested && recorder.disarmed.is_none());
    }
}
