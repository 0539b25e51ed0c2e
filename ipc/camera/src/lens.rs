//! The real lens: from a point in its image to the pinhole of the scene, and back.
//!
//! Source: the models of OpenCV 4, modules calib3d and fisheye, which ROS and Kalibr share.

mod file;

pub use file::read;

use scene::Camera;

/// Steps of Newton's method; it takes three to six.
const STEPS: usize = 30;
/// When a point has converged, in the plane at distance 1.
const CONVERGED: f64 = 1e-12;
/// Farthest angle from the optical axis at which a pinhole can show a point, rad.
const WIDEST: f64 = 1.55;

/// How a lens bends light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Distortion {
    /// k1 k2 p1 p2 k3 k4 k5 k6: `plumb_bob` and `rational_polynomial` in ROS, `radtan` in Kalibr.
    Rational([f64; 8]),
    /// k1 k2 k3 k4: OpenCV's fisheye, `equidistant`.
    Equidistant([f64; 4]),
}

/// Intrinsics of the real camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lens {
    /// Width and height of the image that it is about, px; `None` if the file does not tell.
    pub size: Option<[f64; 2]>,
    /// Focal lengths along u and v, px.
    pub focal: [f64; 2],
    /// Principal point, px; the centre of the upper left pixel is (0, 0).
    pub centre: [f64; 2],
    /// Its distortion.
    pub distortion: Distortion,
}

impl Lens {
    /// The lens of a scene's camera: none.
    pub fn pinhole(camera: &Camera) -> Self {
        Self {
            size: Some([camera.width, camera.height]),
            focal: [camera.fx, camera.fy],
            centre: [camera.cx, camera.cy],
            distortion: Distortion::Rational([0.0; 8]),
        }
    }

    /// Where the scene's camera, a pinhole, sees what the real one sees at `pixel`; `None` if a
    /// pinhole cannot see it.
    pub fn straighten(&self, pixel: [f64; 2], camera: &Camera) -> Option<[f64; 2]> {
        let bent = [0, 1].map(|k| (pixel[k] - self.centre[k]) / self.focal[k]);
        let [x, y] = self.distortion.remove(bent)?;
        Some([x * camera.fx + camera.cx, y * camera.fy + camera.cy])
    }

    /// Where the real camera sees what the scene's one sees at `pixel`; not finite where it does
    /// not.
    pub fn bend(&self, pixel: [f64; 2], camera: &Camera) -> [f64; 2] {
        let x = (pixel[0] - camera.cx) / camera.fx;
        let y = (pixel[1] - camera.cy) / camera.fy;
        let (bent, _) = self.distortion.apply([x, y]);
        [0, 1].map(|k| bent[k] * self.focal[k] + self.centre[k])
    }
}

impl Distortion {
    /// The distorted point, and the derivatives of its coordinates; both in the plane at distance 1.
    fn apply(&self, [x, y]: [f64; 2]) -> ([f64; 2], [[f64; 2]; 2]) {
        let square = x * x + y * y;
        match *self {
            Self::Rational([k1, k2, p1, p2, k3, k4, k5, k6]) => {
                let polynomial = |a: f64, b: f64, c: f64| {
                    let value = 1.0 + square * (a + square * (b + square * c));
                    (value, a + square * (2.0 * b + square * 3.0 * c))
                };
                let (over, over_by) = polynomial(k1, k2, k3);
                let (under, under_by) = polynomial(k4, k5, k6);
                let radial = over / under;
                // By the square of the radius.
                let by = (over_by - radial * under_by) / under;
                let bent = [
                    x * radial + 2.0 * p1 * x * y + p2 * (square + 2.0 * x * x),
                    y * radial + p1 * (square + 2.0 * y * y) + 2.0 * p2 * x * y,
                ];
                let across = 2.0 * x * y * by + 2.0 * p1 * x + 2.0 * p2 * y;
                let along_x = radial + 2.0 * x * x * by + 2.0 * p1 * y + 6.0 * p2 * x;
                let along_y = radial + 2.0 * y * y * by + 6.0 * p1 * y + 2.0 * p2 * x;
                (bent, [[along_x, across], [across, along_y]])
            }
            Self::Equidistant(k) => {
                let radius = square.sqrt();
                if radius < 1e-9 {
                    return ([x, y], [[1.0, 0.0], [0.0, 1.0]]);
                }
                let angle = radius.atan();
                let (bent, by_angle) = fisheye(&k, angle);
                let (scale, by_radius) = (bent / radius, by_angle / (1.0 + square));
                let by = (by_radius - scale) / square;
                let turned = [
                    [scale + x * x * by, x * y * by],
                    [x * y * by, scale + y * y * by],
                ];
                ([x * scale, y * scale], turned)
            }
        }
    }

    /// The point that is bent to `bent`, in the plane at distance 1.
    fn remove(&self, bent: [f64; 2]) -> Option<[f64; 2]> {
        if let Self::Equidistant(k) = self {
            return unfisheye(k, bent);
        }
        let mut at = bent;
        for _ in 0..STEPS {
            let (now, [[a, b], [c, d]]) = self.apply(at);
            let (off_x, off_y) = (bent[0] - now[0], bent[1] - now[1]);
            let det = a * d - b * c;
            // Where it is not above 0 the model has folded the image: it does not hold there.
            if det.is_nan() || det <= 0.0 {
                return None;
            }
            let step = [(d * off_x - b * off_y) / det, (a * off_y - c * off_x) / det];
            at = [at[0] + step[0], at[1] + step[1]];
            if step[0].abs().max(step[1].abs()) < CONVERGED {
                return at.iter().all(|x| x.is_finite()).then_some(at);
            }
        }
        None
    }
}

/// The bent angle (rad) and its derivative.
fn fisheye(k: &[f64; 4], angle: f64) -> (f64, f64) {
    let square = angle * angle;
    let [mut value, mut by] = [0.0; 2];
    for (power, k) in k.iter().enumerate().rev() {
        value = square * (k + value);
        by = square * ((2 * power + 3) as f64 * k + by);
    }
    (angle * (1.0 + value), 1.0 + by)
}

fn unfisheye(k: &[f64; 4], bent: [f64; 2]) -> Option<[f64; 2]> {
    let wanted = bent[0].hypot(bent[1]);
    if wanted < 1e-9 {
        return Some(bent);
    }
    let mut angle = wanted;
    for _ in 0..STEPS {
        let (now, by) = fisheye(k, angle);
        if by.is_nan() || by <= 0.0 {
            return None;
        }
        let step = (wanted - now) / by;
        angle += step;
        if step.abs() < CONVERGED {
            let scale = angle.tan() / wanted;
            return (0.0..WIDEST)
                .contains(&angle)
                .then(|| bent.map(|x| scale * x));
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    fn camera() -> Camera {
        let text = scene::PAPER_ROBOT;
        scene::Scene::parse(text, "robot").unwrap().camera
    }

    /// A lens whose focal length and principal point are not the scene's.
    fn lens(distortion: Distortion) -> Lens {
        Lens {
            size: None,
            focal: [600.0, 605.0],
            centre: [325.0, 236.0],
            distortion,
        }
    }

    pub(super) const LENSES: [Distortion; 4] = [
        Distortion::Rational([0.0; 8]),
        Distortion::Rational([-0.31, 0.12, 0.0012, -0.0008, -0.02, 0.0, 0.0, 0.0]),
        Distortion::Rational([0.42, -0.1, -0.0005, 0.0009, 0.02, 0.75, -0.05, 0.01]),
        Distortion::Equidistant([0.03, -0.012, 0.004, -0.001]),
    ];

    #[test]
    fn a_point_that_is_bent_and_straightened_is_where_it_was() {
        for distortion in LENSES {
            let lens = lens(distortion);
            for n in 0..35 {
                let pixel = [(n % 7) as f64 * 106.0, (n / 7) as f64 * 119.0];
                let bent = lens.bend(pixel, &camera());
                let back = lens.straighten(bent, &camera()).unwrap();
                let off = (back[0] - pixel[0]).hypot(back[1] - pixel[1]);
                assert!(off < 1e-8, "{distortion:?}: {pixel:?}, {back:?}");
            }
        }
    }

    #[test]
    fn the_derivatives_are_those_of_the_model() {
        for distortion in LENSES {
            for [x, y] in [[0.31, -0.22], [-0.4, 0.1], [0.02, 0.5]] {
                let (_, by) = distortion.apply([x, y]);
                for k in 0..2 {
                    let step = 1e-6;
                    let shift = [[step, 0.0], [0.0, step]][k];
                    let at = |sign: f64| {
                        distortion.apply([x + sign * shift[0], y + sign * shift[1]]).0
                    };
                    let (after, before) = (at(1.0), at(-1.0));
                    for i in 0..2 {
                        let slope = (after[i] - before[i]) / (2.0 * step);
                        assert!((slope - by[i][k]).abs() < 1e-7, "{distortion:?}");
                    }
                }
            }
        }
    }

    #[test]
    fn where_the_model_folds_the_image_there_is_no_point() {
        let folding = lens(Distortion::Rational([
            -0.9, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0,
        ]));
        assert!(folding.straighten([325.0, 236.0], &camera()).is_some());
        assert_eq!(folding.straighten([1200.0, 900.0], &camera()), None);
        // A fisheye sees behind the plane, which no pinhole does.
        let wide = lens(Distortion::Equidistant([0.0; 4]));
        assert_eq!(wide.straighten([325.0 + 600.0 * 1.6, 236.0], &camera()), None);
        assert_eq!(wide.straighten([f64::NAN, 236.0], &camera()), None);
    }
}
