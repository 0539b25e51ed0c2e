//! The ordinary thread's part: keeps the ring, sees faults and wishes, and has files written by a thread that may wait
//! for the disk.

use std::thread::JoinHandle;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use ipc::{CycleRecord, Hold, TwistState};
use tracing::{info, warn};

use super::about::{About, Build};
use super::file::Flight;
use super::record::{FlightRecord, Key};
use super::ring::Ring;
use super::store::Store;
use crate::config::Config;
use crate::law::Law;

/// Faults within this time of the last written one are in the log only: features that come and go must not fill a disk.
const BETWEEN_FAULTS: Duration = Duration::from_secs(60);

/// Longest wait for a file when the daemon ends.
const PATIENCE: Duration = Duration::from_secs(2);

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
    fault: Option<Hold>,
    written: Option<Instant>,
    writer: Option<JoinHandle<()>>,
}

impl Recorder {
    /// A recorder for this configuration and law.
    pub fn new(config: &Config, law: &Law) -> Self {
        let flight = &config.flight;
        let cycles = flight.minutes * 60.0 / law.scene().sampling_time();
        let store = Store::new(flight.directory.clone(), flight.keep);
        Self {
            store: Some((store, About::new(config, law))),
            at_exit: flight.at_exit,
            ..Self::nowhere(cycles.round() as usize)
        }
    }

    /// A recorder of so many cycles that writes nothing.
    pub fn nowhere(cycles: usize) -> Self {
        Self {
            ring: Ring::new(cycles),
            store: None,
            at_exit: false,
            was_moving: false,
            fault: None,
            written: None,
            writer: None,
        }
    }

    /// Takes in a record.
    pub fn push(&mut self, record: FlightRecord) {
        self.ring.push(record);
        if let Some(hold) = fault(self.was_moving, &record.told) {
            self.fault.get_or_insert(hold);
        }
        self.was_moving = is_moving(&record.told);
    }

    /// Takes in a key.
    pub fn push_key(&mut self, key: Key) {
        self.ring.push_key(key);
    }

    /// Has written what is due: on a wish, or on a fault since the last call.
    pub fn tend(&mut self, wished: bool, now: Instant) {
        let fault = self.fault.take();
        if wished {
            self.write(Cause::Request);
        } else if let Some(hold) = fault {
            let is_soon = |last| now.saturating_duration_since(last) < BETWEEN_FAULTS;
            if !self.written.is_some_and(is_soon) {
                self.written = Some(now);
                self.write(Cause::Fault(hold));
            }
        }
    }

    /// Has written what is wished at the end, and waits for it.
    pub fn end(&mut self) {
        if self.at_exit {
            self.wait();
            self.write(Cause::Exit);
        }
        self.wait();
    }

    /// Waits for the writer, but for no disk that hangs: what it leaves then is removed with the next file.
    fn wait(&mut self) {
        let end = Instant::now() + PATIENCE;
        let is_at_work =
            |writer: &Option<JoinHandle<()>>| writer.as_ref().is_some_and(|w| !w.is_finished());
        while is_at_work(&self.writer) && Instant::now() < end {
            std::thread::sleep(Duration::from_millis(2));
        }
        if is_at_work(&self.writer) {
            warn!("flight record given up: the disk takes longer than {PATIENCE:?}");
        }
    }

    /// Hands a copy to a thread of its own: a disk that hangs holds up neither telemetry nor the watchdog.
    fn write(&mut self, cause: Cause) {
        let Some((store, about)) = &self.store else {
            return;
        };
        let cause_text = cause.text();
        if self
            .writer
            .as_ref()
            .is_some_and(|writer| !writer.is_finished())
        {
            warn!(
                cause = cause_text,
                "flight record not written: the one before is still being written"
            );
            return;
        }
        let (keys, records) = self.ring.copy();
        let (store, about) = (store.clone(), about.clone());
        let work = move || write(&store, about, cause, keys, records);
        match std::thread::Builder::new()
            .name("flight".to_owned())
            .spawn(work)
        {
            Ok(writer) => self.writer = Some(writer),
            Err(error) => warn!(%error, "flight record not written: no thread"),
        }
    }
}

fn write(store: &Store, about: About, cause: Cause, keys: Vec<Key>, records: Vec<FlightRecord>) {
    let since = SystemTime::now().duration_since(UNIX_EPOCH);
    let written_unix_ms = since.map_or(0, |since| since.as_millis() as u64);
    let cycles = records.len();
    let flight = Flight {
        about: About {
            build: Build::running(),
            written_unix_ms,
            cause: cause.text(),
            ..about
        },
        keys,
        records,
    };
    match store.write(written_unix_ms, cause.word(), &flight.to_bytes()) {
        Ok(path) => info!(
            cycles,
            cause = flight.about.cause,
            "flight record written: {}",
            path.display()
        ),
        Err(error) => warn!(
            cause = flight.about.cause,
            "flight record not written: {error}"
        ),
    }
}

fn is_moving(told: &CycleRecord) -> bool {
    let state = TwistState::from_code(told.state);
    matches!(state, Some(TwistState::Moving | TwistState::Arrived))
}

/// The cause, where a camera that was moving is held for another reason than that somebody wanted it.
fn fault(was_moving: bool, told: &CycleRecord) -> Option<Hold> {
    let hold = Hold::from_code(told.hold)?;
    let is_wanted = matches!(
        hold,
        Hold::None | Hold::NotArmed | Hold::Operator | Hold::Shutdown
    );
    (was_moving && !is_wanted).then_some(hold)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    use crate::arguments::Arguments;

    fn told(state: TwistState, hold: Hold) -> CycleRecord {
        CycleRecord {
            state: state.code(),
            hold: hold.code(),
            ..CycleRecord::default()
        }
    }

    #[test]
    fn a_fault_is_a_motion_that_ends_unwanted() {
        let fault = |was_moving, state, hold| fault(was_moving, &told(state, hold));
        let stale = fault(true, TwistState::Braking, Hold::Stale);
        assert_eq!(stale, Some(Hold::Stale));
        assert_eq!(fault(false, TwistState::Holding, Hold::Stale), None);
        assert_eq!(fault(true, TwistState::Moving, Hold::None), None);
        assert_eq!(fault(true, TwistState::Disarmed, Hold::Operator), None);
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
        let law = Law::open(&config.scene, None, config.settings).unwrap();
        let mut recorder = Recorder::new(&config, &law);
        let store = Store::new(config.flight.directory.clone(), 10);
        let start = Instant::now();
        let mut cycle = 0;
        let mut look = |after: u64, state, hold, wished| {
            let mut record = FlightRecord::blank();
            record.told = told(state, hold);
            cycle += 1;
            record.told.cycle = cycle;
            recorder.push(record);
            recorder.tend(wished, start + Duration::from_secs(after));
            recorder.wait();
            store.files().len()
        };
        assert_eq!(look(0, TwistState::Moving, Hold::None, false), 0);
        assert_eq!(look(1, TwistState::Holding, Hold::Stale, false), 1);
        assert_eq!(look(2, TwistState::Holding, Hold::Stale, false), 1);
        assert_eq!(look(3, TwistState::Moving, Hold::None, false), 1);
        assert_eq!(look(4, TwistState::Holding, Hold::Hidden, false), 1);
        // A wish is always fulfilled.
        assert_eq!(look(5, TwistState::Moving, Hold::None, true), 2);
        assert_eq!(look(62, TwistState::Holding, Hold::Stale, false), 3);
        let newest = Flight::read(store.files().last().unwrap()).unwrap();
        assert_eq!(newest.about.cause, "fault: stale features");
    }
}
