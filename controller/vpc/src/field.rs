//! The clearance from an area of a mask: a quadratic B-spline over the nodes of its field.
//!
//! Three by three nodes contribute at each point, so that the clearance and its gradient are
//! continuous and linear functions are reproduced exactly. The scene's coefficients keep the spline
//! below the signed Euclidean distance near the border, so that no further margin is needed.
#![expect(
    clippy::indexing_slicing,
    reason = "a dense kernel: the weights keep the three nodes of a side inside the grid"
)]

use scene::{Area, Field};

use crate::clearance::Clearance;

/// The clearance of pixel (u, v) from an area. Beyond the grid it goes on along its gradient at the
/// grid's edge.
pub fn clearance(area: &Area, pixel: [f64; 2]) -> Clearance {
    let field = &area.field;
    let size = [field.columns, field.rows];
    let [(i, u), (j, v)] = core::array::from_fn(|k| Weights::at(field, size[k], pixel[k]));
    let (mut distance, mut gradient) = (0.0, [0.0; 2]);
    for q in 0..3 {
        let row = (j + q) * size[0] + i;
        let nodes: [f64; 3] = core::array::from_fn(|p| f64::from(field.values[row + p]));
        let along: f64 = dot(&nodes, &u.value);
        distance += v.value[q] * along;
        gradient[0] += v.value[q] * dot(&nodes, &u.slope);
        gradient[1] += v.slope[q] * along;
    }
    Clearance {
        distance: distance + gradient[0] * u.beyond + gradient[1] * v.beyond,
        normal: gradient,
    }
}

fn dot(a: &[f64; 3], b: &[f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// The weights of the three nodes about a coordinate.
struct Weights {
    value: [f64; 3],
    /// Derivatives of the weights, 1/px.
    slope: [f64; 3],
    /// How far the coordinate lies beyond the grid, px.
    beyond: f64,
}

impl Weights {
    /// For coordinate `x` (px) among `count` nodes; with the index of the first of the three.
    fn at(field: &Field, count: usize, x: f64) -> (usize, Self) {
        let step = field.step;
        let asked = (x - field.origin) / step;
        // Not a number becomes 1: the gate lets none through.
        let place = asked.max(1.0).min((count - 2) as f64);
        let middle = libm::floor(place + 0.5);
        let t = place - middle;
        let (before, after) = (0.5 - t, 0.5 + t);
        let value = [0.5 * before * before, 0.75 - t * t, 0.5 * after * after];
        let slope = [-before / step, -2.0 * t / step, after / step];
        let beyond = (asked - place) * step;
        (
            middle as usize - 1,
            Self {
                value,
                slope,
                beyond,
            },
        )
    }
}
