//! Rendered frames: drawn by a thread, beside the robot's millisecond.

use std::sync::mpsc::{self, TryRecvError};
use std::thread;

use markers::Family;
use scene::{Pose, Scene};
use vision::{Image, Look, Renderer};

use crate::robot::truth::Truth;

/// Why a camera cannot be, or cannot go on.
#[derive(Debug, thiserror::Error)]
pub enum EyeError {
    /// Points have nothing to draw.
    #[error("the scene's markers have no size to be drawn with: it gives no pattern.marker_size")]
    NoSize,
    /// No thread for the picture.
    #[error("no thread for the camera's picture: {0}")]
    Thread(std::io::Error),
    /// The thread of the picture ended.
    #[error("the thread of the camera's picture ended")]
    Ended,
}

/// A frame to be drawn.
pub(crate) struct Exposure {
    /// The object in the camera frame in the middle of the exposure of the first row and of the last
    /// one.
    pub rows: [Pose; 2],
    /// ... at the begin and at the end of a row's exposure, as far as it blurs.
    pub blur: [Pose; 2],
    /// Whether each occlusion of the scene is there.
    pub shown: Vec<bool>,
}

/// Draws frames in the order in which they were exposed. The thread ends with it.
#[derive(Debug)]
pub(crate) struct FrameRenderer {
    exposures: mpsc::Sender<Exposure>,
    images: mpsc::Receiver<Image>,
}

impl FrameRenderer {
    /// Draws the scene as it is, with a tag at each point of its pattern.
    pub fn new(real: &Scene, truth: &Truth, family: Family, seed: u64) -> Result<Self, EyeError> {
        if real.marker_size <= 0.0 {
            return Err(EyeError::NoSize);
        }
        let look = Look {
            family,
            distortion: truth.distortion,
            defocus_px: truth.defocus_px,
            gain: truth.gain,
            gloss: truth.gloss,
            demosaic: truth.demosaic,
            sharpening: truth.sharpening,
            clutter: truth.clutter as usize,
            seed,
            ..Look::default()
        };
        let mut renderer = Renderer::new(real, &look);
        let (exposures, to_do) = mpsc::channel::<Exposure>();
        let (done, images) = mpsc::channel();
        let work = move || {
            while let Ok(exposure) = to_do.recv() {
                if done.send(draw(&mut renderer, &exposure)).is_err() {
                    break;
                }
            }
        };
        let thread = thread::Builder::new().name("picture".into());
        thread.spawn(work).map_err(EyeError::Thread)?;
        Ok(Self { exposures, images })
    }

    pub fn expose(&self, exposure: Exposure) -> Result<(), EyeError> {
        self.exposures.send(exposure).map_err(|_| EyeError::Ended)
    }

    /// The next frame; waits for it, or gives `None` where it is not ready.
    pub fn next(&self, waits: bool) -> Result<Option<Image>, EyeError> {
        if waits {
            return self.images.recv().map(Some).map_err(|_| EyeError::Ended);
        }
        match self.images.try_recv() {
            Ok(image) => Ok(Some(image)),
            Err(TryRecvError::Empty) => Ok(None),
            Err(TryRecvError::Disconnected) => Err(EyeError::Ended),
        }
    }
}

fn draw(renderer: &mut Renderer, exposure: &Exposure) -> Image {
    for (occlusion, &shown) in exposure.shown.iter().enumerate() {
        renderer.show(occlusion, shown);
    }
    renderer
        .render_moving(&exposure.rows, &exposure.blur)
        .clone()
}
