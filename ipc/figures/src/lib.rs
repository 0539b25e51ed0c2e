//! Figures like the paper's, as SVG and PNG with the same content.
//!
//! The pictures are an image plane with equal axes and v downwards, translucent p-norm shapes, and markers; no
//! charting library that was tried draws those, so this crate writes the SVG itself ([`Canvas`], one small module) and
//! `resvg` with the DejaVu font (bundled by the crate `dejavu`, so that every machine draws the same bytes) makes the
//! PNG. There is no projection here: goals come in as pixels. Decisions stand in the crate's
//! `README.md`.
#![forbid(unsafe_code)]

mod animation;
mod canvas;
mod comparison;
mod image_plane;
mod joints;
mod latency;
mod output;
mod preview;
mod samples;
mod velocity;

pub use animation::Animation;
pub use canvas::Canvas;
pub use comparison::{Comparison, side_by_side};
pub use image_plane::ImagePlane;
pub use joints::Joints;
pub use latency::{Latency, Times};
pub use output::FigureError;
pub use preview::Preview;
pub use samples::Samples;
pub use velocity::Velocity;

/// Image points of one moment, px.
pub type Points = Vec<[f64; 2]>;
