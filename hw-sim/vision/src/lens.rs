//! Distortion of the lens.

use scene::Camera;

use crate::homography::Point;

/// Most steps of Newton's method; a point of an image needs five.
const STEPS: usize = 30;
/// Residual at which a point counts as found, in units of the focal length.
const FOUND: f64 = 1e-12;
/// Places along a side of a box at which it is distorted.
const BOX: usize = 16;
/// Pixels beyond the border that still matter to what is drawn at it.
const BEYOND: f64 = 4.0;

/// A lens: from the pinhole's image, in which lines are straight, to the picture and back.
///
/// Source: OpenCV, `calib3d`, "Camera Calibration and 3D Reconstruction": x'' = x' (1 + k1 r^2 + k2
/// r^4 + k3 r^6) + 2 p1 x' y' + p2 (r^2 + 2 x'^2), and likewise y''.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lens {
    camera: Camera,
    /// k1 k2 p1 p2 k3; none where all are zero.
    distortion: Option<[f64; 5]>,
}

impl Lens {
    /// The lens of a camera with this distortion: k1 k2 p1 p2 k3, as OpenCV orders them.
    pub fn new(camera: &Camera, distortion: [f64; 5]) -> Self {
        Self {
            camera: *camera,
            distortion: (distortion != [0.0; 5]).then_some(distortion),
        }
    }

    /// Whether the picture is the pinhole's image.
    pub(crate) fn is_straight(&self) -> bool {
        self.distortion.is_none()
    }

    /// Where a point of the pinhole's image is in the picture, px.
    pub fn distort(&self, pixel: Point) -> Point {
        match &self.distortion {
            None => pixel,
            Some(distortion) => self.pixel(bend(distortion, self.ray(pixel)).0),
        }
    }

    /// The box in the picture round a box of the pinhole's image.
    pub(crate) fn distort_box(&self, [least, most]: [Point; 2]) -> [Point; 2] {
        let mut bounds = [least, most];
        if self.is_straight() {
            return bounds;
        }
        bounds = [[f64::INFINITY; 2], [f64::NEG_INFINITY; 2]];
        for k in 0..=BOX {
            let share = k as f64 / BOX as f64;
            let [u, v] = [0, 1].map(|k| least[k] + share * (most[k] - least[k]));
            for at in [[u, least[1]], [u, most[1]], [least[0], v], [most[0], v]] {
                let pixel = self.distort(at);
                for k in 0..2 {
                    bounds[0][k] = bounds[0][k].min(pixel[k]);
                    bounds[1][k] = bounds[1][k].max(pixel[k]);
                }
            }
        }
        bounds
    }

    /// The point of the pinhole's image that is seen at a pixel of the picture, px; `None` where
    /// the distortion has no inverse.
    pub fn undistort(&self, pixel: Point) -> Option<Point> {
        let Some(distortion) = &self.distortion else {
            return Some(pixel);
        };
        let wanted = self.ray(pixel);
        let mut at = wanted;
        for _ in 0..STEPS {
            let (bent, [[a, b], [c, d]]) = bend(distortion, at);
            let off = [wanted[0] - bent[0], wanted[1] - bent[1]];
            let determinant = a * d - b * c;
            // Where it turns negative the picture would be folded.
            if determinant <= 1e-3 {
                return None;
            }
            if off[0].abs().max(off[1].abs()) < FOUND {
                return Some(self.pixel(at));
            }
            at[0] += (d * off[0] - b * off[1]) / determinant;
            at[1] += (a * off[1] - c * off[0]) / determinant;
        }
        None
    }

    /// Whether each pixel of the picture shows one point.
    pub fn is_invertible(&self) -> bool {
        let (width, height) = (self.camera.width, self.camera.height);
        let side = |share: f64| {
            let (u, v) = (share * (width - 1.0), share * (height - 1.0));
            [[u, 0.0], [u, height - 1.0], [0.0, v], [width - 1.0, v]]
        };
        let border = (0..=64).flat_map(|k| side(f64::from(k) / 64.0));
        border
            .into_iter()
            .all(|pixel| self.undistort(pixel).is_some())
    }

    fn ray(&self, [u, v]: Point) -> Point {
        let camera = &self.camera;
        [(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy]
    }

    fn pixel(&self, [x, y]: Point) -> Point {
        let camera = &self.camera;
        [camera.fx * x + camera.cx, camera.fy * y + camera.cy]
    }
}

/// Bends a ray; and the derivative of that.
fn bend(&[k1, k2, p1, p2, k3]: &[f64; 5], [x, y]: Point) -> (Point, [[f64; 2]; 2]) {
    let square = x * x + y * y;
    let radial = 1.0 + square * (k1 + square * (k2 + square * k3));
    let slope = 2.0 * (k1 + square * (2.0 * k2 + square * 3.0 * k3));
    let bent = [
        x * radial + 2.0 * p1 * x * y + p2 * (square + 2.0 * x * x),
        y * radial + p1 * (square + 2.0 * y * y) + 2.0 * p2 * x * y,
    ];
    let across = x * y * slope + 2.0 * p1 * x + 2.0 * p2 * y;
    let derivative = [
        [radial + x * x * slope + 2.0 * p1 * y + 6.0 * p2 * x, across],
        [across, radial + y * y * slope + 6.0 * p1 * y + 2.0 * p2 * x],
    ];
    (bent, derivative)
}

/// The points of the pinhole's image that the pixels of a picture show.
#[derive(Clone, Debug)]
pub(crate) struct Rays {
    width: usize,
    height: usize,
    /// Row by row; none where the picture is the pinhole's image. Not finite where nothing is seen.
    table: Option<Vec<[f32; 2]>>,
}

impl Rays {
    pub fn new(lens: &Lens, width: usize, height: usize) -> Self {
        let point = |i: usize| {
            let pixel = [(i % width) as f64, (i / width) as f64];
            let seen = lens.undistort(pixel).unwrap_or([f64::NAN; 2]);
            seen.map(|x| x as f32)
        };
        Self {
            width,
            height,
            table: (!lens.is_straight()).then(|| (0..width * height).map(point).collect()),
        }
    }

    /// The box of the points that are shown, a little larger.
    pub fn bounds(&self) -> [Point; 2] {
        let mut bounds = [[f64::INFINITY; 2], [f64::NEG_INFINITY; 2]];
        for u in 0..self.width {
            for v in 0..self.height {
                // Only the border counts.
                let is_border = u == 0 || u + 1 == self.width || v == 0 || v + 1 == self.height;
                let [x, y] = self.at(u, v);
                if is_border && x.is_finite() && y.is_finite() {
                    bounds[0] = [bounds[0][0].min(x), bounds[0][1].min(y)];
                    bounds[1] = [bounds[1][0].max(x), bounds[1][1].max(y)];
                }
            }
        }
        let [least, most] = bounds;
        [least.map(|x| x - BEYOND), most.map(|x| x + BEYOND)]
    }

    /// What the centre of a pixel shows, px; one beyond the border shows what the border does.
    pub fn at(&self, u: usize, v: usize) -> Point {
        match &self.table {
            None => [u as f64, v as f64],
            Some(table) => {
                let (u, v) = (u.min(self.width - 1), v.min(self.height - 1));
                table[v * self.width + u].map(f64::from)
            }
        }
    }

    /// What column `u` of a row shows, also beyond the border.
    pub fn along(&self, u: usize, v: usize) -> Point {
        if self.table.is_none() || u < self.width {
            return self.at(u, v);
        }
        let (last, [slope, _]) = (self.at(u, v), self.slopes(self.width - 1, v));
        let beyond = (u + 1 - self.width) as f64;
        [0, 1].map(|k| last[k] + beyond * slope[k])
    }

    /// How that changes from a pixel to the next one along u, and along v.
    pub fn slopes(&self, u: usize, v: usize) -> [Point; 2] {
        if self.table.is_none() {
            return [[1.0, 0.0], [0.0, 1.0]];
        }
        let slope = |before: [usize; 2], after: [usize; 2]| {
            let (a, b) = (self.at(before[0], before[1]), self.at(after[0], after[1]));
            let apart = ((after[0] - before[0]) + (after[1] - before[1])).max(1) as f64;
            [(b[0] - a[0]) / apart, (b[1] - a[1]) / apart]
        };
        let (right, below) = ((u + 1).min(self.width - 1), (v + 1).min(self.height - 1));
        [
            slope([u.saturating_sub(1), v], [right, v]),
            slope([u, v.saturating_sub(1)], [u, below]),
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const BARREL: [f64; 5] = [-0.25, 0.08, 0.001, -0.0007, -0.01];

    fn camera() -> Camera {
        scene::Scene::parse(scene::TAGS_ROBOT, "tags")
            .unwrap()
            .camera
    }

    #[test]
    fn there_and_back_is_where_it_was_all_over_the_picture() {
        let lens = Lens::new(&camera(), BARREL);
        assert!(lens.is_invertible());
        for u in (0..640).step_by(29) {
            for v in (0..480).step_by(31) {
                let pixel = [f64::from(u), f64::from(v)];
                let [a, b] = lens.distort(lens.undistort(pixel).unwrap());
                assert!((a - pixel[0]).hypot(b - pixel[1]) < 1e-8);
            }
        }
    }

    #[test]
    fn a_point_is_bent_as_opencv_bends_it() {
        // cv2.projectPoints of (0.3, -0.2, 1) with this distortion; focal length 615, centre (320, 240).
        let lens = Lens::new(&camera(), BARREL);
        let [u, v] = lens.distort([320.0 + 615.0 * 0.3, 240.0 - 615.0 * 0.2]);
        let apart = (u - 498.541_885_54).hypot(v - 121.014_716_31);
        assert!(apart < 1e-7, "({u}, {v})");
    }

    #[test]
    fn a_lens_that_folds_the_picture_is_not_invertible() {
        assert!(!Lens::new(&camera(), [-0.9, 0.0, 0.0, 0.0, 0.0]).is_invertible());
        assert!(Lens::new(&camera(), [0.0; 5]).is_invertible());
    }

    #[test]
    fn slopes_are_the_derivative_of_what_pixels_show() {
        let lens = Lens::new(&camera(), BARREL);
        let rays = Rays::new(&lens, 640, 480);
        for (u, v) in [(30, 20), (600, 400), (0, 479)] {
            let [right, below] = rays.slopes(u, v);
            let at = |du: f64, dv: f64| lens.undistort([u as f64 + du, v as f64 + dv]).unwrap();
            for (slope, moved) in [(right, at(0.1, 0.0)), (below, at(0.0, 0.1))] {
                for k in 0..2 {
                    let expected = 10.0 * (moved[k] - at(0.0, 0.0)[k]);
                    assert!((slope[k] - expected).abs() < 3e-3, "{slope:?}");
                }
            }
        }
    }
}
