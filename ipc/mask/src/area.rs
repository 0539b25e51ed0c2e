//! From the pixels of a mask to its areas and their fields.
//!
//! This needs the heap, which the control law does not have. Law and builder use the fields; the
//! emulator's referee measures from the pixels by itself, so that a mistake here shows.

use crate::cover::cover;
use crate::distance::Shape;
use crate::patch::Patch;
use crate::picture::MaskError;
use crate::{Area, Field, MAX_AREAS, Mask};

/// Both coordinates of the upper left corner of the first pixel, px: its centre is at 0. In this
/// module and its siblings coordinates count from that corner, so that pixels begin at whole
/// numbers.
const CORNER: f64 = -0.5;
/// Steps of the grid along the longer side of the image.
const STEPS: f64 = 400.0;
/// Least distance between nodes, px: closer nodes only repeat the staircase of the pixels.
const FINEST_PX: f64 = 2.0;
/// Most areas that one connected set is split into.
const MOST_PIECES: usize = 12;
/// Nodes beyond the image on each side.
const BEYOND: usize = 2;
/// The spline is held below the distance within this many steps of the border.
const BAND: f64 = 4.0;
/// Places along each side of a node's cell at which the spline is compared.
const PLACES: usize = 4;

impl Mask {
    /// A mask of `width` columns; `pixels` row by row, 1 where no feature may be, else 0.
    pub(crate) fn of(width: usize, height: usize, pixels: Vec<u8>) -> Result<Self, MaskError> {
        if !pixels.contains(&1) {
            return Err(MaskError::AllFree);
        }
        if !pixels.contains(&0) {
            return Err(MaskError::AllForbidden);
        }
        let sets = Patch::connected(width, height, &pixels);
        let count = sets.len();
        if count > MAX_AREAS {
            let smallest = sets.iter().map(Patch::count).min().unwrap_or(0);
            return Err(MaskError::Separate(count, smallest));
        }
        // Pieces share what is left when each connected set has one.
        let mut spare = MAX_AREAS - count;
        let mut areas: Vec<Area> = Vec::new();
        for set in &sets {
            let pieces = cover(set, 1 + spare.min(MOST_PIECES - 1));
            spare -= pieces.len() - 1;
            areas.extend(pieces.iter().map(area));
        }
        Ok(Self {
            width,
            height,
            pixels: Box::leak(pixels.into_boxed_slice()),
            areas: Box::leak(areas.into_boxed_slice()),
        })
    }
}

/// Computes the area of a piece: its field and bounding box.
fn area(piece: &Patch) -> Area {
    let image = piece.image().map(|side| side as f64);
    let step = (image[0].max(image[1]) / STEPS).max(FINEST_PX);
    let [columns, rows] = image.map(|side| (side / step).ceil() as usize + 2 * BEYOND + 1);
    let origin = -(BEYOND as f64) * step;
    let at = |i: f64, j: f64| [origin + i * step, origin + j * step];
    let shape = Shape::of(piece, (BEYOND as f64 * step + step).ceil() as i64 + 1);
    let exact: Vec<f64> = (0..columns * rows)
        .map(|n| shape.distance(at((n % columns) as f64, (n / columns) as f64)))
        .collect();

    // How far the spline of the distances themselves is above the distance, at most, in each node's
    // cell.
    let mut above = vec![0.0f64; exact.len()];
    for j in 1..rows - 1 {
        for i in 1..columns - 1 {
            if exact[j * columns + i].abs() > BAND * step {
                continue;
            }
            for place in 0..PLACES * PLACES {
                let offset = |k: usize| (k as f64 + 0.5) / PLACES as f64 - 0.5;
                let (x, y) = (offset(place % PLACES), offset(place / PLACES));
                let (a, b) = (weights(x), weights(y));
                let mut spline = 0.0;
                for (q, weight_v) in b.iter().enumerate() {
                    for (p, weight_u) in a.iter().enumerate() {
                        let node = (j + q - 1) * columns + i + p - 1;
                        spline += weight_u * weight_v * exact[node];
                    }
                }
                let distance = shape.distance(at(i as f64 + x, j as f64 + y));
                let cell = &mut above[j * columns + i];
                *cell = cell.max(spline - distance);
            }
        }
    }
    // Each node is lowered by the most that any cell it reaches needs, which brings the spline
    // below in all of them.
    let values: Vec<f32> = (0..exact.len())
        .map(|n| {
            let (i, j) = (n % columns, n / columns);
            let mut most: f64 = 0.0;
            for y in j.saturating_sub(1)..=(j + 1).min(rows - 1) {
                for x in i.saturating_sub(1)..=(i + 1).min(columns - 1) {
                    most = most.max(above[y * columns + x]);
                }
            }
            (exact[n] - most) as f32
        })
        .collect();
    // The spline is below the distance by less than two steps.
    let (low, high) = shape.bounds();
    Area {
        low: low.map(|x| x - 2.0 * step + CORNER),
        high: high.map(|x| x + 2.0 * step + CORNER),
        field: Field {
            origin: origin + CORNER,
            step,
            columns,
            rows,
            values: Box::leak(values.into_boxed_slice()),
        },
    }
}

/// The weights of three neighbouring nodes, `x` steps (-1/2 to 1/2) from the middle one.
fn weights(x: f64) -> [f64; 3] {
    [
        0.5 * (0.5 - x) * (0.5 - x),
        0.75 - x * x,
        0.5 * (0.5 + x) * (0.5 + x),
    ]
}
