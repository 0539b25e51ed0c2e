//! The ordinary thread: takes records from the loop by a wait-free queue, publishes them, keeps them as flight record,
//! and writes the log.

use std::path::Path;
use std::sync::mpsc;
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use ipc::{
    Action, CycleRecord, Domain, Hold, JoinError, Message, OpenError, Outcome, PhaseCode, RealTime,
    RecallCode, ReceiveError, RecorderPort, Reply, Request, TwistState,
};
use tracing::{debug, info, warn};

use crate::flight::{Recorder, Tail};
use crate::histogram::Histogram;
use crate::report::Report;
use crate::service::Talk;

/// Pause between two looks at the queue.
const PAUSE: Duration = Duration::from_millis(5);
/// Time between two sweeps for what killed peers left unfinished, which could hang the loop.
const SWEEP: Duration = Duration::from_secs(1);

/// Why the recorder could not start.
#[derive(Debug, thiserror::Error)]
pub enum RecorderError {
    /// The domain.
    #[error(transparent)]
    Join(#[from] JoinError),
    /// The port.
    #[error(transparent)]
    Open(#[from] OpenError),
    /// The thread.
    #[error("the recorder's thread did not start: {0}")]
    Thread(#[from] std::io::Error),
    /// The thread ended before it was ready.
    #[error("the recorder's thread ended before it was ready")]
    Gone,
    /// The thread ended while the loop ran: nobody logs, feeds the watchdog, or keeps flight records any more.
    #[error("the recorder's thread ended before the loop")]
    Died,
}

/// Starts the recorder, which ends when the loop lets go of its end of the queue and the queue is empty. It joins the
/// domain for itself: shared-memory ports stay in their thread. It also does the talking with the service manager.
///
/// # Errors
/// [`RecorderError`].
pub fn start(
    domain: &Path,
    tail: Tail,
    talk: Talk,
    flight: Recorder,
) -> Result<JoinHandle<Summary>, RecorderError> {
    let (ready, is_ready) = mpsc::channel();
    let domain = domain.to_owned();
    let thread = std::thread::Builder::new()
        .name("recorder".to_owned())
        .spawn(move || {
            let opened = Domain::join(&domain)
                .map_err(RecorderError::from)
                .and_then(|domain| Ok((RecorderPort::open(&domain)?, domain)));
            match opened {
                Ok((port, domain)) => {
                    // The starter waits for it.
                    let _ = ready.send(Ok(()));
                    record(port, tail, &domain, talk, flight)
                }
                Err(error) => {
                    let _ = ready.send(Err(error));
                    Summary::default()
                }
            }
        })?;
    is_ready.recv().map_err(|_| RecorderError::Gone)??;
    Ok(thread)
}

fn record(
    mut port: RecorderPort,
    mut tail: Tail,
    domain: &Domain,
    mut talk: Talk,
    mut flight: Recorder,
) -> Summary {
    let mut summary = Summary::default();
    let mut swept = Instant::now();
    loop {
        if swept.elapsed() >= SWEEP {
            domain.sweep();
            swept = Instant::now();
        }
        // In this order: what was pushed before the loop let go is still taken.
        let last_round = tail.is_abandoned();
        let wished = tail.wished();
        while let Some(record) = tail.pop() {
            if let Err(error) = port.cycles.publish(&record.told) {
                debug!(%error, "telemetry not published");
            }
            summary.add(&record.told);
            flight.push(record);
        }
        while let Some(key) = tail.pop_key() {
            flight.push_key(key);
        }
        flight.tend(wished, Instant::now());
        if last_round {
            flight.end();
            talk.end(|| summary.status());
            return summary;
        }
        tell_requests(&mut port);
        talk.tend(|| summary.status());
        std::thread::sleep(PAUSE);
    }
}

/// Writes what operators asked, and what they were answered, to the log. The loop, which did the answering, does not
/// log.
fn tell_requests(port: &mut RecorderPort) {
    // As many as a queue holds: a flood must not keep the recorder from its records.
    for _ in 0..Request::QOS.buffer {
        match port.requests.oldest() {
            Ok(None) => break,
            Ok(Some(request)) => {
                if let Err(error) = request.check_codes() {
                    warn!(id = request.id, %error, "operator: request refused: {error}");
                }
            }
            Err(error @ ReceiveError::Invalid { .. }) => {
                warn!(%error, "request without a head, not answered: {error}");
            }
            Err(error @ ReceiveError::Transport { .. }) => {
                debug!(%error, "requests not received");
                break;
            }
        }
    }
    for _ in 0..Reply::QOS.buffer {
        let Ok(Some(reply)) = port.replies.oldest() else {
            break;
        };
        let id = reply.id;
        if let (Some(action), Some(outcome)) = (Action::from_code(reply.action), reply.outcome()) {
            match outcome {
                Outcome::Done => info!(id, %action, "operator: {action}: {outcome}"),
                // Told with its code, above.
                Outcome::Unknown => (),
                _ => warn!(id, %action, "operator: {action}: {outcome}"),
            }
        }
    }
}

/// What the records of a run amount to; tells the log when something changes.
#[derive(Clone, Debug)]
pub struct Summary {
    cycles: u64,
    held: u64,
    overruns: u64,
    lost: u64,
    armed: u64,
    recalled: u64,
    busy: Histogram,
    wake: Histogram,
    receive: Histogram,
    step: Histogram,
    send: Histogram,
    minor_faults: u64,
    major_faults: u64,
    blocked: u64,
    allocations: u64,
    realtime: RealTime,
    phase: u32,
    state: u32,
    hold: u32,
    error_px: f64,
}

impl Default for Summary {
    fn default() -> Self {
        Self {
            cycles: 0,
            held: 0,
            overruns: 0,
            lost: 0,
            armed: 0,
            recalled: 0,
            busy: Histogram::default(),
            wake: Histogram::default(),
            receive: Histogram::default(),
            step: Histogram::default(),
            send: Histogram::default(),
            minor_faults: 0,
            major_faults: 0,
            blocked: 0,
            allocations: 0,
            realtime: RealTime::default(),
            phase: PhaseCode::Free.code(),
            state: TwistState::Stopped.code(),
            hold: Hold::None.code(),
            error_px: 0.0,
        }
    }
}

impl Summary {
    fn add(&mut self, record: &CycleRecord) {
        self.cycles += 1;
        self.held += u64::from(record.hold != Hold::None.code());
        self.busy
            .add(record.receive_ns + record.step_ns + record.send_ns);
        self.wake.add(record.wake_latency_ns);
        self.receive.add(record.receive_ns);
        self.step.add(record.step_ns);
        self.send.add(record.send_ns);
        self.recalled += u64::from(record.recalled == RecallCode::Followed.code());
        self.realtime = RealTime(record.realtime);
        self.count_costs(record);
        self.tell_changes(record);
        self.phase = record.phase;
        (self.state, self.hold) = (record.state, record.hold);
        self.error_px = record.error_px;
        (self.overruns, self.lost) = (record.overruns, record.lost_records);
    }

    /// Cycles that steer are to cost nothing but time, once all peers are met.
    fn count_costs(&mut self, record: &CycleRecord) {
        self.armed += u64::from(record.hold == Hold::None.code());
        if record.hold == Hold::None.code() && self.armed > Report::WARM_UP {
            self.minor_faults += u64::from(record.minor_faults);
            self.major_faults += u64::from(record.major_faults);
            self.blocked += u64::from(record.blocked);
            self.allocations += u64::from(record.allocations);
        }
    }

    fn tell_changes(&self, record: &CycleRecord) {
        let cycle = record.cycle;
        if let Some(phase) = PhaseCode::from_code(record.phase)
            && record.phase != self.phase
        {
            let error_us = record.phase_error_ns as f64 / 1e3;
            info!(cycle, %phase, error_us, "phase of the grid: {phase}");
        }
        if record.state != self.state || record.hold != self.hold {
            match (
                TwistState::from_code(record.state),
                Hold::from_code(record.hold),
            ) {
                (Some(state), Some(cause)) if cause != Hold::None => {
                    let features = record.features_sequence;
                    warn!(cycle, features, %cause, "{state}: {cause}");
                }
                (Some(state), _) => {
                    let error_px = record.error_px;
                    info!(cycle, %state, error_px, "now {state}");
                }
                (None, _) => (),
            }
        }
        if record.overruns > self.overruns {
            let missed = record.overruns - self.overruns;
            let (receive_ns, step_ns, send_ns) =
                (record.receive_ns, record.step_ns, record.send_ns);
            let wake_ns = record.wake_latency_ns;
            warn!(
                cycle,
                missed, wake_ns, receive_ns, step_ns, send_ns, "overrun: {missed} releases missed"
            );
        }
        if record.lost_records > self.lost {
            let lost = record.lost_records - self.lost;
            warn!(
                cycle,
                lost, "{lost} records of telemetry lost: the recorder is slower than the loop"
            );
        }
    }

    /// Cycles counted.
    pub fn cycles(&self) -> u64 {
        self.cycles
    }

    /// State and counters in one line, for the service manager.
    pub fn status(&self) -> String {
        let state = match (
            TwistState::from_code(self.state),
            Hold::from_code(self.hold),
        ) {
            _ if self.cycles == 0 => "starting".to_owned(),
            (Some(state), Some(cause)) if cause != Hold::None => format!("{state}: {cause}"),
            (Some(state), _) => format!("{state}, error {:.1} px", self.error_px),
            (None, _) => "unknown".to_owned(),
        };
        let degraded = match self.realtime.is_degraded() {
            true => format!("; NOT REAL TIME: {}", lacks(self.realtime)),
            false => String::new(),
        };
        let phase = match PhaseCode::from_code(self.phase) {
            Some(PhaseCode::Free) | None => String::new(),
            Some(phase) => format!(", phase {phase}"),
        };
        format!(
            "{state}{phase}{degraded}; {} cycles, {} held, {} overruns, {} records lost",
            self.cycles, self.held, self.overruns, self.lost
        )
    }

    /// The run in numbers, without what only the loop's thread knows.
    pub fn report(&self) -> Report {
        Report {
            cycles: self.cycles,
            armed: self.armed,
            recalled: self.recalled,
            overruns: self.overruns,
            lost_records: self.lost,
            wake_ns: self.wake.percentiles(),
            receive_ns: self.receive.percentiles(),
            step_ns: self.step.percentiles(),
            send_ns: self.send.percentiles(),
            busy_ns: self.busy.percentiles(),
            minor_faults: self.minor_faults,
            major_faults: self.major_faults,
            blocked: self.blocked,
            allocations: self.allocations,
            realtime: self.realtime.0,
            ..Report::default()
        }
    }

    /// Writes the end of a run to the log.
    pub fn tell(&self) {
        for (phase, histogram) in [
            ("wake", &self.wake),
            ("receive", &self.receive),
            ("step", &self.step),
            ("send", &self.send),
            ("busy", &self.busy),
        ] {
            let us = |ns: u64| ns as f64 / 1e3;
            let found = histogram.percentiles();
            let (p50_us, p99_us) = (us(found.p50), us(found.p99));
            let (p999_us, max_us) = (us(found.p999), us(found.max));
            info!(phase, p50_us, p99_us, p999_us, max_us, "time of {phase}");
        }
        info!(
            cycles = self.cycles,
            held = self.held,
            overruns = self.overruns,
            lost_records = self.lost,
            minor_faults = self.minor_faults,
            major_faults = self.major_faults,
            blocked = self.blocked,
            allocations = self.allocations,
            "stopped"
        );
    }
}

/// What real time lacks, in words.
fn lacks(realtime: RealTime) -> String {
    [
        (RealTime::NO_FIFO, "no SCHED_FIFO"),
        (RealTime::NO_CPU, "not on its processor"),
        (RealTime::NO_LOCK, "memory not locked"),
    ]
    .into_iter()
    .filter(|(bit, _)| realtime.has(*bit))
    .map(|(_, words)| words)
    .collect::<Vec<_>>()
    .join(", ")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn record(cycle: u64) -> CycleRecord {
        CycleRecord {
            cycle,
            ..CycleRecord::default()
        }
    }

    #[test]
    fn the_status_says_what_real_time_lacks_as_long_as_it_lacks_it() {
        let mut summary = Summary::default();
        summary.add(&record(1));
        assert!(!summary.status().contains("REAL TIME"));
        let bits = RealTime::ASKED
            .with(RealTime::NO_FIFO)
            .with(RealTime::NO_LOCK);
        for cycle in 2..4 {
            let realtime = bits.0;
            summary.add(&CycleRecord {
                realtime,
                ..record(cycle)
            });
            let status = summary.status();
            let words = "; NOT REAL TIME: no SCHED_FIFO, memory not locked; ";
            assert!(status.contains(words), "{status}");
        }
    }

    #[test]
    fn costs_count_in_cycles_that_steer_and_not_while_peers_are_met() {
        let mut summary = Summary::default();
        for cycle in 1..=2 * Report::WARM_UP {
            let mut record = record(cycle);
            record.hold = match cycle % 2 {
                0 => Hold::None.code(),
                _ => Hold::NoFeatures.code(),
            };
            (record.minor_faults, record.allocations) = (1, 1);
            summary.add(&record);
        }
        assert_eq!(summary.report().minor_faults, 0);
        let mut last = record(1000);
        (last.minor_faults, last.blocked, last.allocations) = (3, 2, 1);
        summary.add(&last);
        let report = summary.report();
        let found = (report.minor_faults, report.blocked, report.allocations);
        assert_eq!(found, (3, 2, 1));
        assert_eq!(report.armed, Report::WARM_UP + 1);
    }
}
