//! Maps from the plane of the pattern (m) to the image (px).

use nalgebra::{Cholesky, Matrix3, Rotation3, SMatrix, SVector, Vector2, Vector3};
use scene::{Camera, Pose};

/// A point of a plane: of the pattern (x, y), m, or of the image (u, v), px.
pub(crate) type Point = [f64; 2];

/// The map of a plane: (x, y, 1) -> w (u, v, 1).
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Homography(pub Matrix3<f64>);

/// The ellipse in which a disc of the pattern's plane is seen.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Ellipse {
    /// Its centre, px; not where the disc's centre is seen.
    pub center: Point,
    /// Half sizes of the box around it, px.
    pub half: Point,
}

impl Homography {
    /// How a camera sees the plane z = 0 of an object: K [r1 r2 t]; w is then the depth, m.
    pub fn of_pose(camera: &Camera, pose: &Pose) -> Self {
        let Camera { fx, fy, cx, cy, .. } = *camera;
        let mut columns = Rotation3::new(Vector3::from(pose.rotation)).into_inner();
        columns.set_column(2, &Vector3::from(pose.translation));
        Self(Matrix3::new(fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0) * columns)
    }

    /// w (u, v, 1) of a point.
    fn homogeneous(&self, [x, y]: Point) -> Vector3<f64> {
        self.0 * Vector3::new(x, y, 1.0)
    }

    /// Where a point is seen; none behind the camera.
    pub fn apply(&self, point: Point) -> Option<Point> {
        let x = self.homogeneous(point);
        (x.z > 1e-9).then(|| [x.x / x.z, x.y / x.z])
    }

    /// The derivative of the image point: [[du/dx, du/dy], [dv/dx, dv/dy]], px/m.
    pub fn jacobian(&self, point: Point) -> Option<[[f64; 2]; 2]> {
        let [u, v] = self.apply(point)?;
        let (w, h) = (self.homogeneous(point).z, &self.0);
        let row = |row: usize, at: f64| [0, 1].map(|k| (h[(row, k)] - at * h[(2, k)]) / w);
        Some([row(0, u), row(1, v)])
    }

    /// How a disc is seen, by the dual of its conic; none if it is not wholly in front of the
    /// camera.
    pub fn disc(&self, center: Point, radius: f64) -> Option<Ellipse> {
        let c = self.homogeneous(center);
        let rim = self.0.fixed_columns::<2>(0);
        let dual = c * c.transpose() - rim * rim.transpose() * (radius * radius);
        let scale = dual[(2, 2)];
        if c.z < 1e-9 || scale < 1e-12 {
            return None;
        }
        let at = [0, 1].map(|k| dual[(k, 2)] / scale);
        let half = [0, 1].map(|k| (at[k] * at[k] - dual[(k, k)] / scale).max(0.0).sqrt());
        Some(Ellipse { center: at, half })
    }

    /// Between this map and another, element by element.
    pub fn between(&self, other: &Self, share: f64) -> Self {
        Self(self.0 + (other.0 - self.0) * share)
    }

    /// The map back; none if the plane is seen edge-on.
    pub fn inverse(&self) -> Option<Self> {
        let is_regular = self.0.determinant().abs() > 1e-12;
        self.0.try_inverse().filter(|_| is_regular).map(Self)
    }

    /// The map through pairs (point of the pattern, image point): from four pairs on a homography,
    /// exact or least squares; none if the points do not fix it. `unit` is the size of the
    /// pattern, m.
    pub fn through(pairs: &[(Point, Point)], unit: f64) -> Option<Self> {
        if pairs.len() < 4 {
            return None;
        }
        let center = mean(pairs.iter().map(|pair| pair.1));
        let spread = pairs
            .iter()
            .map(|pair| distance(pair.1, center))
            .fold(1e-9, f64::max);
        let rows = pairs.iter().flat_map(|([x, y], pixel)| {
            let (x, y) = (x / unit, y / unit);
            let [u, v] = [0, 1].map(|k| (pixel[k] - center[k]) / spread);
            [
                ([x, y, 1.0, 0.0, 0.0, 0.0, -u * x, -u * y].into(), u),
                ([0.0, 0.0, 0.0, x, y, 1.0, -v * x, -v * y].into(), v),
            ]
        });
        let h = least_squares::<8>(rows)?;
        let normalized = Matrix3::from_row_iterator(h.iter().copied().chain([1.0]));
        let [u, v] = center;
        let image = Matrix3::new(spread, 0.0, u, 0.0, spread, v, 0.0, 0.0, 1.0);
        let plane = Matrix3::from_diagonal(&Vector3::new(1.0 / unit, 1.0 / unit, 1.0));
        Some(Self(image * normalized * plane))
    }

    /// The affine map through three pairs or more; none if they lie on a line.
    pub fn affine(pairs: &[(Point, Point)]) -> Option<Self> {
        if pairs.len() < 3 {
            return None;
        }
        let (from, to) = centers(pairs);
        let unit = pairs
            .iter()
            .map(|pair| distance(pair.0, from))
            .fold(1e-12, f64::max);
        let row = |k: usize| {
            let equations = pairs.iter().map(|(point, pixel)| {
                let x = Vector2::new(point[0] - from[0], point[1] - from[1]) / unit;
                (x, pixel[k] - to[k])
            });
            least_squares(equations).map(|row| [row[0] / unit, row[1] / unit])
        };
        Some(Self::linear([row(0)?, row(1)?], from, to))
    }

    /// The similarity (turn, scale, shift) through two pairs or more, the shift through one.
    pub fn similarity(pairs: &[(Point, Point)]) -> Option<Self> {
        let (from, to) = centers(pairs);
        let (mut dot, mut cross, mut square) = (0.0, 0.0, 0.0);
        for (a, b) in pairs {
            let (x, y) = (a[0] - from[0], a[1] - from[1]);
            let (u, v) = (b[0] - to[0], b[1] - to[1]);
            dot += x * u + y * v;
            cross += x * v - y * u;
            square += x * x + y * y;
        }
        let (c, s) = match pairs.len() {
            0 => return None,
            1 => (1.0, 0.0),
            _ if square < 1e-12 => return None,
            _ => (dot / square, cross / square),
        };
        Some(Self::linear([[c, -s], [s, c]], from, to))
    }

    /// x -> to + a (x - from).
    fn linear([[a, b], [c, d]]: [[f64; 2]; 2], from: Point, to: Point) -> Self {
        let u = to[0] - a * from[0] - b * from[1];
        let v = to[1] - c * from[0] - d * from[1];
        Self(Matrix3::new(a, b, u, c, d, v, 0.0, 0.0, 1.0))
    }

    /// This map first, `next` after it.
    pub fn then(&self, next: &Self) -> Self {
        Self(next.0 * self.0)
    }
}

/// Distance of two points.
pub(crate) fn distance(a: Point, b: Point) -> f64 {
    (a[0] - b[0]).hypot(a[1] - b[1])
}

/// Mean of points.
pub(crate) fn mean(points: impl Iterator<Item = Point>) -> Point {
    let (mut sum, mut count) = ([0.0; 2], 0.0);
    for point in points {
        sum = [sum[0] + point[0], sum[1] + point[1]];
        count += 1.0;
    }
    sum.map(|x| x / f64::max(count, 1.0))
}

fn centers(pairs: &[(Point, Point)]) -> (Point, Point) {
    (
        mean(pairs.iter().map(|pair| pair.0)),
        mean(pairs.iter().map(|pair| pair.1)),
    )
}

/// The unknowns that best solve equations (row, right side); none if the rows do not fix them.
fn least_squares<const N: usize>(
    equations: impl Iterator<Item = (SVector<f64, N>, f64)>,
) -> Option<SVector<f64, N>> {
    let (mut a, mut b) = (SMatrix::<f64, N, N>::zeros(), SVector::<f64, N>::zeros());
    for (row, right) in equations {
        a += row * row.transpose();
        b += row * right;
    }
    let factor = Cholesky::new(a)?;
    let pivot = |j: usize| factor.l_dirty()[(j, j)].powi(2);
    let is_regular = (0..N).all(|j| pivot(j) > 1e-10 * a[(j, j)].max(1e-6));
    is_regular.then(|| factor.solve(&b))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn camera() -> Camera {
        scene::Scene::parse(scene::PAPER_ROBOT, "robot")
            .unwrap()
            .camera
    }

    fn tilted() -> Homography {
        Homography::of_pose(
            &camera(),
            &Pose {
                translation: [0.02, -0.03, 0.4],
                rotation: [0.4, -0.2, 0.5],
            },
        )
    }

    #[test]
    fn a_pose_is_seen_as_the_pinhole_says() {
        let pose = Pose {
            translation: [0.1, -0.2, 0.8],
            rotation: [0.0, 0.0, std::f64::consts::FRAC_PI_2],
        };
        let pixel = Homography::of_pose(&camera(), &pose)
            .apply([0.06, 0.03])
            .unwrap();
        // The quarter turn takes (0.06, 0.03) to (-0.03, 0.06).
        let expected = [320.0 + 615.0 * 0.07 / 0.8, 240.0 - 615.0 * 0.14 / 0.8];
        assert!(distance(pixel, expected) < 1e-9);
    }

    #[test]
    fn four_pairs_give_the_homography_back() {
        let points = [
            [-0.06, -0.045],
            [0.06, -0.045],
            [0.06, 0.045],
            [-0.06, 0.045],
        ];
        let pairs = points.map(|point| (point, tilted().apply(point).unwrap()));
        let found = Homography::through(&pairs, 0.06).unwrap();
        for point in [[0.01, 0.02], [-0.05, 0.03]] {
            let pixels = [found, tilted()].map(|h| h.apply(point).unwrap());
            assert!(distance(pixels[0], pixels[1]) < 1e-7);
        }
    }

    #[test]
    fn points_on_a_line_give_no_map() {
        let pairs = [0.0, 0.02, 0.04, 0.05].map(|x| ([x, 0.01], [100.0 + x, 5.0]));
        assert_eq!(Homography::through(&pairs, 0.05), None);
        assert_eq!(Homography::affine(&pairs[..3]), None);
    }

    #[test]
    fn a_disc_is_seen_where_its_rim_is() {
        let ellipse = tilted().disc([0.03, 0.02], 0.02).unwrap();
        let rim = (0..3600).map(|k| {
            let (sin, cos) = (f64::from(k) * std::f64::consts::PI / 1800.0).sin_cos();
            tilted()
                .apply([0.03 + 0.02 * cos, 0.02 + 0.02 * sin])
                .unwrap()
        });
        let (least, most) = rim.fold(([1e9f64; 2], [-1e9f64; 2]), |(a, b), p| {
            (
                [a[0].min(p[0]), a[1].min(p[1])],
                [b[0].max(p[0]), b[1].max(p[1])],
            )
        });
        for k in 0..2 {
            assert!((ellipse.center[k] - 0.5 * (least[k] + most[k])).abs() < 1e-3);
            assert!((ellipse.half[k] - 0.5 * (most[k] - least[k])).abs() < 1e-3);
        }
        // The centre of the ellipse is not the image of the disc's centre.
        assert!(distance(ellipse.center, tilted().apply([0.03, 0.02]).unwrap()) > 0.3);
    }

    #[test]
    fn there_and_back_is_where_it_was() {
        let back = tilted().inverse().unwrap();
        let pixel = tilted().apply([0.03, -0.01]).unwrap();
        let point = back.apply(pixel).unwrap();
        assert!(distance(point, [0.03, -0.01]) < 1e-12);
        let both = tilted().then(&back).apply([0.03, -0.01]).unwrap();
        assert!(distance(both, [0.03, -0.01]) < 1e-12);
    }
}
