//! Images and poses that come now.

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use clap::CommandFactory;
use ipc::{Domain, ReceiveError};
use messages::RobotState;
use toml_schema::FileError;
use vpc_camera::config::{self, Config};
use vpc_camera::grey::Grey;
use vpc_camera::run;
use vpc_camera::source::{Next, SharedMemory, Source, SourceError};

use crate::arguments::StreamArguments;
use crate::trajectory::Sample;

/// Between two looks for an image.
const PAUSE: Duration = Duration::from_micros(200);
/// Longest time without an image.
const PATIENCE: Duration = Duration::from_secs(10);
/// States of the robot that wait: those of 64 ms.
const STATES: usize = 64;

/// Nothing comes, or the images cannot be had.
#[derive(Debug, thiserror::Error)]
pub enum LiveError {
    /// The domain.
    #[error(transparent)]
    Join(#[from] ipc::JoinError),
    /// A service.
    #[error(transparent)]
    Open(#[from] ipc::OpenError),
    /// A service.
    #[error(transparent)]
    Receive(#[from] ReceiveError),
    /// The camera.
    #[error(transparent)]
    Source(#[from] SourceError),
    /// The configuration of vpc-camera.
    #[error(transparent)]
    Config(#[from] FileError),
    /// The name of that file.
    #[error(transparent)]
    Flags(#[from] clap::Error),
    /// No camera.
    #[error("no image for {} s; does a camera publish on vpc/image of this domain? For a camera of this machine set source = \"v4l2:/dev/video0\" in vpc-camera.toml", PATIENCE.as_secs())]
    Silent,
}

/// What comes.
pub enum News<'a> {
    /// Measured joints.
    Robot(Sample),
    /// An image.
    #[allow(missing_docs)]
    Image {
        image: Grey<'a>,
        /// The middle of its exposure by its stamp, s; `None` if nobody knows it.
        time: Option<f64>,
    },
}

/// Hands images and joints to `take` until that returns `false`, the images are over, or `stop` is
/// set.
///
/// # Errors
/// [`LiveError`].
pub fn watch(
    arguments: &StreamArguments,
    stop: &AtomicBool,
    mut take: impl FnMut(News) -> bool,
) -> Result<(), LiveError> {
    let (domain, mut source) = open(arguments)?;
    let mut robot = domain.subscriber::<RobotState>(STATES)?;
    let mut heard = Instant::now();
    while !stop.load(Ordering::Relaxed) {
        for _ in 0..STATES {
            let state = match robot.oldest() {
                Err(ReceiveError::Invalid { .. }) => continue,
                state => state?,
            };
            let Some(state) = state else { break };
            if sample(&state).is_some_and(|sample| !take(News::Robot(sample))) {
                return Ok(());
            }
        }
        let frame = match source.next(stop)? {
            Next::Frame(frame) => frame,
            Next::Nothing if heard.elapsed() > PATIENCE => return Err(LiveError::Silent),
            Next::Nothing => continue,
            Next::End => break,
        };
        heard = Instant::now();
        let (image, known) = (frame.image, frame.data_ns > 0);
        let time = known.then_some(seconds(frame.data_ns));
        if !take(News::Image { image, time }) {
            break;
        }
    }
    Ok(())
}

/// The domain, and what gives images.
fn open(arguments: &StreamArguments) -> Result<(Domain, Box<dyn Source>), LiveError> {
    let StreamArguments { domain, config } = arguments;
    let Some(config) = config else {
        let directory = domain.clone().unwrap_or_else(ipc::default_directory);
        let domain = Domain::join(&directory)?;
        let source = SharedMemory::open(&domain, PAUSE)?;
        return Ok((domain, Box::new(source)));
    };
    let mut words = vec!["vpc-camera".into(), "--config".into(), config.into()];
    if let Some(domain) = domain {
        words.extend(["--domain".into(), domain.into()] as [std::ffi::OsString; 2]);
    }
    let config = Config::load(&config::Arguments::command().try_get_matches_from(words)?)?;
    let domain = Domain::join(&config.domain)?;
    let source = run::open(&config, &domain)?;
    Ok((domain, source))
}

/// The joints of an arm; `None` for a robot without, or of another kind.
fn sample(state: &RobotState) -> Option<Sample> {
    (state.joints as usize == state.q.len()).then(|| Sample {
        time: seconds(state.stamp.data_ns),
        q: state.q,
        dq: state.dq,
    })
}

fn seconds(ns: u64) -> f64 {
    ns as f64 * 1e-9
}
