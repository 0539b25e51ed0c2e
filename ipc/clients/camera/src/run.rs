//! The loop: from images to `vpc/features`.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::Sender;
use std::time::{Duration, Instant};

use ipc::{Domain, Publisher};
use messages::Features;
use program::StartUp;

use crate::config::{Clock, Config, SourceKind};
use crate::finder::{Finder, Found};
use crate::mask_check::{Counts, MaskCheck, Settings, Warning};
use crate::source::{Camera, Frame, Next, Replay, Request, SharedMemory, Source, SourceError};
use crate::tags::TagError;

/// Between two looks for an image: in lockstep somebody waits for the answer.
const PAUSE: Duration = Duration::from_micros(200);
const LOCKSTEP_PAUSE: Duration = Duration::from_micros(20);

/// Why the loop ended.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs)]
pub enum RunError {
    #[error(transparent)]
    Join(#[from] ipc::JoinError),
    #[error(transparent)]
    Open(#[from] ipc::OpenError),
    #[error(transparent)]
    Publish(#[from] ipc::PublishError),
    #[error(transparent)]
    Source(#[from] SourceError),
    #[error(transparent)]
    Tags(#[from] TagError),
}

/// What became of an image.
#[derive(Clone, Debug)]
pub struct Report {
    /// Number of the frame.
    pub sequence: u64,
    /// Frames that were lost before it.
    pub lost: u64,
    /// Middle of the exposure, ns.
    pub data_ns: u64,
    /// What it showed.
    pub found: Found,
    /// How often tags contradicted the scene's occlusions since the start.
    pub mask: Counts,
    /// From the image to its features.
    pub took: Duration,
    /// From the middle of the exposure to the features; 0 in lockstep.
    pub age: Duration,
}

/// What the loop tells the rest of the program.
#[derive(Clone, Debug)]
pub enum Event {
    /// An image became features.
    Frame(Report),
    /// An image has another size, px, than the scene's camera: it has no features.
    Size {
        /// Width and height of the image.
        found: [usize; 2],
        /// Width and height of the scene's camera.
        expected: [usize; 2],
    },
    /// Something of real time is missing.
    Lacks(String),
    /// The scene's occlusions are not where the view is hidden.
    Mask(Warning),
}

/// Publishes features until it is asked to stop, or there are no more images.
///
/// # Errors
/// [`RunError`].
pub fn run(
    config: &Config,
    start_up: StartUp,
    stop: &AtomicBool,
    events: &Sender<Event>,
) -> Result<(), RunError> {
    let tell = |event| {
        // Nobody listens once the program ends.
        let _ = events.send(event);
    };
    let domain = Domain::join(&config.domain)?;
    let mut features: Publisher<Features> = domain.publisher()?;
    let mut source = open(config, &domain)?;
    drop(start_up);
    let mut finder = Finder::new(&config.scene, &config.lens, config.family, &config.targets)?;
    let mut mask = MaskCheck::new(&config.scene, Settings::default());
    // The detector's library divides its work among the threads of the pool that it is called from:
    // this one alone, as the controller and the camera want the others.
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(1)
        .use_current_thread()
        .build();
    if let Err(why) = &pool {
        tell(Event::Lacks(format!(
            "a thread of its own for the detector: {why}"
        )));
    }
    if config.realtime_priority > 0
        && let Err(why) = program::take_fifo(config.realtime_priority)
    {
        let wanted = config.realtime_priority;
        tell(Event::Lacks(format!("SCHED_FIFO {wanted}: {why}")));
    }
    let expected = [
        config.scene.camera.width as usize,
        config.scene.camera.height as usize,
    ];
    let mut last = None;
    while !stop.load(Ordering::Relaxed) {
        let frame = match source.next(stop)? {
            Next::End => break,
            Next::Nothing => {
                // A controller that came meanwhile finds the last features.
                features.refresh()?;
                continue;
            }
            Next::Frame(frame) => frame,
        };
        let begin = Instant::now();
        let found = [frame.image.width(), frame.image.height()];
        if found != expected {
            tell(Event::Size { found, expected });
            continue;
        }
        let found = finder.find(&frame.image, frame.sequence)?;
        let message = stamped(config, &frame, &found);
        features.publish_verbatim(&message)?;
        let is_real = config.clock == Clock::Fixed && message.stamp.data_ns > 0;
        let age = message
            .stamp
            .published_ns
            .saturating_sub(message.stamp.data_ns);
        let took = begin.elapsed();
        // After the features are under way.
        let [seen, hidden] = finder.places();
        if let Some(warning) = mask.frame(ipc::now_ns(), &seen, &hidden) {
            tell(Event::Mask(warning));
        }
        let step = last.and_then(|last| frame.sequence.checked_sub(last));
        last = Some(frame.sequence);
        tell(Event::Frame(Report {
            sequence: frame.sequence,
            lost: step.map_or(0, |step| step.saturating_sub(1)),
            data_ns: message.stamp.data_ns,
            found,
            mask: mask.counts(),
            took,
            age: Duration::from_nanos(if is_real { age } else { 0 }),
        }));
    }
    Ok(())
}

/// Opens the source of a configuration.
///
/// # Errors
/// [`SourceError`]: it is not there, or not what is asked for.
pub fn open(config: &Config, domain: &Domain) -> Result<Box<dyn Source>, SourceError> {
    let pause = match config.clock {
        Clock::Fixed => PAUSE,
        Clock::Lockstep => LOCKSTEP_PAUSE,
    };
    Ok(match &config.source {
        SourceKind::Shm => Box::new(SharedMemory::open(domain, pause)?),
        SourceKind::V4l2(device) => {
            let camera = &config.scene.camera;
            let (exposure_ns, shutter, readout_ns) = config.exposure;
            let request = Request {
                size: [camera.width as u32, camera.height as u32],
                rate_hz: camera.rate_hz,
                exposure_ns,
                shutter,
                readout_ns,
            };
            Box::new(Camera::open(device, &request)?)
        }
        SourceKind::Files(path) => Box::new(Replay::open(path, Some(config.scene.camera.rate_hz))?),
    })
}

fn stamped(config: &Config, frame: &Frame, found: &Found) -> Features {
    // 0 means that nobody knows it.
    let data_ns = match frame.data_ns {
        0 => 0,
        data_ns => data_ns.saturating_add_signed(config.stamp_offset_ns),
    };
    let mut features = Features::new(&found.points, data_ns);
    features.visible = found.visible;
    features.exposure_ns = frame.exposure_ns;
    features.stamp.sequence = frame.sequence;
    features.stamp.published_ns = match config.clock {
        Clock::Fixed => ipc::now_ns(),
        Clock::Lockstep => frame.published_ns.unwrap_or_else(ipc::now_ns),
    };
    features
}
