//! Renders the emulated camera's picture, and finds the markers in it.
//!
//! * [`Renderer`]: pose of the object in the camera frame -> grey [`Image`] with AprilTags
//!   ([`Renderer::with_tags`]) or round markers, the
//!   grasped object in front of them, the blurred spot on the lens and pixel noise.
//! * [`Detector`]: image -> one [`Sighting`] a marker: visible or not, and where, px.
//! * [`Transit`]: frames exposed -> frames delivered, late, with jitter, and some never.
//!
//! Image coordinates: u to the right, v down, px; the centre of the upper left pixel is (0, 0).
//! The crate's `README.md` explains how the three fit together, and the decisions that surprise.
//!
//! ```
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! use vision::{Detector, DetectorSettings, Look, Renderer};
//!
//! let scene = scene::Scene::parse(scene::PAPER_ROBOT, "paper-robot.toml")?;
//! let mut renderer = Renderer::new(&scene, &Look::default());
//! let mut detector = Detector::new(&scene, &DetectorSettings::default());
//! let image = renderer.render(&scene.goal);
//! let sightings = detector.detect(image)?;
//! assert!(sightings.iter().all(|marker| marker.visible));
//! # Ok(())
//! # }
//! ```
#![forbid(unsafe_code)]

mod assignment;
mod chart;
mod criteria;
mod detector;
mod disc;
mod homography;
mod image;
mod latency;
mod layer;
mod look;
mod object;
mod optics;
mod painted;
mod plane;
mod renderer;
mod search;
mod sensor;
mod spot;
mod tag;
mod texture;
mod truth;

pub use criteria::{DetectorSettings, SizeError};
pub use detector::{Detector, Sighting, Sightings};
pub use image::Image;
pub use latency::{Delivered, Latency, Transit};
pub use look::{Look, SpotLook};
pub use renderer::Renderer;
pub use tag::Tag;
pub use truth::{Truth, truth};
