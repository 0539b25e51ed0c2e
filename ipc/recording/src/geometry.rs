//! Where the camera is, and where the goal lies in its image.

use scene::Scene;

/// A rotation as a quaternion (x, y, z, w).
pub(crate) type Quaternion = [f64; 4];

/// The quaternion of a rotation vector, rad.
pub(crate) fn quaternion(rotation: [f64; 3]) -> Quaternion {
    let [x, y, z] = rotation;
    let angle = (x * x + y * y + z * z).sqrt();
    // sin(a/2)/a, with its limit at 0.
    let share = if angle < 1e-9 {
        0.5
    } else {
        (0.5 * angle).sin() / angle
    };
    [share * x, share * y, share * z, (0.5 * angle).cos()]
}

fn rotate([qx, qy, qz, w]: Quaternion, [x, y, z]: [f64; 3]) -> [f64; 3] {
    // v + 2 q x (q x v + w v)
    let cross = |a: [f64; 3], b: [f64; 3]| {
        [
            a[1] * b[2] - a[2] * b[1],
            a[2] * b[0] - a[0] * b[2],
            a[0] * b[1] - a[1] * b[0],
        ]
    };
    let q = [qx, qy, qz];
    let inner = cross(q, [x, y, z]);
    let inner = [inner[0] + w * x, inner[1] + w * y, inner[2] + w * z];
    let outer = cross(q, inner);
    [x + 2.0 * outer[0], y + 2.0 * outer[1], z + 2.0 * outer[2]]
}

/// The camera in the object frame, from the object in the camera frame (m; rotation vector, rad).
pub(crate) fn camera_in_object(
    translation: [f64; 3],
    rotation: [f64; 3],
) -> ([f64; 3], Quaternion) {
    let back = quaternion(rotation.map(|x| -x));
    (rotate(back, translation).map(|x| -x), back)
}

/// The pattern's points in the image at the goal, px, by the pinhole model.
pub fn goal(scene: &Scene) -> Vec<[f64; 2]> {
    let turn = quaternion(scene.goal.rotation);
    let [tx, ty, tz] = scene.goal.translation;
    let camera = &scene.camera;
    let project = |point: &[f64; 3]| {
        let [x, y, z] = rotate(turn, *point);
        let (x, y, z) = (x + tx, y + ty, z + tz);
        [camera.cx + camera.fx * x / z, camera.cy + camera.fy * y / z]
    };
    scene.pattern.iter().map(project).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn close<const N: usize>(a: [f64; N], b: [f64; N]) -> bool {
        a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-12)
    }

    #[test]
    fn a_quarter_turn_about_the_optical_axis_takes_x_to_y() {
        let turn = quaternion([0.0, 0.0, std::f64::consts::FRAC_PI_2]);
        assert!(close(rotate(turn, [1.0, 0.0, 0.0]), [0.0, 1.0, 0.0]));
        assert!(close(
            rotate(quaternion([0.0; 3]), [1.0, 2.0, 3.0]),
            [1.0, 2.0, 3.0]
        ));
    }

    #[test]
    fn the_camera_in_the_object_frame_is_the_inverse_pose() {
        let (translation, rotation) = ([0.1, -0.2, 0.7], [0.3, -0.4, 1.1]);
        let (origin, turn) = camera_in_object(translation, rotation);
        // The camera's origin, taken back into the camera frame.
        let [x, y, z] = rotate(quaternion(rotation), origin);
        assert!(close([x + 0.1, y - 0.2, z + 0.7], [0.0; 3]));
        let there = rotate(quaternion(rotation), [1.0, 2.0, 3.0]);
        assert!(close(rotate(turn, there), [1.0, 2.0, 3.0]));
    }

    #[test]
    fn the_goal_of_the_papers_scene_is_a_square_about_the_middle() {
        let scene = Scene::parse(scene::PAPER_SIM, "sim").unwrap();
        let expected = [
            [312.0, 312.0],
            [712.0, 312.0],
            [712.0, 712.0],
            [312.0, 712.0],
        ];
        for (found, expected) in goal(&scene).into_iter().zip(expected) {
            assert!(close(found, expected), "{found:?}");
        }
    }
}
