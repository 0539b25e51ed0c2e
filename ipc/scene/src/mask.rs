//! Occlusions painted as pixels. Units: px; u to the right, v down.

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
pub(crate) mod picture;

/// Most areas of all masks of a scene.
pub const MAX_AREAS: usize = 32;

/// An occlusion painted as an image of the camera's size.
///
/// Pixel (i, j) is the square of side 1 about (i, j): where OpenCV and ViSP see its centre.
/// Pixels and fields live as long as the process: a scene is read once, and who holds them needs no heap.
#[derive(Clone, Copy, PartialEq)]
pub struct Mask {
    pub(crate) width: usize,
    pub(crate) height: usize,
    /// Row by row from the top left; 1 forbidden, 0 free.
    pub(crate) pixels: &'static [u8],
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

    /// Whether no feature may be in the pixel of this column and row; never outside the image.
    pub fn is_forbidden(&self, column: usize, row: usize) -> bool {
        column < self.width && row < self.height && self.pixels[row * self.width + column] != 0
    }

    /// The forbidden pixels as rectangles (columns from, to; rows from, to; the latter not included) that do not overlap:
    /// the runs of a row, as high as the rows below have the same ones.
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

    /// The areas that together cover the forbidden pixels.
    pub const fn areas(&self) -> &'static [Area] {
        self.areas
    }
}

impl fmt::Debug for Mask {
    /// Its size and the number of its areas: the pixels would hide everything else.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (width, height, areas) = (self.width, self.height, self.areas.len());
        write!(f, "Mask({width}x{height}, {areas} areas)")
    }
}

/// One area of a mask: connected forbidden pixels without a sharp corner inwards. Areas may overlap, as the arms of an L
/// do in its corner.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Area {
    low: [f64; 2],
    high: [f64; 2],
    field: Field,
}

impl Area {
    /// The top left corner of a box that holds every point of negative clearance, px.
    pub const fn low(&self) -> [f64; 2] {
        self.low
    }

    /// Its bottom right corner, px.
    pub const fn high(&self) -> [f64; 2] {
        self.high
    }

    /// The clearance from the area on a grid.
    pub const fn field(&self) -> &Field {
        &self.field
    }
}

/// Clearances from an area at the nodes of a square grid: coefficients of a quadratic B-spline.
///
/// The spline follows the signed Euclidean distance from the area's border (px, negative inside) and is never above
/// it where that matters, near the border: see the README of this crate.
#[derive(Clone, Copy, PartialEq)]
pub struct Field {
    origin: f64,
    step: f64,
    columns: usize,
    rows: usize,
    /// Row by row from the top left.
    values: &'static [f32],
}

impl Field {
    /// Both coordinates of the first node, px.
    pub const fn origin(&self) -> f64 {
        self.origin
    }

    /// Distance between neighbouring nodes, px.
    pub const fn step(&self) -> f64 {
        self.step
    }

    /// Nodes along u, at least 3.
    pub const fn columns(&self) -> usize {
        self.columns
    }

    /// Nodes along v, at least 3.
    pub const fn rows(&self) -> usize {
        self.rows
    }

    /// The coefficients, row by row from the top left: columns x rows of them.
    pub const fn values(&self) -> &'static [f32] {
        self.values
    }
}

impl fmt::Debug for Field {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (columns, rows, step) = (self.columns, self.rows, self.step);
        write!(f, "Field({columns}x{rows}, every {step} px)")
    }
}
