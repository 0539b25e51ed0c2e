//! Images and poses that come now, over shared memory.

use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use ipc::{Domain, Encoding, Image, Order, ReceiveError, RobotState};

use crate::picture::Picture;
use crate::trajectory::Sample;

/// Between two looks.
const PAUSE: Duration = Duration::from_millis(2);
/// Longest time without an image.
const PATIENCE: Duration = Duration::from_secs(10);
/// States of the robot that wait: those of 64 ms.
const STATES: usize = 64;

/// Nothing comes, or the shared memory cannot be used.
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
    /// No camera.
    #[error("no image on vpc/image for {} s; does a camera publish in this domain?", PATIENCE.as_secs())]
    Silent,
}

/// What comes.
pub enum News<'a> {
    /// Measured joints.
    Robot(&'a Sample),
    /// An image, and the middle of its exposure by its stamp, s.
    Image(&'a Picture, f64),
}

/// Hands images and joints of a domain to `take` until that returns `false`, or `stop` is set.
///
/// # Errors
/// [`LiveError`]: nothing comes, or the shared memory cannot be used.
pub fn watch(
    domain: &Path,
    stop: &AtomicBool,
    mut take: impl FnMut(News) -> bool,
) -> Result<(), LiveError> {
    let domain = Domain::join(domain)?;
    let mut images = domain.image_subscriber()?;
    let mut robot = domain.subscriber::<RobotState>(STATES)?;
    let mut heard = Instant::now();
    while !stop.load(Ordering::Relaxed) {
        for _ in 0..STATES {
            let state = match robot.oldest() {
                Err(ReceiveError::Invalid { .. }) => continue,
                state => state?,
            };
            let Some(state) = state else { break };
            if let Some(sample) = sample(&state)
                && !take(News::Robot(&sample))
            {
                return Ok(());
            }
        }
        let image = match images.latest() {
            Err(ReceiveError::Invalid { .. }) => None,
            image => image?,
        };
        let image = image.filter(|image| image.order() != Order::Repeated);
        match image.and_then(|image| Some((picture(&image)?, image.header().stamp.data_ns))) {
            Some((picture, data_ns)) => {
                heard = Instant::now();
                if !take(News::Image(&picture, seconds(data_ns))) {
                    return Ok(());
                }
            }
            None if heard.elapsed() > PATIENCE => return Err(LiveError::Silent),
            None => std::thread::sleep(PAUSE),
        }
    }
    Ok(())
}

/// The joints of an arm; `None` for a robot without, or of another kind.
fn sample(state: &RobotState) -> Option<Sample> {
    (state.joints as usize == state.q.len()).then(|| Sample {
        time: seconds(state.stamp.data_ns),
        q: state.q,
        dq: state.dq,
    })
}

/// An image in grey.
fn picture(image: &Image) -> Option<Picture> {
    let header = image.header();
    let mut pixels = Vec::with_capacity(header.width as usize * header.height as usize);
    let colour = |p: &[u8], [red, green, blue]: [usize; 3]| {
        // ITU-R BT.601, as OpenCV.
        let sum = 77 * u32::from(p[red]) + 150 * u32::from(p[green]) + 29 * u32::from(p[blue]);
        ((sum + 128) >> 8) as u8
    };
    let encoding = header.encoding()?;
    for row in image.rows() {
        match encoding {
            Encoding::Mono8 => pixels.extend_from_slice(row),
            Encoding::Yuyv => pixels.extend(row.iter().step_by(2)),
            Encoding::Rgb8 => pixels.extend(row.chunks_exact(3).map(|p| colour(p, [0, 1, 2]))),
            Encoding::Bgr8 => pixels.extend(row.chunks_exact(3).map(|p| colour(p, [2, 1, 0]))),
        }
    }
    Some(Picture {
        size: [header.width, header.height],
        pixels,
    })
}

fn seconds(ns: u64) -> f64 {
    ns as f64 * 1e-9
}
