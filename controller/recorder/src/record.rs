//! Recording a domain while it works.
//!
//! One thread takes messages off the ports' queues, another turns them into JSON, compresses and
//! writes. If the disk is slow, the queue between the two fills, then those of the ports, and the
//! recorder loses messages and counts them; publishers never wait.

use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::time::{Duration, Instant};

use arm::Mount;
use ipc::{Domain, JoinError, OpenError, ReceiveError};
use messages::{CycleRecord, Message};
use recording::{RecordingFile, WriteError};
use scene::SceneFiles;

use crate::ledger::{Ledger, Notice};
use crate::ports::{self, Item, Source};
use crate::recorder::Recorder;

/// Sleep between two looks at the queues. The shortest holds 64 messages, so 30,000 a second.
const PAUSE: Duration = Duration::from_millis(2);
/// Time between two flushes, and until it is said that nothing is heard.
const FLUSH: Duration = Duration::from_secs(1);
/// Messages between the two threads: minutes at 30 Hz, half a second in lockstep.
const QUEUE: usize = 1 << 14;

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
    /// The camera on the arm, where it is known.
    pub mount: Option<Mount>,
}

/// Why a recording, or a live server, ended early or did not begin.
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
    #[error("no thread to work in: {0}")]
    Thread(std::io::Error),
    #[error("{address}: {source}; allowed: a free address of this machine (port 0: any free port)")]
    Listen {
        address: SocketAddr,
        source: std::io::Error,
    },
    #[error("the thread that writes the recording panicked")]
    Panicked,
}

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
    let mut recorder = Recorder::create(&options.output, options.force)?;
    recorder.writer.mount = options.mount;
    let domain = Domain::join(&options.domain)?;
    let mut ports = ports::all(&domain)?;
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

/// Takes messages off the queues until `is_over`, and once more.
fn forward(
    ports: &mut [Box<dyn Source<RecordingFile>>],
    items: SyncSender<Item<RecordingFile>>,
    is_over: impl Fn() -> bool,
) -> Result<(), ReceiveError> {
    loop {
        let is_last = is_over();
        for port in &mut *ports {
            // Blocks where the writer does not keep up. Where it has ended, its reason is reported
            // after this.
            port.drain(&mut |item| items.send(item).is_ok())?;
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
    queue: &Receiver<Item<RecordingFile>>,
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
