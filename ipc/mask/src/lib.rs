//! Occlusions painted as pixels: the image, and the areas and distance fields that the control law
//! works with. Units: px; u to the right, v down.
//!
//! The `README.md` of this crate explains why masks are split into areas and how exact their fields
//! are. Without the feature `file` the crate is `no_std` and never allocates.
#![cfg_attr(not(feature = "file"), no_std)]
#![forbid(unsafe_code)]

use core::fmt;

#[cfg(feature = "file")]
mod area;
#[cfg(feature = "file")]
mod cover;
#[cfg(feature = "file")]
mod distance;
#[cfg(feature = "file")]
mod patch;
#[cfg(feature = "file")]
mod picture;

#[cfg(feature = "file")]
pub use picture::{MOST_PIXELS, MaskError, write_mask};

/// Most areas of all masks of a scene.
pub const MAX_AREAS: usize = 32;

/// An occlusion painted as an image of the camera's size.
///
/// Pixel (i, j) is the square of side 1 whose centre is (i, j), as in OpenCV and ViSP. Pixels and
/// fields live as long as the process, so that a type that holds a mask needs no heap.
#[derive(Clone, Copy, PartialEq)]
pub struct Mask {
    width: usize,
    height: usize,
    pixels: &'static [u8],
    areas: &'static [Area],
}

impl Mask {
    /// Columns of pixels: the camera's width.
    pub const fn width(&self) -> usize {
        self.width
    }

    /// Rows of pixels: the camera's height.
    pub const fn height(&self) -> usize {
        self.height
    }

    /// A byte for each pixel, row by row from the top left: 1 forbidden, 0 free.
    pub const fn pixels(&self) -> &'static [u8] {
        self.pixels
    }

    /// Areas that together cover the forbidden pixels.
    pub const fn areas(&self) -> &'static [Area] {
        self.areas
    }

    /// Returns whether no feature may be in the pixel; `false` outside the image.
    pub fn is_forbidden(&self, column: usize, row: usize) -> bool {
        column < self.width && row < self.height && self.pixels[row * self.width + column] != 0
    }

    /// Returns the forbidden pixels as disjoint rectangles, each a range of columns and a range of
    /// rows.
    #[cfg(feature = "file")]
    pub fn rectangles(&self) -> Vec<[std::ops::Range<usize>; 2]> {
        let runs = |row: usize| -> Vec<std::ops::Range<usize>> {
            let mut runs: Vec<std::ops::Range<usize>> = Vec::new();
            for column in (0..self.width).filter(|column| self.is_forbidden(*column, row)) {
                match runs.last_mut() {
                    Some(run) if run.end == column => run.end += 1,
                    _ => runs.push(column..column + 1),
                }
            }
            runs
        };
        let mut rectangles = Vec::new();
        let (mut top, mut open) = (0, runs(0));
        for row in 1..=self.height {
            // No pixel is forbidden below the last row.
            let here = runs(row);
            if here != open {
                rectangles.extend(open.into_iter().map(|columns| [columns, top..row]));
                (top, open) = (row, here);
            }
        }
        rectangles
    }
}

#[cfg(feature = "file")]
impl Mask {
    /// The mask shifted by so many pixels to the right and down, and grown (negative: shrunk) by so
    /// many on every side. It has pixels only, and no areas: it is not for the control law. What
    /// leaves the image is lost.
    #[must_use]
    pub fn moved(&self, shift: [f64; 2], growth: f64) -> Self {
        let (width, height) = (self.width as i64, self.height as i64);
        let reach = growth.abs().ceil() as i64;
        let wanted = growth >= 0.0;
        let near: Vec<[i64; 2]> = (-reach..=reach)
            .flat_map(|v| (-reach..=reach).map(move |u| [u, v]))
            .filter(|[u, v]| (*u as f64).hypot(*v as f64) <= growth.abs())
            .collect();
        let is_white = |i: i64, j: i64| {
            // What is white at the edge of the image is so beyond it.
            let (i, j) = (i.clamp(0, width - 1), j.clamp(0, height - 1));
            self.is_forbidden(i as usize, j as usize)
        };
        let [right, down] = shift.map(|x| x.round() as i64);
        let pixel = |n: i64| {
            let (i, j) = (n % width - right, n / width - down);
            let found = near.iter().any(|[u, v]| is_white(i + u, j + v) == wanted);
            u8::from(found == wanted)
        };
        let pixels: Vec<u8> = (0..width * height).map(pixel).collect();
        Self {
            pixels: Box::leak(pixels.into_boxed_slice()),
            areas: &[],
            ..*self
        }
    }
}

impl fmt::Debug for Mask {
    /// Without the pixels.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (width, height, areas) = (self.width, self.height, self.areas.len());
        write!(f, "Mask({width}x{height}, {areas} areas)")
    }
}

/// One area of a mask: connected forbidden pixels without a sharp concave corner. Areas may
/// overlap, as the arms of an L do in its corner.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct Area {
    /// Top left corner of a box that contains every point of negative clearance, px.
    pub low: [f64; 2],
    /// Bottom right corner of that box, px.
    pub high: [f64; 2],
    /// The clearance from the area on a grid.
    pub field: Field,
}

/// Clearances from an area at the nodes of a square grid: coefficients of a quadratic B-spline.
///
/// The spline follows the signed Euclidean distance from the area's border (px, negative inside)
/// and does not exceed it near the border.
#[derive(Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct Field {
    /// Both coordinates of the first node, px.
    pub origin: f64,
    /// Distance between neighbouring nodes, px.
    pub step: f64,
    /// Nodes along u, at least 3.
    pub columns: usize,
    /// Nodes along v, at least 3.
    pub rows: usize,
    /// The coefficients, row by row from the top left.
    pub values: &'static [f32],
}

impl fmt::Debug for Field {
    /// Without the coefficients.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (columns, rows, step) = (self.columns, self.rows, self.step);
        write!(f, "Field({columns}x{rows}, every {step} px)")
    }
}
