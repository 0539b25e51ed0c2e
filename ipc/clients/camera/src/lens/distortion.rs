//! How a lens bends rays, and back.

/// Steps in which the inverse is followed from the axis outwards.
const STEPS: usize = 8;
/// Most steps of Newton's method towards one target, and most halvings of one of them.
const MOST_STEPS: usize = 40;
const MOST_HALVINGS: usize = 12;
/// How exact the inverse is, in units of the focal length.
const EXACT: f64 = 1e-12;
/// How far a point may come back from where it was, in units of the focal length.
const SAME: f64 = 1e-8;

/// A model of distortion.
///
/// Symbols: (x, y) is a point on the plane at z = 1, r its distance from the optical axis.
///
/// - Perspective, of OpenCV's `cv::projectPoints`: with
///   f = (1 + k1 r^2 + k2 r^4 + k3 r^6) / (1 + k4 r^2 + k5 r^4 + k6 r^6),
///   x' = x f + 2 p1 x y + p2 (r^2 + 2 x^2), y' = y f + p1 (r^2 + 2 y^2) + 2 p2 x y.
/// - Fisheye, of OpenCV's `cv::fisheye` and Kalibr's `equi`: the point is first moved to the distance
///   t = atan r, the angle from the axis; f = 1 + k1 t^2 + k2 t^4 + k3 t^6 + k4 t^8.
///
/// A model is used in the region about the axis where it does not fold: where the determinant of its
/// derivative is positive.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Distortion {
    /// Coefficients of r^2, r^4, ... above the fraction's bar.
    above: [f64; 4],
    /// Those below it.
    below: [f64; 3],
    /// p1 and p2.
    tangential: [f64; 2],
    is_fisheye: bool,
}

/// A bent point, and the derivative there: [[dx'/dx, dx'/dy], [dy'/dx, dy'/dy]].
struct Bent {
    at: [f64; 2],
    slope: [[f64; 2]; 2],
    /// The determinant of the derivative.
    area: f64,
}

impl Distortion {
    /// The perspective model. Coefficients as OpenCV orders them: k1, k2, p1, p2, k3, k4, k5, k6.
    pub fn perspective([k1, k2, p1, p2, k3, k4, k5, k6]: [f64; 8]) -> Self {
        Self {
            above: [k1, k2, k3, 0.0],
            below: [k4, k5, k6],
            tangential: [p1, p2],
            is_fisheye: false,
        }
    }

    /// The fisheye model: k1, k2, k3, k4.
    pub fn fisheye(above: [f64; 4]) -> Self {
        Self {
            above,
            below: [0.0; 3],
            tangential: [0.0; 2],
            is_fisheye: true,
        }
    }

    /// The bent point; `None` where the model folds, or beyond.
    pub fn bend(&self, point: [f64; 2]) -> Option<[f64; 2]> {
        let point = match self.is_fisheye {
            true => scaled(point, |r| r.atan() / r),
            false => point,
        };
        let bent = self.evaluate(point)?.at;
        // Beyond the fold, the model may look sound again.
        let back = self.invert(bent)?;
        let is_same = distance(point, back) < SAME * (1.0 + length(point));
        is_same.then_some(bent)
    }

    /// The point that is bent to this one; `None` if there is none.
    pub fn unbend(&self, bent: [f64; 2]) -> Option<[f64; 2]> {
        let point = self.invert(bent)?;
        match self.is_fisheye {
            // Rays from the side and from behind meet no plane in front.
            true if length(point) >= std::f64::consts::FRAC_PI_2 => None,
            true => Some(scaled(point, |t| t.tan() / t)),
            false => Some(point),
        }
    }

    /// Follows the inverse from the axis outwards, so that it cannot jump over a fold.
    fn invert(&self, bent: [f64; 2]) -> Option<[f64; 2]> {
        let part = |step: usize| step as f64 / STEPS as f64;
        (1..=STEPS).try_fold([0.0; 2], |start, step| {
            self.newton(start, bent.map(|x| x * part(step)))
        })
    }

    /// Newton's method, with steps that are halved until they come nearer without leaving the
    /// region.
    fn newton(&self, start: [f64; 2], target: [f64; 2]) -> Option<[f64; 2]> {
        let mut point = start;
        let mut here = self.evaluate(point)?;
        for _ in 0..MOST_STEPS {
            let miss = distance(here.at, target);
            if miss < EXACT * (1.0 + length(target)) {
                return Some(point);
            }
            let [u, v] = [target[0] - here.at[0], target[1] - here.at[1]];
            let [[a, b], [c, d]] = here.slope;
            let full = [(d * u - b * v) / here.area, (a * v - c * u) / here.area];
            let halved = (0..MOST_HALVINGS).map(|halvings| 0.5_f64.powi(halvings as i32));
            (point, here) = halved
                .map(|share| [point[0] + share * full[0], point[1] + share * full[1]])
                .filter_map(|next| Some((next, self.evaluate(next)?)))
                .find(|(_, there)| distance(there.at, target) < miss)?;
        }
        None
    }

    /// The polynomials; `None` where they fold or have a pole.
    fn evaluate(&self, [x, y]: [f64; 2]) -> Option<Bent> {
        let s = x * x + y * y;
        let [k1, k2, k3, k4] = self.above;
        let above = 1.0 + s * (k1 + s * (k2 + s * (k3 + s * k4)));
        let above_slope = k1 + s * (2.0 * k2 + s * (3.0 * k3 + s * 4.0 * k4));
        let [k4, k5, k6] = self.below;
        let below = 1.0 + s * (k4 + s * (k5 + s * k6));
        let below_slope = k4 + s * (2.0 * k5 + s * 3.0 * k6);
        let [p1, p2] = self.tangential;
        let f = above / below;
        // df / ds, twice.
        let g = 2.0 * (above_slope * below - above * below_slope) / (below * below);
        let mixed = x * y * g + 2.0 * (p1 * x + p2 * y);
        let slope = [
            [f + x * x * g + 2.0 * p1 * y + 6.0 * p2 * x, mixed],
            [mixed, f + y * y * g + 6.0 * p1 * y + 2.0 * p2 * x],
        ];
        let area = slope[0][0] * slope[1][1] - mixed * mixed;
        let at = [
            x * f + 2.0 * p1 * x * y + p2 * (s + 2.0 * x * x),
            y * f + p1 * (s + 2.0 * y * y) + 2.0 * p2 * x * y,
        ];
        // f turns negative only where both slopes do. Not a number is refused, too.
        let is_regular = below > 0.0 && f > 0.0 && area > 0.0 && area.is_finite();
        is_regular.then_some(Bent { at, slope, area })
    }
}

fn length([x, y]: [f64; 2]) -> f64 {
    x.hypot(y)
}

fn distance(a: [f64; 2], b: [f64; 2]) -> f64 {
    length([a[0] - b[0], a[1] - b[1]])
}

/// The point with its distance from the axis times a factor, which is 1 at the axis.
fn scaled(point: [f64; 2], factor: impl Fn(f64) -> f64) -> [f64; 2] {
    match length(point) {
        0.0 => point,
        r => point.map(|x| x * factor(r)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MODELS: [(Distortion, f64); 4] = [
        // With the distance from the axis up to which there is an inverse for certain.
        (
            Distortion {
                above: [-0.28, 0.07, 0.0, 0.0],
                below: [0.0; 3],
                tangential: [1e-3, -2e-3],
                is_fisheye: false,
            },
            1.0,
        ),
        (
            Distortion {
                above: [0.3, 0.1, 0.05, 0.0],
                below: [0.1, 0.02, 0.001],
                tangential: [1e-3, 5e-4],
                is_fisheye: false,
            },
            2.0,
        ),
        (
            Distortion {
                above: [0.0; 4],
                below: [0.0; 3],
                tangential: [0.0; 2],
                is_fisheye: false,
            },
            10.0,
        ),
        (
            Distortion {
                above: [-0.02, 0.004, -0.001, 1e-4],
                below: [0.0; 3],
                tangential: [0.0; 2],
                is_fisheye: true,
            },
            5.0,
        ),
    ];

    fn points(radius: f64) -> impl Iterator<Item = [f64; 2]> {
        (0..=20).flat_map(move |ring| {
            (0..12).map(move |turn| {
                let (r, angle) = (radius * f64::from(ring) / 20.0, 0.5 * f64::from(turn));
                [r * angle.cos(), r * angle.sin()]
            })
        })
    }

    #[test]
    fn unbending_undoes_bending() {
        for (model, radius) in MODELS {
            for point in points(radius) {
                let bent = model.bend(point).unwrap();
                let back = model.unbend(bent).unwrap();
                assert!(
                    distance(point, back) < 1e-9,
                    "{model:?} {point:?}: {back:?}"
                );
            }
        }
    }

    #[test]
    fn the_derivative_is_that_of_the_model() {
        for (model, radius) in MODELS {
            for [x, y] in points(radius.min(1.2)) {
                const H: f64 = 1e-6;
                let at = |x, y| model.evaluate([x, y]).unwrap();
                let (right, left) = (at(x + H, y).at, at(x - H, y).at);
                let (low, high) = (at(x, y + H).at, at(x, y - H).at);
                for i in 0..2 {
                    let [across, down] = at(x, y).slope[i];
                    assert!((across - (right[i] - left[i]) / (2.0 * H)).abs() < 1e-7);
                    assert!((down - (low[i] - high[i]) / (2.0 * H)).abs() < 1e-7);
                }
            }
        }
    }

    #[test]
    fn beyond_the_fold_there_is_no_inverse() {
        // r (1 - 0.3 r^2) is greatest at r = 1 / sqrt 0.9: 0.7027. Further out it falls, and beyond
        // r = 1.83 it is negative.
        let model = Distortion::perspective([-0.3, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
        let (fold, most) = (1.0 / 0.9_f64.sqrt(), 2.0 / 3.0 / 0.9_f64.sqrt());
        for [x, y] in points(1.0).filter(|point| *point != [0.0; 2]) {
            let r = x.hypot(y);
            let at = |distance: f64| [x / r * distance, y / r * distance];
            let back = model.unbend(at(most * 0.9999)).unwrap();
            assert!(length(back) < fold);
            assert_eq!(model.unbend(at(most * 1.0001)), None);
            assert!(model.bend(at(fold * 0.999)).is_some());
            for beyond in [1.001, 1.4, 1.7, 3.0, 100.0] {
                assert_eq!(model.bend(at(fold * beyond)), None);
            }
        }
    }

    #[test]
    fn what_looks_sound_beyond_a_fold_is_no_image() {
        // r (1 - r^2 + 0.2 r^4) rises again from r = 1.6 on.
        let model = Distortion::perspective([-1.0, 0.2, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
        let far = [2.3, 0.0];
        assert!(model.evaluate(far).is_some());
        assert_eq!(model.bend(far), None);
        let bent = model.evaluate([0.5, 0.0]).unwrap().at;
        assert!(distance(model.unbend(bent).unwrap(), [0.5, 0.0]) < 1e-9);
    }

    #[test]
    fn a_fisheye_sees_no_plane_at_the_side() {
        let model = Distortion::fisheye([0.0; 4]);
        let almost = model.unbend([1.57, 0.0]).unwrap();
        assert!((almost[0] - 1.57_f64.tan()).abs() < 1e-6);
        assert_eq!(model.unbend([1.58, 0.0]), None);
    }

    #[test]
    fn what_is_not_a_number_has_no_image() {
        for (model, _) in MODELS {
            for point in [[f64::NAN, 0.0], [0.0, f64::INFINITY]] {
                assert_eq!((model.bend(point), model.unbend(point)), (None, None));
            }
        }
    }
}
