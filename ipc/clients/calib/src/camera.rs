//! The camera's model.

use vision_calibration_core::{
    BrownConrady5, CameraParams, FxFyCxCy, Iso3, PinholeCamera, Pt2, Pt3, Vec3,
    make_pinhole_camera, pinhole_camera_params,
};
use vpc_camera::lens::Lens;

/// A pinhole camera whose lens distorts as Brown and Conrady say; the centre of the first pixel is
/// (0, 0). The same model as OpenCV's with five coefficients, and ROS's `plumb_bob`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Camera {
    /// Width and height of its images, px.
    pub size: [u32; 2],
    /// Focal lengths along u and v, px.
    pub focal: [f64; 2],
    /// Principal point, px.
    pub center: [f64; 2],
    /// k1, k2, p1, p2, k3.
    pub distortion: [f64; 5],
}

impl Camera {
    /// The pinhole of a lens: for views that are straightened.
    pub fn pinhole(lens: &Lens) -> Self {
        Self {
            size: lens.size,
            focal: lens.focal,
            center: lens.centre,
            distortion: [0.0; 5],
        }
    }

    /// As the library has it.
    pub(crate) fn model(&self) -> PinholeCamera {
        let [[fx, fy], [cx, cy]] = [self.focal, self.center];
        let [k1, k2, p1, p2, k3] = self.distortion;
        // 0: as many steps as it takes.
        let iters = 0;
        let distortion = BrownConrady5 {
            k1,
            k2,
            k3,
            p1,
            p2,
            iters,
        };
        make_pinhole_camera(FxFyCxCy { fx, fy, cx, cy }, distortion)
    }

    /// The library's parameters.
    pub(crate) fn parameters(&self) -> CameraParams {
        pinhole_camera_params(&self.model())
    }

    /// The camera with these parameters of the library; `None` for another model.
    pub(crate) fn of(parameters: &CameraParams, size: [u32; 2]) -> Option<Self> {
        let k = &parameters.intrinsics;
        let values = parameters.distortion.values();
        let &[k1, k2, k3, p1, p2] = values.as_slice() else {
            return None;
        };
        Some(Self {
            size,
            focal: [k.fx, k.fy],
            center: [k.cx, k.cy],
            distortion: [k1, k2, p1, p2, k3],
        })
    }

    /// Where a point of the target is seen, px; `None` behind the camera.
    pub fn project(&self, target: &Iso3, [x, y]: [f64; 2]) -> Option<[f64; 2]> {
        let pixel = self
            .model()
            .project_point(&(target * Pt3::new(x, y, 0.0)))?;
        Some([pixel.x, pixel.y])
    }

    /// The direction in which a pixel looks, z = 1.
    pub(crate) fn ray(&self, [u, v]: [f64; 2]) -> Vec3 {
        self.model().backproject_pixel(&Pt2::new(u, v)).direction
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_distortion_is_that_of_opencv() {
        let camera = Camera {
            size: [640, 480],
            focal: [600.0, 610.0],
            center: [320.0, 240.0],
            distortion: [-0.3, 0.1, 0.001, -0.002, 0.05],
        };
        let pose = Iso3::translation(0.0, 0.0, 1.0);
        let [x, y]: [f64; 2] = [0.3, -0.2];
        let r2 = x * x + y * y;
        // Source: OpenCV, "Camera Calibration and 3D Reconstruction".
        let radial = 1.0 - 0.3 * r2 + 0.1 * r2 * r2 + 0.05 * r2 * r2 * r2;
        let xd = x * radial + 2.0 * 0.001 * x * y - 0.002 * (r2 + 2.0 * x * x);
        let yd = y * radial + 0.001 * (r2 + 2.0 * y * y) - 2.0 * 0.002 * x * y;
        let pixel = camera.project(&pose, [x, y]).unwrap();
        assert!((pixel[0] - (600.0 * xd + 320.0)).abs() < 1e-9);
        assert!((pixel[1] - (610.0 * yd + 240.0)).abs() < 1e-9);
        let ray = camera.ray(pixel);
        assert!((ray.x / ray.z - x).hypot(ray.y / ray.z - y) < 1e-9);
        assert_eq!(Camera::of(&camera.parameters(), [640, 480]), Some(camera));
    }
}
