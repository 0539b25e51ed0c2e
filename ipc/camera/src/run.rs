//! The loop: image in, features out.

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use ipc::{Domain, Features, Publisher, ReceiveError, Stamp};

use crate::config::{Clock, Config};
use crate::report::Report;
use crate::source::{Frame, SharedMemory};
use crate::tags::TagError;
use crate::tracker::Tracker;

/// Longest wait for an image before the stop flag is looked at.
const PATIENCE: Duration = Duration::from_millis(50);
/// How often the log is told.
const REPORT: Duration = Duration::from_secs(10);

/// The loop cannot go on.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs)]
pub enum RunError {
    #[error(transparent)]
    Join(#[from] ipc::JoinError),
    #[error(transparent)]
    Open(#[from] ipc::OpenError),
    #[error(transparent)]
    Receive(#[from] ReceiveError),
    #[error(transparent)]
    Publish(#[from] ipc::PublishError),
    #[error(transparent)]
    Tags(#[from] TagError),
}

/// Finds features in images until `stop` is set.
///
/// # Errors
/// [`RunError`]: the shared memory cannot be opened, or fails.
pub fn run(config: &Config, stop: &AtomicBool) -> Result<(), RunError> {
    let domain = Domain::join(&config.domain)?;
    let mut camera = Camera {
        features: domain.publisher()?,
        tracker: None,
        number: 0,
        report: Report::default(),
        config,
    };
    let mut images = SharedMemory::open(&domain)?;
    let mut told = Instant::now();
    tracing::info!(
        "waits for images on vpc/image in {}",
        domain.directory().display()
    );
    while !stop.load(Ordering::Relaxed) {
        let mut done = Ok(());
        match images.next(PATIENCE, &mut |frame| done = camera.take(frame)) {
            Ok(true) => done?,
            // A controller that came late gets the last features.
            Ok(false) => camera.features.refresh()?,
            Err(error @ ReceiveError::Invalid { .. }) => tracing::warn!("{error}"),
            Err(error) => return Err(error.into()),
        }
        if told.elapsed() >= REPORT {
            tracing::info!("{}", std::mem::take(&mut camera.report));
            told = Instant::now();
        }
    }
    tracing::info!("stopped; {}", camera.report);
    Ok(())
}

struct Camera<'a> {
    config: &'a Config,
    features: Publisher<Features>,
    tracker: Option<(Tracker, [usize; 2])>,
    /// Of the last frame.
    number: u64,
    report: Report,
}

impl Camera<'_> {
    fn take(&mut self, frame: &Frame<'_>) -> Result<(), RunError> {
        let begun = Instant::now();
        let camera = &self.config.scene.camera;
        let (size, expected) = (
            [frame.grey.width(), frame.grey.height()],
            [camera.width as usize, camera.height as usize],
        );
        if size != expected {
            tracing::warn!(
                "image of {} x {} px is not searched; the scene's camera has {} x {}",
                size[0],
                size[1],
                expected[0],
                expected[1]
            );
            return Ok(());
        }
        let tracker = match &mut self.tracker {
            Some((tracker, of)) if *of == size => tracker,
            other => {
                let tracker = Tracker::new(self.config.pattern.clone(), size[0], size[1])?;
                &mut other.insert((tracker, size)).0
            }
        };
        if frame.is_restarted || frame.number <= self.number {
            tracker.forget();
        } else if self.number > 0 {
            self.report.lost += frame.number - self.number - 1;
        }
        self.number = frame.number;
        let seen = tracker.see(&frame.grey, frame.number)?;
        let data_ns = frame
            .data_ns
            .saturating_add_signed(self.config.stamp_offset_ns);
        let mut features = Features::new(&seen.points, data_ns);
        features.visible = seen.visible;
        features.exposure_ns = frame.exposure_ns;
        features.stamp = Stamp {
            sequence: frame.number,
            published_ns: match self.config.clock {
                Clock::Fixed => ipc::now_ns(),
                Clock::Lockstep => frame.published_ns,
            },
            data_ns,
        };
        self.features.publish_verbatim(&features)?;
        let missing = seen.points.len() - seen.visible.count_ones() as usize;
        self.report.add(missing, seen.is_whole, begun.elapsed());
        Ok(())
    }
}
