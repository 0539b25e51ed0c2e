//! The ordinary thread: takes what the loop leaves in its queues, publishes it, keeps it as flight
//! record, and writes the log.

use std::path::Path;
use std::sync::mpsc;
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use ipc::{Domain, JoinError, OpenError, ReceiveError, RecorderPort};
use messages::{Action, Message, Outcome, Reply, Request};
use tracing::{debug, error, info, warn};

use crate::flight::{Consumer, DumpRequest, Recorder};
use crate::reload::Reload;
use crate::service::Notifier;
use crate::summary::Summary;
use decision::snapshot;

/// Pause between two looks at the queue.
const PAUSE: Duration = Duration::from_millis(5);
/// Cycles in a row in which the stop file asks for a stop, after which it counts as lost.
const LOST: u32 = 10;

/// Why the ordinary thread could not do its work.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs)]
pub enum RecorderError {
    #[error(transparent)]
    Join(#[from] JoinError),
    #[error(transparent)]
    Open(#[from] OpenError),
    #[error("the recorder's thread did not start: {0}")]
    Thread(#[from] std::io::Error),
    #[error("the recorder's thread ended before it was ready")]
    Gone,
    /// Without it there is no log, no watchdog message and no flight record.
    #[error("the recorder's thread ended before the loop")]
    Died,
}

/// What the ordinary thread owns. Shared-memory ports stay in their thread, so it joins the domain
/// for itself.
pub struct Telemetry {
    /// What the loop leaves.
    pub consumer: Consumer,
    /// Set to request the flight record.
    pub dump: DumpRequest,
    /// The flight record.
    pub flight: Recorder,
    /// Talks to the service manager.
    pub notifier: Notifier,
    /// Answers SIGHUP.
    pub reload: Reload,
    /// The scene's arm.
    pub arm: Option<scene::Arm>,
}

impl Telemetry {
    /// Starts the thread, which ends when the loop lets go of its end of the queue and the queue is
    /// empty.
    ///
    /// # Errors
    /// [`RecorderError`].
    pub fn start(self, domain: &Path) -> Result<JoinHandle<Summary>, RecorderError> {
        let (ready, is_ready) = mpsc::channel();
        let domain = domain.to_owned();
        let thread = std::thread::Builder::new()
            .name("recorder".to_owned())
            .spawn(move || {
                let opened = Domain::join(&domain)
                    .map_err(RecorderError::from)
                    .and_then(|domain| Ok(RecorderPort::open(&domain)?));
                match opened {
                    Ok(port) => {
                        // The starter waits for it.
                        let _ = ready.send(Ok(()));
                        self.run(port)
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

    fn run(mut self, mut port: RecorderPort) -> Summary {
        let (mut summary, mut stops) = (Summary::new(self.arm.take()), StopLog::default());
        loop {
            // In this order: what was left before the loop let go, or before a request, is still
            // taken.
            let is_last = self.consumer.cycles.is_abandoned();
            let is_requested = self.dump.take();
            self.take(&mut port, &mut summary, &mut stops);
            self.flight.tend(is_requested, Instant::now());
            if is_last {
                self.flight.end();
                self.notifier.end(Instant::now(), || summary.status());
                return summary;
            }
            log_refused_requests(&mut port);
            self.reload.tend();
            self.notifier.tend(Instant::now(), || summary.status());
            std::thread::sleep(PAUSE);
        }
    }

    /// Publishes and keeps what the loop left.
    fn take(&mut self, port: &mut RecorderPort, summary: &mut Summary, stops: &mut StopLog) {
        while let Ok(mut cycle) = self.consumer.cycles.pop() {
            match port.cycles.publish(&cycle.record) {
                Ok(sent) => {
                    let stamp = &mut cycle.record.stamp;
                    (stamp.sequence, stamp.published_ns) = (sent.sequence, sent.published_ns);
                }
                Err(error) => debug!(%error, "telemetry not published"),
            }
            summary.add(&cycle.record);
            self.flight.push(cycle);
        }
        while let Ok(before) = self.consumer.states.pop() {
            match snapshot::encode(before.cycle, &before.state) {
                Ok(mut snapshot) => {
                    snapshot.stamp.data_ns = before.taken_ns;
                    match port.snapshots.publish(&snapshot) {
                        Ok(sent) => {
                            let stamp = &mut snapshot.stamp;
                            (stamp.sequence, stamp.published_ns) =
                                (sent.sequence, sent.published_ns);
                        }
                        Err(error) => debug!(%error, "snapshot not published"),
                    }
                    self.flight.push_snapshot(snapshot);
                }
                Err(error) => warn!("{error}"),
            }
        }
        while let Ok(reply) = self.consumer.replies.pop() {
            match reply.id {
                Request::STOP_FILE => stops.log(&reply),
                _ => log_reply(&reply),
            }
            self.flight.push_reply(reply);
        }
    }
}

/// Logs requests that the loop cannot answer, and those with unknown codes. The loop itself does
/// not log.
fn log_refused_requests(port: &mut RecorderPort) {
    // As many as a queue holds: a flood must not keep this thread from its records.
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
}

/// Logs stops by the file.
#[derive(Default)]
struct StopLog {
    /// The cycle of the last one.
    cycle: u64,
    /// How many came in cycles one after the other, until the last one.
    in_a_row: u32,
}

impl StopLog {
    fn log(&mut self, reply: &Reply) {
        let follows = reply.cycle <= self.cycle + 1;
        self.in_a_row = if follows { self.in_a_row + 1 } else { 1 };
        self.cycle = reply.cycle;
        match self.in_a_row {
            1 => info!("stop file: stopped"),
            // No hand writes so often.
            LOST => error!(
                "stop file: it was removed or replaced, or cannot be read: nothing moves until vpcd is started again"
            ),
            _ => (),
        }
    }
}

/// Logs what an operator asked for, and was answered.
fn log_reply(reply: &Reply) {
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
