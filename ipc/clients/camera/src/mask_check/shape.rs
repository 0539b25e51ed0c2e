//! An occlusion by its distances.

use scene::{Occlusion, Part};

use crate::distance;

/// An occlusion with the distance of each pixel's centre from its border, px, negative inside.
pub struct Shape {
    /// Its name in the scene.
    pub name: String,
    distances: Vec<f32>,
}

impl Shape {
    /// An occlusion in an image of this size.
    pub fn of(occlusion: &Occlusion, width: usize, height: usize) -> Self {
        let covers = |k: usize| {
            let (column, row) = (k % width, k / width);
            let of_part = |part: &Part| {
                let term = |k: usize, x: usize| {
                    ((x as f64 - part.center[k]).abs() / part.half[k]).powf(part.p)
                };
                term(0, column) + term(1, row) < 1.0
            };
            occlusion.parts.iter().any(of_part)
                || occlusion
                    .mask
                    .is_some_and(|mask| mask.is_forbidden(column, row))
        };
        let inside: Vec<bool> = (0..width * height).map(covers).collect();
        let outside: Vec<bool> = inside.iter().map(|is| !is).collect();
        let to_inside = distance::to_set(&inside, width);
        let to_outside = distance::to_set(&outside, width);
        // A border runs half a pixel from the centres on both of its sides.
        let signed = |(to_inside, to_outside): (&f32, &f32)| match *to_inside > 0.0 {
            true => to_inside - 0.5,
            false => 0.5 - to_outside,
        };
        Self {
            name: occlusion.name.as_str().to_owned(),
            distances: to_inside.iter().zip(&to_outside).map(signed).collect(),
        }
    }

    /// The distance of a point in the image, px, to a pixel.
    pub fn distance(&self, point: [f64; 2], [width, height]: [usize; 2]) -> f64 {
        // The casts saturate, also where the point is not a number.
        let [column, row] = point.map(|x| x.round() as usize);
        let pixel = row.min(height - 1) * width + column.min(width - 1);
        f64::from(self.distances[pixel])
    }
}
