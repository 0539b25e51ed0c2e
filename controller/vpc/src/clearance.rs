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
