//! Images to learn from: a recording, or `vpc/image`.

use std::path::Path;
use std::sync::atomic::AtomicBool;
use std::time::{Duration, Instant};

use anyhow::{Context, bail};
use ipc::Domain;

use super::error::LearnError;
use super::frames::Frames;
use crate::source::{Next, Replay, SharedMemory, Source};

/// How long an image is waited for.
const PATIENCE: Duration = Duration::from_secs(10);
/// Between two looks for an image.
const PAUSE: Duration = Duration::from_millis(2);

/// Reads a folder of images, or a video.
///
/// # Errors
/// Which file cannot be read, and why; a folder without images.
pub fn read(path: &Path) -> anyhow::Result<Frames> {
    take(&mut Replay::open(path, None)?, usize::MAX, Duration::ZERO)
}

/// Takes images from `vpc/image`, `every` s apart or more.
///
/// # Errors
/// No domain, or no image for 10 s.
pub fn receive(domain: Option<&Path>, count: usize, every: f64) -> anyhow::Result<Frames> {
    let directory = domain.map_or_else(ipc::default_directory, Path::to_owned);
    let mut source = SharedMemory::open(&Domain::join(&directory)?, PAUSE)?;
    take(&mut source, count, Duration::from_secs_f64(every))
        .with_context(|| format!("vpc/image of the domain {}", directory.display()))
}

/// Takes at most `count` images.
fn take(source: &mut dyn Source, count: usize, every: Duration) -> anyhow::Result<Frames> {
    let stop = AtomicBool::new(false);
    let (mut frames, mut taken) = (None, 0);
    let (mut seen, mut last) = (Instant::now(), None::<Instant>);
    while taken < count {
        let image = match source.next(&stop)? {
            Next::Frame(frame) => frame.image,
            Next::End => break,
            Next::Nothing if seen.elapsed() > PATIENCE => bail!(
                "no image for {} s after {taken} of {count}; allowed: a camera that sends",
                PATIENCE.as_secs()
            ),
            Next::Nothing => continue,
        };
        seen = Instant::now();
        if last.is_some_and(|last| last.elapsed() < every) {
            continue;
        }
        last = Some(seen);
        let frames = match &mut frames {
            Some(frames) => frames,
            None => frames.insert(Frames::new(image.width(), image.height())?),
        };
        frames.push(image)?;
        taken += 1;
    }
    Ok(frames.ok_or(LearnError::Few(0))?)
}
