//! Recording a domain as it lives.
//!
//! The thread that holds the ports only takes messages off their queues; another one turns them into JSON, compresses
//! and writes. A slow disk then fills the queue between the two, after it the subscriber's queues, and those overflow
//! in the recorder's disfavour: the daemon never waits, and the gap is counted.

use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::time::{Duration, Instant};

use ipc::{
    CycleRecord, Domain, Features, JoinError, Message, Observer, OpenError, ReceiveError, Received,
    Reply, Request, RobotState, Subscriber, TwistCommand,
};

use crate::context::Context;
use crate::file::{RecordingFile, WriteError};
use crate::ledger::{Ledger, Notice};
use crate::message::Recorded;

/// Sleep between two looks at the queues. The shortest queue holds 64 messages: enough for 30,000 a second.
const PAUSE: Duration = Duration::from_millis(2);
/// Time between two flushes.
const FLUSH: Duration = Duration::from_secs(1);
/// Messages between the two threads: minutes at 30 Hz, half a second in lockstep.
const QUEUE: usize = 1 << 14;
/// Failures to receive in a row, on one port, after which recording ends.
const MOST_FAILURES: u32 = 1_000;

/// What to record, and where to.
#[derive(Clone, Debug)]
pub struct Options {
    /// Directory of the domain.
    pub domain: PathBuf,
    /// File to write.
    pub output: PathBuf,
    /// Whether a file of this name may be overwritten.
    pub force: bool,
    /// How long; `None`: until stopped.
    pub duration: Option<Duration>,
}

/// Why a recording ended before its time, or never began.
#[derive(Debug, thiserror::Error)]
pub enum RecordError {
    /// The domain.
    #[error(transparent)]
    Join(#[from] JoinError),
    /// A port.
    #[error(transparent)]
    Open(#[from] OpenError),
    /// A port that fails again and again.
    #[error(transparent)]
    Receive(#[from] ReceiveError),
    /// The file.
    #[error(transparent)]
    Write(#[from] WriteError),
    /// The thread that writes.
    #[error("no thread to write the recording: {0}")]
    Thread(std::io::Error),
    /// The thread that writes ended for no known reason.
    #[error("the thread that writes the recording panicked")]
    Gone,
}

/// A message on its way to the file.
enum Item {
    Features(Received<Features>),
    Twist(Received<TwistCommand>),
    // Boxed: a queue of the largest messages would be mostly air.
    Robot(Box<Received<RobotState>>),
    Cycle(Box<Received<CycleRecord>>),
    Request(Received<Request>),
    Reply(Received<Reply>),
    Refused(&'static str, String),
}

/// Records until `stop` is set or the duration is over; what should be known at once goes to `tell`, from another
/// thread.
///
/// # Errors
/// [`RecordError`]. What was written until then can be read.
pub fn record(
    options: &Options,
    context: &Context,
    stop: &AtomicBool,
    tell: impl FnMut(&Notice) + Send,
) -> Result<Ledger, RecordError> {
    // The file first: a refusal must not disturb anybody.
    let file = RecordingFile::create(&options.output, options.force, context)?;
    let domain = Domain::join(&options.domain)?;
    let mut ports = Ports::open(&domain)?;
    let (items, queue) = sync_channel(QUEUE);
    std::thread::scope(|threads| {
        let writer = std::thread::Builder::new()
            .name("writer".to_owned())
            .spawn_scoped(threads, move || write(file, &queue, tell))
            .map_err(RecordError::Thread)?;
        let end = options.duration.map(|duration| Instant::now() + duration);
        let received = ports.forward(items, &domain, || {
            stop.load(Ordering::Relaxed)
                || writer.is_finished()
                || end.is_some_and(|end| Instant::now() >= end)
        });
        let ledger = writer.join().map_err(|_| RecordError::Gone)??;
        received?;
        Ok(ledger)
    })
}

/// All that a domain says.
struct Ports {
    observer: Observer,
    requests: Subscriber<Request>,
    replies: Subscriber<Reply>,
}

impl Ports {
    fn open(domain: &Domain) -> Result<Self, OpenError> {
        Ok(Self {
            observer: Observer::open(domain)?,
            requests: domain.subscriber(Request::QOS.buffer)?,
            replies: domain.subscriber(Reply::QOS.buffer)?,
        })
    }

    /// Takes messages off the queues until `is_over`, and once more.
    fn forward(
        &mut self,
        items: SyncSender<Item>,
        domain: &Domain,
        is_over: impl Fn() -> bool,
    ) -> Result<(), ReceiveError> {
        let mut failures = [0; 6];
        let mut swept = Instant::now();
        loop {
            let last = is_over();
            let Observer {
                features,
                twist,
                robot,
                cycles,
            } = &mut self.observer;
            // Causes before effects, so that a finished recording holds no answer without its question.
            drain(features, Item::Features, &items, &mut failures[0])?;
            drain(&mut self.requests, Item::Request, &items, &mut failures[1])?;
            drain(
                robot,
                |m| Item::Robot(Box::new(m)),
                &items,
                &mut failures[2],
            )?;
            drain(twist, Item::Twist, &items, &mut failures[3])?;
            drain(&mut self.replies, Item::Reply, &items, &mut failures[4])?;
            drain(
                cycles,
                |m| Item::Cycle(Box::new(m)),
                &items,
                &mut failures[5],
            )?;
            if last {
                return Ok(());
            }
            // As the daemon does: what killed peers left half-made could hang whoever receives.
            if swept.elapsed() >= Duration::from_secs(1) {
                domain.sweep();
                swept = Instant::now();
            }
            std::thread::sleep(PAUSE);
        }
    }
}

/// Takes what waits on one port, at most one queue full. Blocks where the writer does not keep up.
fn drain<T: Recorded>(
    port: &mut Subscriber<T>,
    item: fn(Received<T>) -> Item,
    items: &SyncSender<Item>,
    failures: &mut u32,
) -> Result<(), ReceiveError> {
    for _ in 0..T::QOS.buffer {
        let item = match port.oldest() {
            Ok(None) => {
                *failures = 0;
                return Ok(());
            }
            Ok(Some(received)) => item(received),
            Err(ReceiveError::Invalid { invalid, .. }) => {
                Item::Refused(T::TOPIC, invalid.to_string())
            }
            Err(error) => {
                *failures += 1;
                return if *failures < MOST_FAILURES {
                    Ok(())
                } else {
                    Err(error)
                };
            }
        };
        // Nobody takes it where the writer has ended; its reason is reported after this.
        if items.send(item).is_err() {
            return Ok(());
        }
    }
    Ok(())
}

/// Writes what comes until nobody sends any more.
fn write(
    mut file: RecordingFile,
    queue: &Receiver<Item>,
    mut tell: impl FnMut(&Notice),
) -> Result<Ledger, WriteError> {
    let mut flushed = Instant::now();
    loop {
        let notice = match queue.recv_timeout(FLUSH) {
            Ok(Item::Features(m)) => file.features(&m, m.order)?,
            Ok(Item::Twist(m)) => file.twist(&m, m.order)?,
            Ok(Item::Robot(m)) => file.robot(&m, m.order)?,
            Ok(Item::Cycle(m)) => file.cycle(&m, m.order)?,
            Ok(Item::Request(m)) => file.request(&m, m.order)?,
            Ok(Item::Reply(m)) => file.reply(&m, m.order)?,
            Ok(Item::Refused(topic, reason)) => Some(file.refused(topic, reason)?),
            Err(RecvTimeoutError::Timeout) => None,
            Err(RecvTimeoutError::Disconnected) => return file.finish(),
        };
        if let Some(notice) = notice {
            tell(&notice);
        }
        if flushed.elapsed() >= FLUSH {
            file.flush()?;
            flushed = Instant::now();
        }
    }
}
