//! Maps from the plane of the pattern (m) to the image (px).

use nalgebra::{Matrix3, Rotation3, Vector3};
use scene::{Camera, Pose};

/// A point of a plane: of the pattern (x, y), m, or of the image (u, v), px.
pub(crate) type Point = [f64; 2];

/// The map of a plane: (x, y, 1) -> w (u, v, 1).
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Homography(pub Matrix3<f64>);

impl Homography {
    /// How a camera sees the plane z = 0 of an object: K [r1 r2 t]; w is then the depth, m.
    pub fn of_pose(camera: &Camera, pose: &Pose) -> Self {
        let Camera { fx, fy, cx, cy, .. } = *camera;
        let mut columns = Rotation3::new(Vector3::from(pose.rotation)).into_inner();
        columns.set_column(2, &Vector3::from(pose.translation));
        Self(Matrix3::new(fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0) * columns)
    }

    /// Where a point is seen; none behind the camera.
    pub fn apply(&self, [x, y]: Point) -> Option<Point> {
        let x = self.0 * Vector3::new(x, y, 1.0);
        (x.z > 1e-9).then(|| [x.x / x.z, x.y / x.z])
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
}

#[cfg(test)]
mod tests {
    use super::*;

    fn camera() -> Camera {
        scene::Scene::parse(scene::PAPER_ROBOT, "robot")
            .unwrap()
            .camera
    }

    fn apart(a: Point, b: Point) -> f64 {
        (a[0] - b[0]).hypot(a[1] - b[1])
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
        assert!(apart(pixel, expected) < 1e-9);
    }

    #[test]
    fn there_and_back_is_where_it_was() {
        let pose = Pose {
            translation: [0.02, -0.03, 0.4],
            rotation: [0.4, -0.2, 0.5],
        };
        let there = Homography::of_pose(&camera(), &pose);
        let pixel = there.apply([0.03, -0.01]).unwrap();
        let point = there.inverse().unwrap().apply(pixel).unwrap();
        assert!(apart(point, [0.03, -0.01]) < 1e-12);
    }
}
