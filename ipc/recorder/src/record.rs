//! Recording a domain while it works.
//!
//! One thread takes messages off the ports' queues, another turns them into JSON, compresses and
//! writes. If the disk is slow, the queue between the two fills, then those of the ports, and the
//! recorder loses messages and counts them; publishers never wait.

use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::time::{Duration, Instant};

use ipc::{
    CycleRecord, Domain, Features, JoinError, Message, OpenError, ReceiveError, Reply, Request,
    RobotState, Snapshot, Subscriber, TwistCommand,
};

use crate::ledger::{Ledger, Notice};
use crate::recorder::Recorder;
use crate::views::Viewed;
use recording::WriteError;
use scene::SceneFiles;

/// Sleep between two looks at the queues. The shortest holds 64 messages, so 30,000 a second.
const PAUSE: Duration = Duration::from_millis(2);
/// Time between two flushes, and until it is said that nothing is heard.
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
    /// The scene to draw and keep; `None`: the one that the daemon leaves in the domain.
    pub scene: Option<SceneFiles>,
}

/// Why a recording ended early or did not begin.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs)]
pub enum RecordError {
    #[error(transparent)]
    Join(#[from] JoinError),
    #[error(transparent)]
    Open(#[from] OpenError),
    /// A port failed again and again.
    #[error(transparent)]
    Receive(#[from] ReceiveError),
    #[error(transparent)]
    Write(#[from] WriteError),
    #[error("no thread to write the recording: {0}")]
    Thread(std::io::Error),
    #[error("the thread that writes the recording panicked")]
    Panicked,
}

/// What the writing thread is to do with a message.
type Item = Box<dyn FnOnce(&mut Recorder) -> Result<Option<Notice>, WriteError> + Send>;

/// Records until `stop` is set or the duration is over. At the daemon's first cycle it takes what
/// the daemon left in the domain: configuration, and scene. `tell` is called from another thread.
///
/// # Errors
/// [`RecordError`]. What was written until then can be read.
pub fn record(
    options: &Options,
    stop: &AtomicBool,
    tell: impl FnMut(&Notice) + Send,
) -> Result<Ledger, RecordError> {
    // The file first: if it is refused, nothing has happened in the domain.
    let recorder = Recorder::create(&options.output, options.force)?;
    let domain = Domain::join(&options.domain)?;
    let mut ports = ports(&domain)?;
    let (items, queue) = sync_channel(QUEUE);
    std::thread::scope(|threads| {
        let writer = std::thread::Builder::new()
            .name("writer".to_owned())
            .spawn_scoped(threads, move || write(recorder, options, &queue, tell))
            .map_err(RecordError::Thread)?;
        let end = options.duration.map(|duration| Instant::now() + duration);
        let received = forward(&mut ports, items, || {
            stop.load(Ordering::Relaxed)
                || writer.is_finished()
                || end.is_some_and(|end| Instant::now() >= end)
        });
        let ledger = writer.join().map_err(|_| RecordError::Panicked)??;
        received?;
        Ok(ledger)
    })
}

/// A port of any type of message.
trait Source {
    fn drain(&mut self, items: &SyncSender<Item>) -> Result<(), ReceiveError>;
}

/// Ports for all that a domain publishes, causes before effects: a finished recording has no answer
/// without its question.
fn ports(domain: &Domain) -> Result<[Box<dyn Source>; 7], OpenError> {
    Ok([
        Port::<Features>::open(domain)?,
        Port::<Request>::open(domain)?,
        Port::<RobotState>::open(domain)?,
        Port::<TwistCommand>::open(domain)?,
        Port::<Snapshot>::open(domain)?,
        Port::<CycleRecord>::open(domain)?,
        Port::<Reply>::open(domain)?,
    ])
}

struct Port<T: Viewed> {
    subscriber: Subscriber<T>,
    /// Failures in a row.
    failures: u32,
}

impl<T: Viewed + Send> Port<T> {
    fn open(domain: &Domain) -> Result<Box<dyn Source>, OpenError> {
        Ok(Box::new(Self {
            subscriber: domain.subscriber(T::QOS.buffer)?,
            failures: 0,
        }))
    }
}

impl<T: Viewed + Send> Source for Port<T> {
    /// Takes what waits, at most one queue full. Blocks where the writer does not keep up.
    fn drain(&mut self, items: &SyncSender<Item>) -> Result<(), ReceiveError> {
        for _ in 0..T::QOS.buffer {
            let item: Item = match self.subscriber.oldest() {
                Ok(None) => {
                    self.failures = 0;
                    return Ok(());
                }
                Ok(Some(m)) => Box::new(move |to| to.take(&m.message, m.order)),
                Err(ReceiveError::Invalid { invalid, .. }) => {
                    Box::new(move |to| to.refuse(T::TOPIC, invalid.to_string()).map(Some))
                }
                Err(error) => {
                    self.failures += 1;
                    return match self.failures < MOST_FAILURES {
                        true => Ok(()),
                        false => Err(error),
                    };
                }
            };
            // The writer has ended: its reason is reported after this.
            if items.send(item).is_err() {
                return Ok(());
            }
        }
        Ok(())
    }
}

/// Takes messages off the queues until `is_over`, and once more.
fn forward(
    ports: &mut [Box<dyn Source>],
    items: SyncSender<Item>,
    is_over: impl Fn() -> bool,
) -> Result<(), ReceiveError> {
    loop {
        let is_last = is_over();
        for port in &mut *ports {
            port.drain(&items)?;
        }
        if is_last {
            return Ok(());
        }
        std::thread::sleep(PAUSE);
    }
}

/// Writes what comes until the other thread has ended.
fn write(
    mut recorder: Recorder,
    options: &Options,
    queue: &Receiver<Item>,
    mut tell: impl FnMut(&Notice),
) -> Result<Ledger, WriteError> {
    let begun = Instant::now();
    let mut flushed = begun;
    let (mut is_complete, mut is_waiting) = (false, false);
    if let Some(scene) = &options.scene {
        recorder.describe(scene)?;
    }
    loop {
        match queue.recv_timeout(FLUSH) {
            Ok(item) => item(&mut recorder)?.iter().for_each(&mut tell),
            Err(RecvTimeoutError::Timeout) => (),
            Err(RecvTimeoutError::Disconnected) => break,
        }
        let has_cycles = recorder.ledger().of(CycleRecord::TOPIC).recorded > 0;
        if has_cycles && !is_complete {
            is_complete = true;
            complete(&mut recorder, options, &mut tell)?;
        }
        if has_cycles && is_waiting {
            is_waiting = false;
            tell(&Notice::Begun);
        } else if !has_cycles && !is_waiting && begun.elapsed() >= FLUSH {
            is_waiting = true;
            let domain = options.domain.display().to_string();
            tell(&Notice::Waiting { domain });
        }
        if flushed.elapsed() >= FLUSH {
            recorder.flush()?;
            flushed = Instant::now();
        }
    }
    recorder.finish()
}

/// Adds what the daemon left in the domain.
fn complete(
    recorder: &mut Recorder,
    options: &Options,
    tell: &mut impl FnMut(&Notice),
) -> Result<(), WriteError> {
    let config = options.domain.join(ipc::CONFIG_FILE);
    match std::fs::read_to_string(&config) {
        Ok(config) => recorder.configure(&config)?,
        Err(error) => tell(&Notice::NoConfig {
            reason: format!("{}: {error}", config.display()),
        }),
    }
    if options.scene.is_some() {
        return Ok(());
    }
    match SceneFiles::read(&options.domain.join(ipc::SCENE_FILE)) {
        Ok(scene) => recorder.describe(&scene),
        Err(error) => {
            tell(&Notice::NoScene {
                reason: error.to_string(),
            });
            Ok(())
        }
    }
}
