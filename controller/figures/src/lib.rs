//! Figures like the paper's, as SVG and PNG with the same content: each type's `canvas` draws it,
//! [`Canvas::write`] writes both files. Points are pixels, those of a [`Reach`] metres; nothing is
//! projected here. Decisions: `README.md`.
#![forbid(unsafe_code)]

mod animation;
mod canvas;
mod comparison;
mod frame;
mod image_plane;
mod joints;
mod latency;
mod output;
mod photo;
mod preview;
mod reach;
mod samples;
mod velocity;
mod view;

pub use animation::Animation;
pub use canvas::Canvas;
pub use comparison::{Comparison, side_by_side};
pub use image_plane::ImagePlane;
pub use joints::Joints;
pub use latency::{Latency, Times};
pub use output::FigureError;
pub use photo::Photo;
pub use preview::{Offender, Preview, Seen};
pub use reach::Reach;
pub use samples::Samples;
pub use velocity::Velocity;
pub use view::View;

/// Image points of one moment, px.
pub type Points = Vec<[f64; 2]>;
