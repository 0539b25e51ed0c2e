//! The lens: where a real camera sees what the scene's pinhole camera would see elsewhere.
//!
//! Two cameras are told apart: the real one, whose calibration says how it distorts, and the pinhole
//! of the scene's `[camera]`, which the controller knows. Tags are found in pixels of the real one;
//! features are in pixels of the scene's.

mod distortion;
mod file;

use scene::Camera;
use toml_schema::FileError;

pub use distortion::Distortion;
pub use file::read;

/// The calibration of a real camera.
#[derive(Clone, Debug, PartialEq)]
pub struct Lens {
    /// Focal lengths along u and v, px.
    pub focal: [f64; 2],
    /// Principal point, px.
    pub centre: [f64; 2],
    /// Width and height of the images that it was calibrated with, px.
    pub size: [u32; 2],
    /// How it distorts.
    pub distortion: Distortion,
    /// The file, for messages.
    pub file: String,
}

impl Lens {
    /// The lens of a camera that is the scene's: without distortion.
    pub fn pinhole(camera: &Camera) -> Self {
        Self {
            focal: [camera.fx, camera.fy],
            centre: [camera.cx, camera.cy],
            // Whole numbers, as scenes are checked.
            size: [camera.width, camera.height].map(|side| side as u32),
            distortion: Distortion::perspective([0.0; 8]),
            file: "[camera] of the scene".to_owned(),
        }
    }

    /// The point on the plane at z = 1 that is seen at a pixel of the real camera; `None` if the
    /// model has no inverse there.
    pub fn normalize(&self, [u, v]: [f64; 2]) -> Option<[f64; 2]> {
        let ([fx, fy], [cx, cy]) = (self.focal, self.centre);
        self.distortion.unbend([(u - cx) / fx, (v - cy) / fy])
    }

    /// The pixel of the real camera that sees a point on the plane at z = 1; `None` if the model
    /// does not reach as far. The pixel may be outside of the image.
    pub fn project(&self, point: [f64; 2]) -> Option<[f64; 2]> {
        let ([fx, fy], [cx, cy]) = (self.focal, self.centre);
        let [x, y] = self.distortion.bend(point)?;
        Some([fx * x + cx, fy * y + cy])
    }

    /// The pixel of the scene's camera that sees what the real one sees at `pixel`; `None` if the
    /// model has no inverse there.
    pub fn undistort(&self, pixel: [f64; 2], scene: &Camera) -> Option<[f64; 2]> {
        let [x, y] = self.normalize(pixel)?;
        Some([scene.fx * x + scene.cx, scene.fy * y + scene.cy])
    }

    /// The pixel of the real camera that sees what the scene's one sees at `pixel`; `None` if the
    /// model does not reach as far.
    pub fn distort(&self, [u, v]: [f64; 2], scene: &Camera) -> Option<[f64; 2]> {
        self.project([(u - scene.cx) / scene.fx, (v - scene.cy) / scene.fy])
    }

    /// Checks that images have the size that the calibration is for.
    ///
    /// # Errors
    /// [`FileError::Value`] names both sizes.
    pub fn check_size(&self, size: [u32; 2]) -> Result<(), FileError> {
        if size == self.size {
            return Ok(());
        }
        let [width, height] = self.size;
        let allowed = format!(
            "the images' size, {}x{} px; calibrate at this size, or take images of that one",
            size[0], size[1]
        );
        let found = format!("{width}x{height} px");
        Err(FileError::value(&self.file, "image size", found, allowed))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lens() -> Lens {
        Lens {
            focal: [600.0, 610.0],
            centre: [330.0, 235.0],
            size: [640, 480],
            distortion: Distortion::perspective([-0.3, 0.1, 1e-3, 0.0, 0.0, 0.0, 0.0, 0.0]),
            file: "cal.toml".to_owned(),
        }
    }

    #[test]
    fn a_pixel_of_the_lens_is_carried_to_the_camera_of_the_scene() {
        let scene = Camera {
            width: 640.0,
            height: 480.0,
            fx: 800.0,
            fy: 800.0,
            cx: 320.0,
            cy: 240.0,
            rate_hz: 30.0,
        };
        // The axis of the lens is the axis of the scene's camera.
        let axis = lens().undistort([330.0, 235.0], &scene);
        assert_eq!(axis, Some([320.0, 240.0]));
        // Near the axis, there is no distortion, and the focal lengths are those of the scene.
        let near = lens().undistort([336.0, 235.0], &scene).unwrap();
        assert!((near[0] - 328.0).abs() < 0.01 && (near[1] - 240.0).abs() < 0.01);
        for pixel in [[0.0, 0.0], [639.0, 479.0], [320.0, 10.0]] {
            let there = lens().undistort(pixel, &scene).unwrap();
            let back = lens().distort(there, &scene).unwrap();
            assert!((back[0] - pixel[0]).hypot(back[1] - pixel[1]) < 1e-6);
            let same = Lens::pinhole(&scene).undistort(pixel, &scene).unwrap();
            assert!((same[0] - pixel[0]).hypot(same[1] - pixel[1]) < 1e-9);
        }
    }

    #[test]
    fn images_of_another_size_are_refused() {
        assert!(lens().check_size([640, 480]).is_ok());
        let error = lens().check_size([1280, 720]).unwrap_err().to_string();
        assert_eq!(
            error,
            "cal.toml: image size = 640x480 px; allowed: the images' size, 1280x720 px; calibrate at this size, or take images of that one"
        );
    }
}
