//! An occlusion by its distances.

use scene::Occlusion;

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
        let inside: Vec<bool> = (0..width * height)
            .map(|k| occlusion.covers_pixel(k % width, k / width))
            .collect();
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
