//! The signed distance of an image point from a border.

/// The signed clearance of a point from the border of a constraint, and its direction of increase.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Clearance {
    /// Distance to the border, px; negative inside. Of a part to the first order: exact on the
    /// border, and everywhere where it is straight.
    pub distance: f64,
    /// Direction in the image, away from the occlusion: the unit normal of a part or an image side;
    /// the gradient of the distance from an area, which is shorter where no border is the nearest.
    pub normal: [f64; 2],
}

impl Clearance {
    /// How the clearance changes with variables by which the pixel (u, v) changes.
    pub fn along<const N: usize>(&self, [u, v]: &[[f64; N]; 2]) -> [f64; N] {
        let [a, b] = self.normal;
        let mut gradient = *u;
        for (gradient, v) in gradient.iter_mut().zip(v) {
            *gradient = a * *gradient + b * v;
        }
        gradient
    }
}

/// A point with its marker.
#[derive(Clone, Copy, Debug)]
pub struct Place {
    /// Where it is, px.
    pub pixel: [f64; 2],
    /// The radius of its marker ([`Task::radius`](crate::Task::radius)), px.
    pub radius: f64,
}
