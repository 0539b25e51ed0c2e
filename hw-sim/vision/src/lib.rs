//! Renders the emulated camera's picture.
//!
//! * [`Renderer`]: pose of the object in the camera frame -> grey [`Image`] with AprilTags, the
//!   grasped object in front of them, the blurred spot on the lens and pixel noise.
//! * [`Transit`]: frames exposed -> frames delivered, late, with jitter, and some never.
//!
//! Image coordinates: u to the right, v down, px; the centre of the upper left pixel is (0, 0).
//! The crate's `README.md` explains the decisions that surprise.
//!
//! ```
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! use vision::{Look, Renderer};
//!
//! let scene = scene::Scene::parse(scene::TAGS_ROBOT, "tags-robot.toml")?;
//! let mut renderer = Renderer::new(&scene, &Look::default());
//! let image = renderer.render(&scene.goal);
//! assert_eq!((image.width(), image.height()), (640, 480));
//! # Ok(())
//! # }
//! ```
#![forbid(unsafe_code)]

mod brightness;
mod defocus;
mod gloss;
mod homography;
mod image;
mod latency;
mod layer;
mod lens;
mod look;
mod object;
mod optics;
mod painted;
mod plane;
mod processor;
mod renderer;
mod sensor;
mod sheet;
mod spot;
mod tag;
mod texture;
mod truth;

pub use image::Image;
pub use latency::{Delivered, Latency, Transit};
pub use lens::Lens;
pub use look::{Look, SpotLook};
pub use renderer::Renderer;
pub use tag::Tag;
pub use truth::{Truth, truth};
