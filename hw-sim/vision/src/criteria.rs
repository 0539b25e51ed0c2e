//! What the detector looks for, and in which images.

/// How markers look: bright discs on the plane of the pattern.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DetectorSettings {
    /// Radius of the discs on the plane of the pattern, m; above 0, at most 1.
    pub marker_radius_m: f64,
    /// Least and greatest mean radius in the image, px; 3 to 200.
    pub radius_px: [f64; 2],
}

impl Default for DetectorSettings {
    fn default() -> Self {
        Self {
            marker_radius_m: crate::Look::default().marker_radius_m,
            radius_px: [4.0, 24.0],
        }
    }
}

/// The image has another size than the scene's camera.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("image of {} x {} px; allowed: {} x {}, the scene's", found[0], found[1], expected[0], expected[1])]
pub struct SizeError {
    /// Width and height of the image, px.
    pub found: [usize; 2],
    /// Width and height in the scene, px.
    pub expected: [usize; 2],
}
