//! Rendered frames: drawn and searched for markers by a thread, beside the robot's millisecond.

use std::sync::mpsc::{self, TryRecvError};
use std::thread;

use scene::{Pose, Scene};
use vision::{Detector, DetectorSettings, Look, Renderer, SizeError};

use crate::camera::Points;

/// Why a camera cannot be, or cannot go on.
#[derive(Debug, thiserror::Error)]
pub enum EyeError {
    /// The detector.
    #[error(transparent)]
    Detector(#[from] SizeError),
    /// No thread for the picture.
    #[error("no thread for the camera's picture: {0}")]
    Thread(std::io::Error),
    /// The thread of the picture ended.
    #[error("the thread of the camera's picture ended")]
    Ended,
}

/// A frame to be drawn.
pub(crate) struct Exposure {
    /// The object in the camera frame while the first and the last row are exposed.
    pub rows: [Pose; 2],
    /// Whether each occlusion of the scene is there.
    pub shown: Vec<bool>,
}

/// Markers, px, and a bit for each that was measured.
pub(crate) type Seen = (Points, u32);

/// Draws frames in the order in which they were exposed. The thread ends with it.
#[derive(Debug)]
pub(crate) struct FrameRenderer {
    exposures: mpsc::Sender<Exposure>,
    seen: mpsc::Receiver<Result<Seen, EyeError>>,
}

impl FrameRenderer {
    /// Draws the scene as it is, `real`; its detector knows the scene as it is `believed`, and
    /// where the object is at the start.
    pub fn new(real: &Scene, believed: &Scene, start: &Pose, seed: u64) -> Result<Self, EyeError> {
        let look = Look {
            seed,
            ..Look::default()
        };
        let mut renderer = Renderer::new(real, &look);
        let mut detector = Detector::new(believed, &DetectorSettings::default());
        detector.expect(start);
        let (exposures, to_do) = mpsc::channel::<Exposure>();
        let (done, seen) = mpsc::channel();
        let work = move || {
            while let Ok(exposure) = to_do.recv() {
                if done
                    .send(see(&mut renderer, &mut detector, &exposure))
                    .is_err()
                {
                    break;
                }
            }
        };
        let thread = thread::Builder::new().name("picture".into());
        thread.spawn(work).map_err(EyeError::Thread)?;
        Ok(Self { exposures, seen })
    }

    pub fn expose(&self, exposure: Exposure) -> Result<(), EyeError> {
        self.exposures.send(exposure).map_err(|_| EyeError::Ended)
    }

    /// What the next frame shows; waits for it, or gives `None` where it is not ready.
    pub fn next(&self, waits: bool) -> Result<Option<Seen>, EyeError> {
        let seen = if waits {
            self.seen.recv().map_err(|_| TryRecvError::Disconnected)
        } else {
            self.seen.try_recv()
        };
        match seen {
            Ok(seen) => seen.map(Some),
            Err(TryRecvError::Empty) => Ok(None),
            Err(TryRecvError::Disconnected) => Err(EyeError::Ended),
        }
    }
}

fn see(
    renderer: &mut Renderer,
    detector: &mut Detector,
    exposure: &Exposure,
) -> Result<Seen, EyeError> {
    for (occlusion, &shown) in exposure.shown.iter().enumerate() {
        renderer.show(occlusion, shown);
    }
    let [first, last] = &exposure.rows;
    let sightings = detector.detect(renderer.render_rolling(first, last))?;
    let points = sightings.iter().map(|marker| marker.pixel).collect();
    Ok((points, detector.visible()))
}
