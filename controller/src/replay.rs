//! The replay: repeats the control step on the inputs in a recording, and finds the first bit that
//! differs.
//!
//! A cycle's decision is a function of what it received, of the instant for which it decided, and
//! of the state that earlier cycles left ([`decision::control`]). All of it is in a recording: each
//! record has the stamps of the messages that its cycle received, each reply has the cycle that
//! took its request, and every second or so there is a snapshot of the state. So a replay can begin
//! at any snapshot. If something is missing, it continues at the next one.

pub mod command;
mod difference;
mod source;

use std::ops::Range;

use messages::{CycleFlags, CycleRecord, Reply, Request};
use recording::Recording;
use serde::Serialize;

use decision::ControlStep;
use decision::snapshot::{self, SnapshotError};
use source::Source;

pub use difference::Difference;

/// The result of a replay without a difference.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Report {
    /// Cycles that gave the same bits.
    pub cycles: u64,
    /// Number of the first one; 0 if there was none.
    pub first: u64,
    /// Number of the last one.
    pub last: u64,
    /// Snapshots that the state was compared with on the way.
    pub snapshots_compared: u64,
    /// Snapshots from which the replay began, or began again after a missing message.
    pub snapshots_restored: u64,
    /// Cycles that could not be replayed: those before the first snapshot, and from a missing
    /// message to the next snapshot.
    pub skipped: u64,
}

/// Why a replay ended early.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs)]
pub enum ReplayError {
    #[error(transparent)]
    Difference(#[from] Box<Difference>),
    #[error(transparent)]
    Snapshot(#[from] SnapshotError),
}

/// Repeats all cycles of a recording, or only cycle `until` and those since the last snapshot
/// before it.
///
/// # Errors
/// The first [`Difference`], or a snapshot that cannot be used.
pub fn replay(
    control: &mut ControlStep,
    recording: &Recording,
    until: Option<u64>,
) -> Result<Report, ReplayError> {
    let source = Source::new(recording);
    let mut report = Report::default();
    // A number that falls back is a daemon that started again.
    let runs = recording
        .cycles
        .chunk_by(|one, next| next.cycle > one.cycle);
    let mut runs = runs.peekable();
    let mut begin_ns = 0;
    while let Some(run) = runs.next() {
        let next = runs.peek().and_then(|next| next.first());
        let end_ns = next.map_or(u64::MAX, |next| next.stamp.data_ns);
        let run = match until {
            Some(until) => source.last_stretch(run, begin_ns, until),
            None => run,
        };
        replay_run(control, &source, run, begin_ns..end_ns, &mut report)?;
        begin_ns = run.last().map_or(begin_ns, |last| last.stamp.data_ns);
    }
    Ok(report)
}

/// Repeats the cycles of one daemon, from when the last one before it woke up until the first one
/// after it does.
fn replay_run(
    control: &mut ControlStep,
    source: &Source,
    run: &[CycleRecord],
    span_ns: Range<u64>,
    report: &mut Report,
) -> Result<(), ReplayError> {
    let mut before_ns = span_ns.start;
    // The cycle that the state is right for.
    let mut ready = None;
    for (place, record) in run.iter().enumerate() {
        let next_ns = run
            .get(place + 1)
            .map_or(span_ns.end, |next| next.stamp.data_ns);
        let is_ready = ready == Some(record.cycle);
        ready = None;
        if let Some(snapshot) = source.snapshot(record, span_ns.start) {
            let state = snapshot::decode(snapshot)?;
            if is_ready {
                report.snapshots_compared += 1;
            } else {
                control.restore(&state);
                report.snapshots_restored += 1;
            }
            // Also after restoring: a snapshot may say what no control step says.
            difference::compare_states(record.cycle, &state, &control.state())?;
        } else if !is_ready {
            report.skipped += 1;
            before_ns = record.stamp.data_ns;
            continue;
        }
        let replies = source.replies(record, before_ns..next_ns);
        before_ns = record.stamp.data_ns;
        let (Some(inputs), Some(replies)) = (source.inputs(record), replies) else {
            report.skipped += 1;
            continue;
        };
        for reply in replies {
            repeat_request(control, reply)?;
        }
        let mut replayed = measured(record);
        control.decide(&inputs, &mut replayed);
        control.sent_at(inputs.now_ns.saturating_add(record.step_ns));
        if record.flags & CycleFlags::SENT.0 == 0 {
            control.unsent();
        }
        control.think();
        difference::compare_messages(record.cycle, "", record, &replayed)?;
        ready = Some(record.cycle + 1);
        report.cycles += 1;
        report.last = record.cycle;
        if report.first == 0 {
            report.first = record.cycle;
        }
    }
    Ok(())
}

/// Asks again what an operator asked. The request follows from the answer, as far as it changed
/// anything.
fn repeat_request(control: &mut ControlStep, reply: &Reply) -> Result<(), Box<Difference>> {
    let Some(mut request) = request_of(reply) else {
        return Ok(());
    };
    request.stamp.published_ns = reply.stamp.data_ns;
    // Also where it names a veto and does not arm.
    request.veto = reply.named;
    let mut replayed = control.request(&request, reply.cycle);
    replayed.stamp = reply.stamp;
    difference::compare_messages(reply.cycle, "reply.", reply, &replayed)
}

fn request_of(reply: &Reply) -> Option<Request> {
    use messages::{Action, Outcome, StrategyCode};
    match (Action::from_code(reply.action)?, reply.outcome()?) {
        (_, Outcome::Unknown | Outcome::Late) => None,
        (Action::Strategy, Outcome::Done) => {
            let strategy = StrategyCode::from_code(reply.strategy)?;
            Some(Request::strategy(reply.id, strategy, reply.neighbours))
        }
        (Action::Strategy, _) => None,
        (action, _) => Some(Request::new(reply.id, action)),
    }
}

/// What the loop measured and counted about a cycle, without what was decided.
fn measured(record: &CycleRecord) -> CycleRecord {
    CycleRecord {
        stamp: record.stamp,
        cycle: record.cycle,
        clock: record.clock,
        wake_latency_ns: record.wake_latency_ns,
        receive_ns: record.receive_ns,
        step_ns: record.step_ns,
        send_ns: record.send_ns,
        overruns: record.overruns,
        features_age_ns: record.features_age_ns,
        lost_records: record.lost_records,
        realtime: record.realtime,
        phase: record.phase,
        phase_error_ns: record.phase_error_ns,
        minor_faults: record.minor_faults,
        major_faults: record.major_faults,
        blocked: record.blocked,
        allocations: record.allocations,
        requests: record.requests,
        flags: record.flags & CycleFlags::SENT.0,
        ..CycleRecord::default()
    }
}
