//! Maps from the plane of the pattern (m) to the image (px).

use scene::{Camera, Pose};

/// A point of a plane: of the pattern (x, y), m, or of the image (u, v), px.
pub(crate) type Point = [f64; 2];

/// The map of a plane: (x, y, 1) -> w (u, v, 1).
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Homography(pub [[f64; 3]; 3]);

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
        let [rx, ry, rz] = pose.rotation;
        let angle = (rx * rx + ry * ry + rz * rz).sqrt();
        let (sine, versine) = if angle < 1e-9 {
            (1.0, 0.5)
        } else {
            let half = (0.5 * angle).sin() / angle;
            (angle.sin() / angle, 2.0 * half * half)
        };
        let r1 = [
            1.0 - versine * (ry * ry + rz * rz),
            versine * rx * ry + sine * rz,
            versine * rx * rz - sine * ry,
        ];
        let r2 = [
            versine * rx * ry - sine * rz,
            1.0 - versine * (rx * rx + rz * rz),
            versine * ry * rz + sine * rx,
        ];
        let columns = [r1, r2, pose.translation];
        let row = |f: f64, c: f64, axis: usize| columns.map(|x| f * x[axis] + c * x[2]);
        Self([
            row(camera.fx, camera.cx, 0),
            row(camera.fy, camera.cy, 1),
            columns.map(|x| x[2]),
        ])
    }

    /// (wu, wv, w) of a point.
    fn homogeneous(&self, [x, y]: Point) -> [f64; 3] {
        self.0.map(|row| row[0] * x + row[1] * y + row[2])
    }

    /// Where a point is seen; none behind the camera.
    pub fn apply(&self, point: Point) -> Option<Point> {
        let [u, v, w] = self.homogeneous(point);
        (w > 1e-9).then(|| [u / w, v / w])
    }

    /// The derivative of the image point: [[du/dx, du/dy], [dv/dx, dv/dy]], px/m.
    pub fn jacobian(&self, point: Point) -> Option<[[f64; 2]; 2]> {
        let [u, v] = self.apply(point)?;
        let w = self.homogeneous(point)[2];
        let h = &self.0;
        let row = |row: usize, at: f64| [0, 1].map(|k| (h[row][k] - at * h[2][k]) / w);
        Some([row(0, u), row(1, v)])
    }

    /// How a disc is seen, by the dual of its conic; none where it is not wholly in front of the camera.
    pub fn disc(&self, center: Point, radius: f64) -> Option<Ellipse> {
        let c = self.homogeneous(center);
        let dual = |i: usize, j: usize| {
            let h = &self.0;
            c[i] * c[j] - radius * radius * (h[i][0] * h[j][0] + h[i][1] * h[j][1])
        };
        let scale = dual(2, 2);
        if c[2] < 1e-9 || scale < 1e-12 {
            return None;
        }
        let at = [0, 1].map(|k| dual(k, 2) / scale);
        let half = [0, 1].map(|k| (at[k] * at[k] - dual(k, k) / scale).max(0.0).sqrt());
        Some(Ellipse { center: at, half })
    }

    /// Between this map and another, element by element.
    pub fn between(&self, other: &Self, share: f64) -> Self {
        let mut mix = *self;
        for (row, others) in mix.0.iter_mut().zip(&other.0) {
            for (x, y) in row.iter_mut().zip(others) {
                *x += share * (y - *x);
            }
        }
        mix
    }

    /// The map back; none where the plane is seen edge-on.
    pub fn inverse(&self) -> Option<Self> {
        let h = &self.0;
        let minor = |r: [usize; 2], c: [usize; 2]| {
            h[r[0]][c[0]] * h[r[1]][c[1]] - h[r[0]][c[1]] * h[r[1]][c[0]]
        };
        let others = [[1, 2], [2, 0], [0, 1]];
        let cofactor = |i: usize, j: usize| minor(others[i], others[j]);
        let determinant: f64 = (0..3).map(|j| h[0][j] * cofactor(0, j)).sum();
        (determinant.abs() > 1e-12).then(|| {
            let element = |i: usize, j: usize| cofactor(j, i) / determinant;
            Self([0, 1, 2].map(|i| [0, 1, 2].map(|j| element(i, j))))
        })
    }

    /// The map through pairs (point of the pattern, image point): from four pairs on a homography, exact or least
    /// squares; none where the points do not fix it. `unit` is the size of the pattern, m.
    pub fn through(pairs: &[(Point, Point)], unit: f64) -> Option<Self> {
        if pairs.len() < 4 {
            return None;
        }
        let center = mean(pairs.iter().map(|pair| pair.1));
        let spread = pairs
            .iter()
            .map(|pair| distance(pair.1, center))
            .fold(1e-9, f64::max);
        let mut system = Normal::<8>::default();
        for ([x, y], pixel) in pairs {
            let (x, y) = (x / unit, y / unit);
            let (u, v) = (
                (pixel[0] - center[0]) / spread,
                (pixel[1] - center[1]) / spread,
            );
            system.add([x, y, 1.0, 0.0, 0.0, 0.0, -u * x, -u * y], u);
            system.add([0.0, 0.0, 0.0, x, y, 1.0, -v * x, -v * y], v);
        }
        let h = system.solve()?;
        let w = [h[6] / unit, h[7] / unit, 1.0];
        let row = |a: [f64; 3], c: f64| {
            let scaled = [a[0] / unit * spread, a[1] / unit * spread, a[2] * spread];
            [0, 1, 2].map(|k| scaled[k] + c * w[k])
        };
        Some(Self([
            row([h[0], h[1], h[2]], center[0]),
            row([h[3], h[4], h[5]], center[1]),
            w,
        ]))
    }

    /// The affine map through three pairs or more; none where they lie on a line.
    pub fn affine(pairs: &[(Point, Point)]) -> Option<Self> {
        if pairs.len() < 3 {
            return None;
        }
        let (from, to) = centers(pairs);
        let mut systems = [Normal::<2>::default(), Normal::<2>::default()];
        let unit = pairs
            .iter()
            .map(|pair| distance(pair.0, from))
            .fold(1e-12, f64::max);
        for (point, pixel) in pairs {
            let x = [(point[0] - from[0]) / unit, (point[1] - from[1]) / unit];
            systems[0].add(x, pixel[0] - to[0]);
            systems[1].add(x, pixel[1] - to[1]);
        }
        let [a, b] = systems.map(Normal::solve);
        let (a, b) = (a?, b?);
        Some(Self::linear(
            [a.map(|x| x / unit), b.map(|x| x / unit)],
            from,
            to,
        ))
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
    fn linear(a: [[f64; 2]; 2], from: Point, to: Point) -> Self {
        let shift = [0, 1].map(|k| to[k] - a[k][0] * from[0] - a[k][1] * from[1]);
        Self([
            [a[0][0], a[0][1], shift[0]],
            [a[1][0], a[1][1], shift[1]],
            [0.0, 0.0, 1.0],
        ])
    }

    /// This map first, `next` after it.
    pub fn then(&self, next: &Self) -> Self {
        let column = |j: usize, row: &[f64; 3]| (0..3).map(|k| row[k] * self.0[k][j]).sum();
        Self(next.0.map(|row| [0, 1, 2].map(|j| column(j, &row))))
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

/// Normal equations of a least-squares problem in N unknowns.
struct Normal<const N: usize> {
    a: [[f64; N]; N],
    b: [f64; N],
}

impl<const N: usize> Default for Normal<N> {
    fn default() -> Self {
        Self {
            a: [[0.0; N]; N],
            b: [0.0; N],
        }
    }
}

impl<const N: usize> Normal<N> {
    fn add(&mut self, row: [f64; N], right: f64) {
        for i in 0..N {
            for j in 0..N {
                self.a[i][j] += row[i] * row[j];
            }
            self.b[i] += row[i] * right;
        }
    }

    /// Cholesky's solution; none where the matrix is nearly singular.
    fn solve(mut self) -> Option<[f64; N]> {
        for j in 0..N {
            let diagonal = self.a[j][j];
            let pivot = diagonal - (0..j).map(|k| self.a[j][k].powi(2)).sum::<f64>();
            if pivot.is_nan() || pivot <= 1e-10 * diagonal.max(1e-6) {
                return None;
            }
            self.a[j][j] = pivot.sqrt();
            for i in j + 1..N {
                let sum: f64 = (0..j).map(|k| self.a[i][k] * self.a[j][k]).sum();
                self.a[i][j] = (self.a[i][j] - sum) / self.a[j][j];
            }
        }
        let mut x = self.b;
        for i in 0..N {
            let sum: f64 = (0..i).map(|k| self.a[i][k] * x[k]).sum();
            x[i] = (x[i] - sum) / self.a[i][i];
        }
        for i in (0..N).rev() {
            let sum: f64 = (i + 1..N).map(|k| self.a[k][i] * x[k]).sum();
            x[i] = (x[i] - sum) / self.a[i][i];
        }
        Some(x)
    }
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
