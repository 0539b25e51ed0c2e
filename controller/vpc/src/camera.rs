//! The pinhole camera: between pixels and the normalised image plane.

use scene::Camera;

/// Normalised image coordinates (x, y) of a pixel (u, v).
pub fn normalise(camera: &Camera, [u, v]: [f64; 2]) -> [f64; 2] {
    [(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy]
}

/// The pixel (u, v) of normalised image coordinates (x, y).
pub fn pixel(camera: &Camera, [x, y]: [f64; 2]) -> [f64; 2] {
    [camera.fx * x + camera.cx, camera.fy * y + camera.cy]
}

/// The pixel of a point in the camera frame (m), or `None` if it is not in front of the camera.
pub fn project(camera: &Camera, [x, y, z]: [f64; 3]) -> Option<[f64; 2]> {
    (z > 1e-6).then(|| pixel(camera, [x / z, y / z]))
}
