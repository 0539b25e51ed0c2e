//! Homographies between planes.

use nalgebra::{Isometry3, Matrix3, Rotation3, SMatrix, SVector, Translation3, Vector3};

/// A point, px or m.
pub type Point = [f64; 2];

/// A homography.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Homography(Matrix3<f64>);

impl Homography {
    /// The one that best takes the first of each pair to the second, by least squares; `None` for
    /// fewer than four pairs, or on a line.
    pub fn fit(pairs: &[(Point, Point)]) -> Option<Self> {
        if pairs.len() < 4 {
            return None;
        }
        let from = Frame::of(pairs.iter().map(|pair| pair.0))?;
        let to = Frame::of(pairs.iter().map(|pair| pair.1))?;
        let (mut a, mut b) = (SMatrix::<f64, 8, 8>::zeros(), SVector::<f64, 8>::zeros());
        for (source, target) in pairs {
            let ([x, y], [u, v]) = (from.inside(*source), to.inside(*target));
            for (row, value) in [
                ([x, y, 1.0, 0.0, 0.0, 0.0, -u * x, -u * y], u),
                ([0.0, 0.0, 0.0, x, y, 1.0, -v * x, -v * y], v),
            ] {
                let row = SVector::from(row);
                a.ger(1.0, &row, &row, 1.0);
                b.axpy(value, &row, 1.0);
            }
        }
        let h = a.cholesky()?.solve(&b);
        let h = Matrix3::new(h[0], h[1], h[2], h[3], h[4], h[5], h[6], h[7], 1.0);
        let h = to.outside() * h * from.outside().try_inverse()?;
        h.iter().all(|x| x.is_finite()).then_some(Self(h))
    }

    /// Where a point comes to; `None` if it does not lie in front.
    pub fn apply(&self, [x, y]: Point) -> Option<Point> {
        let p = self.0 * Vector3::new(x, y, 1.0);
        let at = [p.x / p.z, p.y / p.z];
        at.iter().all(|x| x.abs() < 1e6).then_some(at)
    }

    /// The pose of the plane's frame in the camera, where it leads to normalized image coordinates;
    /// `None` for a plane behind the camera.
    pub fn pose(&self) -> Option<Isometry3<f64>> {
        let [a, b, c] = [0, 1, 2].map(|k| self.0.column(k).into_owned());
        let scale = 2.0 / (a.norm() + b.norm());
        let scale = if c.z < 0.0 { -scale } else { scale };
        let axes = Matrix3::from_columns(&[scale * a, scale * b, scale * scale * a.cross(&b)]);
        let svd = axes.svd(true, true);
        let turn = Rotation3::from_matrix_unchecked(svd.u? * svd.v_t?);
        let at = Translation3::from(scale * c);
        (at.z > 0.0).then(|| Isometry3::from_parts(at, turn.into()))
    }

    /// The way back.
    pub fn inverse(&self) -> Option<Self> {
        self.0.try_inverse().map(Self)
    }
}

/// A frame in which points are about the origin, with a mean distance of 1.
struct Frame {
    middle: Point,
    size: f64,
}

impl Frame {
    fn of(points: impl Iterator<Item = Point> + Clone) -> Option<Self> {
        let count = points.clone().count() as f64;
        let sum = points
            .clone()
            .fold([0.0; 2], |s, p| [s[0] + p[0], s[1] + p[1]]);
        let middle = sum.map(|x| x / count);
        let far = points.map(|p| (p[0] - middle[0]).hypot(p[1] - middle[1]));
        let size = far.sum::<f64>() / count;
        (size > 1e-9).then_some(Self { middle, size })
    }

    fn inside(&self, point: Point) -> Point {
        [0, 1].map(|k| (point[k] - self.middle[k]) / self.size)
    }

    fn outside(&self) -> Matrix3<f64> {
        let ([u, v], s) = (self.middle, self.size);
        Matrix3::new(s, 0.0, u, 0.0, s, v, 0.0, 0.0, 1.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn four_pairs_are_met_and_the_way_back_is_one() {
        let square = [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]];
        let seen = [[100.0, 80.0], [180.0, 90.0], [170.0, 160.0], [95.0, 150.0]];
        let pairs: Vec<_> = square.into_iter().zip(seen).collect();
        let h = Homography::fit(&pairs).unwrap();
        let back = h.inverse().unwrap();
        for (from, to) in pairs {
            let (there, here) = (h.apply(from).unwrap(), back.apply(to).unwrap());
            for k in 0..2 {
                assert!((there[k] - to[k]).abs() < 1e-8 && (here[k] - from[k]).abs() < 1e-10);
            }
        }
        assert!(Homography::fit(&[([0.0, 0.0], [1.0, 1.0]); 3]).is_none());
        let line = [0.0, 1.0, 2.0, 3.0].map(|x| ([x, x], [x, x]));
        assert!(Homography::fit(&line).is_none());
    }
}
