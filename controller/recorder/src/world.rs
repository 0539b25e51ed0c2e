//! The world in 3D: the pattern, the goal, what the camera sees, its foreseen way, and the arm.
//!
//! Frames: `object` (the pattern), `camera`, and of an arm `flange` and `base`.

use std::f64::consts::PI;

use arm::{Arm, Chain, Joints};
use foxglove::messages::{
    Color, CubePrimitive, Duration, LinePrimitive, Point3, Pose, SceneEntity, SceneUpdate,
    SpherePrimitive, TextPrimitive, Timestamp, Vector3, line_primitive::Type,
};
use messages::CycleRecord;
use nalgebra::{DMatrix, Isometry3, Matrix3, Rotation3, RowVector3, Translation3, UnitQuaternion};
use scene::{Camera, Scene};

use crate::annotation::{BLUE, GREY, RED, SHADE, time};
use crate::scenery::CAMERA;

/// Frame of the pattern, which stands still.
pub(crate) const OBJECT: &str = "object";
/// Frame of the arm's flange.
pub(crate) const FLANGE: &str = "flange";
/// Frame of the arm's base.
pub(crate) const BASE: &str = "base";
/// Depth of the drawn part of what the camera sees, of the distance at the goal.
const DEPTH: f64 = 0.4;
/// Diameter of a point that has no size, of that distance.
const POINT: f64 = 0.02;
/// Thickness of the arm, m.
const ARM: f64 = 0.06;
/// Side of the drawn part of a wall, m.
const WALL: f64 = 1.5;
/// A foreseen way that is not foreseen again is gone after this time, s.
const FORESEEN: i32 = 1;

/// What stands still about the object: the pattern with its numbers, and the camera at the goal.
pub(crate) fn pattern(scene: &Scene, wall_ns: u64) -> SceneUpdate {
    let goal = Isometry3::new(scene.goal.translation.into(), scene.goal.rotation.into());
    let (side, ball) = (scene.marker_size, POINT * goal.translation.z);
    let mut entity = entity("pattern", OBJECT, time(wall_ns));
    for (number, &[x, y, z]) in scene.pattern.iter().enumerate() {
        let pose = at([x, y, z]);
        if side > 0.0 {
            let size = Some(vector([side, side, 1e-3]));
            let color = Some(BLUE);
            entity.cubes.push(CubePrimitive {
                pose: Some(pose),
                size,
                color,
            });
        } else {
            entity.spheres.push(sphere([x, y, z], ball, BLUE));
        }
        entity.texts.push(TextPrimitive {
            pose: Some(at([x, y, z - side.max(ball)])),
            billboard: true,
            font_size: side.max(2.0 * ball),
            color: Some(GREY),
            text: number.to_string(),
            ..TextPrimitive::default()
        });
    }
    let mut wanted = self::entity("goal", OBJECT, time(wall_ns));
    let corners = pyramid(scene).map(|corner| (goal.inverse() * corner).coords.into());
    wanted.lines.push(lines(Type::LineList, 1.0, RED, corners));
    update([entity, wanted])
}

/// What the camera sees, as a pyramid that moves with the camera.
pub(crate) fn frustum(scene: &Scene, wall_ns: u64) -> SceneUpdate {
    let mut entity = entity("frustum", CAMERA, time(wall_ns));
    let corners = pyramid(scene).map(|corner| corner.coords.into());
    entity.lines.push(lines(Type::LineList, 2.0, BLUE, corners));
    update([entity])
}

/// The foreseen way of the camera about the object; empty where none is foreseen.
pub(crate) fn foreseen(scene: &Scene, record: &CycleRecord, at: Option<Timestamp>) -> SceneUpdate {
    let mut ways: Vec<_> = record.foreseen().collect();
    let mut places = Vec::new();
    // Place by place: a point of each way.
    loop {
        let points: Vec<[f64; 2]> = ways.iter_mut().filter_map(Iterator::next).collect();
        match camera_in_object(&scene.camera, &scene.pattern, &points) {
            Some(camera) => places.push(camera.translation.vector.into()),
            None => break,
        }
    }
    let mut entity = entity("foreseen", OBJECT, at);
    entity.lifetime = Some(Duration::new(FORESEEN, 0));
    entity.lines.push(lines(Type::LineStrip, 3.0, RED, places));
    update([entity])
}

/// The arm at these joint positions, as a line through its joints in the base.
pub(crate) fn arm(q: [f64; arm::JOINTS], at: Option<Timestamp>) -> SceneUpdate {
    let places = Chain::FRANKA.places(&Joints::from(q));
    update([drawn(places.map(Into::into).to_vec(), at)])
}

/// An arm through these places in the base.
fn drawn(places: Vec<[f64; 3]>, at: Option<Timestamp>) -> SceneEntity {
    let mut entity = entity("arm", BASE, at);
    let spheres = places.iter().map(|&place| sphere(place, ARM, GREY));
    entity.spheres = spheres.collect();
    let line = lines(Type::LineStrip, ARM, GREY, places);
    entity.lines.push(LinePrimitive {
        scale_invariant: false,
        ..line
    });
    entity
}

/// A scene's arm at these joint positions, up to its camera, and its walls and boxes, in the base.
pub(crate) fn known_arm(
    known: &scene::Arm,
    q: [f64; arm::JOINTS],
    at: Option<Timestamp>,
) -> SceneUpdate {
    let places = Arm::from(known).chain.places(&Joints::from(q));
    let count = known.joints.len();
    let [first @ .., camera] = places;
    let places = first.into_iter().take(count + 1).chain([camera]);
    let mut arm = drawn(places.map(Into::into).collect(), at);
    let boxes = known.boxes.iter().map(cuboid);
    arm.cubes = known.walls.iter().map(wall).chain(boxes).collect();
    update([arm])
}

fn cuboid(known: &scene::Cuboid) -> CubePrimitive {
    let rows = known.rotation.map(RowVector3::from);
    let rotation = Rotation3::from_matrix_unchecked(Matrix3::from_rows(&rows));
    CubePrimitive {
        pose: Some(pose(&Isometry3::from_parts(
            Translation3::from(known.center),
            UnitQuaternion::from_rotation_matrix(&rotation),
        ))),
        size: Some(vector(known.half.map(|half| 2.0 * half))),
        color: Some(SHADE),
    }
}

/// A square of a wall, as near to the base as it gets.
fn wall(wall: &scene::Wall) -> CubePrimitive {
    let normal = nalgebra::Vector3::from(wall.normal);
    let turn = UnitQuaternion::rotation_between(&nalgebra::Vector3::z(), &normal);
    let half_turn = || UnitQuaternion::from_axis_angle(&nalgebra::Vector3::x_axis(), PI);
    let place = Translation3::from(normal * wall.offset);
    CubePrimitive {
        pose: Some(pose(&Isometry3::from_parts(
            place,
            turn.unwrap_or_else(half_turn),
        ))),
        size: Some(vector([WALL, WALL, 1e-3])),
        color: Some(SHADE),
    }
}

/// The flange in the base at these joint positions.
pub(crate) fn base_from_flange(q: [f64; arm::JOINTS]) -> Isometry3<f64> {
    isometry(&Chain::FRANKA.flange(&Joints::from(q)))
}

/// The same pose with a quaternion.
pub(crate) fn isometry(pose: &arm::Pose) -> Isometry3<f64> {
    Isometry3::from_parts(pose.translation, pose.rotation.into())
}

/// The eight edges of what the camera sees, two ends each, in the camera frame.
fn pyramid(scene: &Scene) -> impl Iterator<Item = nalgebra::Point3<f64>> + use<> {
    let Camera {
        width,
        height,
        fx,
        fy,
        cx,
        cy,
        ..
    } = scene.camera;
    let depth = DEPTH * scene.goal.translation[2];
    let (right, lower) = (width - 0.5, height - 0.5);
    let corners = [[-0.5, -0.5], [right, -0.5], [right, lower], [-0.5, lower]]
        .map(|[u, v]| nalgebra::Point3::new((u - cx) / fx, (v - cy) / fy, 1.0) * depth);
    let edges = move |k: usize| {
        [
            nalgebra::Point3::origin(),
            corners[k],
            corners[k],
            corners[(k + 1) % 4],
        ]
    };
    (0..4).flat_map(edges)
}

/// The camera in the object frame from points (u, v) of a flat pattern, px, by the homography of its
/// plane; `None` if they are too few or fix no pose.
pub(crate) fn camera_in_object(
    camera: &Camera,
    pattern: &[[f64; 3]],
    points: &[[f64; 2]],
) -> Option<Isometry3<f64>> {
    if points.len() != pattern.len() || points.len() < scene::MIN_POINTS {
        return None;
    }
    // Two equations for each point about the nine numbers of the homography, row by row.
    let mut system = DMatrix::zeros(2 * points.len().max(5), 9);
    for (k, ([x, y, _], [u, v])) in pattern.iter().zip(points).enumerate() {
        let (a, b) = ((u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy);
        let rows = [
            [*x, *y, 1.0, 0.0, 0.0, 0.0, -a * x, -a * y, -a],
            [0.0, 0.0, 0.0, *x, *y, 1.0, -b * x, -b * y, -b],
        ];
        for (i, row) in rows.iter().enumerate() {
            row.iter()
                .enumerate()
                .for_each(|(j, n)| system[(2 * k + i, j)] = *n);
        }
    }
    let right = system.try_svd(false, true, 1e-15, 1000)?.v_t?;
    let h = Matrix3::from_row_iterator(right.row(8).iter().copied());
    let scale = 2.0 / (h.column(0).norm() + h.column(1).norm());
    // The pattern is in front of the camera.
    let h = h * scale.copysign(h[(2, 2)]);
    let (x, y, place) = (h.column(0), h.column(1), h.column(2));
    let x = x.normalize();
    let y = (y - x * x.dot(&y)).normalize();
    let turn = Rotation3::from_matrix_unchecked(Matrix3::from_columns(&[x, y, x.cross(&y)]));
    let turn = UnitQuaternion::from_rotation_matrix(&turn);
    let object = Isometry3::from_parts(Translation3::from(place.into_owned()), turn);
    let is_finite = object.to_homogeneous().iter().all(|x| x.is_finite());
    is_finite.then(|| object.inverse())
}

fn update(entities: impl IntoIterator<Item = SceneEntity>) -> SceneUpdate {
    SceneUpdate {
        entities: entities.into_iter().collect(),
        ..SceneUpdate::default()
    }
}

/// Something in a frame, with which it moves.
fn entity(id: &str, frame: &str, at: Option<Timestamp>) -> SceneEntity {
    SceneEntity {
        timestamp: at,
        frame_id: frame.to_owned(),
        id: id.to_owned(),
        frame_locked: true,
        ..SceneEntity::default()
    }
}

/// Lines of a thickness in px.
fn lines(
    kind: Type,
    thickness: f64,
    color: Color,
    points: impl IntoIterator<Item = [f64; 3]>,
) -> LinePrimitive {
    let point = |[x, y, z]: [f64; 3]| Point3 { x, y, z };
    LinePrimitive {
        r#type: kind.into(),
        pose: Some(at([0.0; 3])),
        thickness,
        scale_invariant: true,
        points: points.into_iter().map(point).collect(),
        color: Some(color),
        ..LinePrimitive::default()
    }
}

fn sphere(center: [f64; 3], diameter: f64, color: Color) -> SpherePrimitive {
    SpherePrimitive {
        pose: Some(at(center)),
        size: Some(vector([diameter; 3])),
        color: Some(color),
    }
}

/// A place without a turn.
fn at(place: [f64; 3]) -> Pose {
    pose(&Isometry3::from_parts(
        place.into(),
        UnitQuaternion::identity(),
    ))
}

/// A pose as Foxglove has it.
pub(crate) fn pose(pose: &Isometry3<f64>) -> Pose {
    let turn = pose.rotation;
    Pose {
        position: Some(vector(pose.translation.vector.into())),
        orientation: Some(foxglove::messages::Quaternion {
            x: turn.i,
            y: turn.j,
            z: turn.k,
            w: turn.w,
        }),
    }
}

fn vector([x, y, z]: [f64; 3]) -> Vector3 {
    Vector3 { x, y, z }
}

#[cfg(test)]
mod tests {
    use nalgebra::Point3 as Place;

    use super::*;

    #[test]
    fn the_camera_is_found_from_the_points_that_it_sees() {
        let scene = Scene::parse(scene::PAPER_SIM, "sim").unwrap();
        for (place, turn) in [
            ([0.0, 0.0, 0.5], [0.0, 0.0, 0.0]),
            ([0.1, -0.2, 0.7], [0.3, -0.2, 1.1]),
            ([-0.05, 0.1, 0.4], [-0.1, 0.4, -2.5]),
        ] {
            let object = Isometry3::new(place.into(), turn.into());
            let seen = scene.pattern.iter().map(|point| {
                let p = object * Place::from(*point);
                let camera = &scene.camera;
                [
                    camera.cx + camera.fx * p.x / p.z,
                    camera.cy + camera.fy * p.y / p.z,
                ]
            });
            let seen: Vec<_> = seen.collect();
            let found = camera_in_object(&scene.camera, &scene.pattern, &seen).unwrap();
            assert!(
                (found * object.translation * object.rotation)
                    .translation
                    .vector
                    .norm()
                    < 1e-9
            );
            assert!(
                found.rotation.angle_to(&object.rotation.inverse()) < 1e-7,
                "{found}"
            );
            assert_eq!(
                camera_in_object(&scene.camera, &scene.pattern, &seen[1..]),
                None
            );
        }
        // Points that fell together fix nothing.
        let same = [[512.0, 512.0]; 4];
        let found = camera_in_object(&scene.camera, &scene.pattern, &same);
        assert!(found.is_none_or(|pose| pose.translation.vector.norm().is_finite()));
    }

    #[test]
    fn the_frustum_at_the_goal_goes_through_the_goals_camera() {
        let scene = Scene::parse(scene::PAPER_ROBOT, "robot").unwrap();
        let update = pattern(&scene, 0);
        let [pattern, goal] = &update.entities[..] else {
            panic!("{update:?}");
        };
        assert_eq!(pattern.spheres.len(), scene.pattern.len());
        let apex = &goal.lines[0].points[0];
        let camera = Isometry3::new(scene.goal.translation.into(), scene.goal.rotation.into());
        let at = camera * Place::new(apex.x, apex.y, apex.z);
        assert!(at.coords.norm() < 1e-12, "{at}");
        // It looks at the pattern: its far corners are nearer to it.
        let far = &goal.lines[0].points[1];
        assert!(far.z.abs() < apex.z.abs(), "{far:?}");
    }

    #[test]
    fn a_scenes_arm_ends_at_its_camera_and_has_its_walls() {
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../ipc/scene/scenes/s.toml");
        let text = format!("arm = 'panda.toml'\n{}", scene::PAPER_ROBOT);
        let mut known = Scene::parse(&text, path).unwrap().arm.unwrap();
        let (normal, offset) = ([0.0, -1.0, 0.0], -0.6);
        known.walls.push(scene::Wall { normal, offset }).unwrap();
        let update = known_arm(&known, arm::READY, None);
        let points = &update.entities[0].lines[0].points;
        let flange = base_from_flange(arm::READY).translation.vector;
        let camera = &points[8];
        let away = nalgebra::Vector3::new(camera.x, camera.y, camera.z) - flange;
        // 4 cm before the flange, 7 cm aside.
        assert!((away.norm() - 0.04f64.hypot(0.07)).abs() < 1e-9, "{away}");
        let wall = update.entities[0].cubes[0].pose.as_ref().unwrap();
        let place = wall.position.unwrap();
        assert_eq!((place.x, place.y, place.z), (0.0, 0.6, 0.0));
        let turn = wall.orientation.unwrap();
        let turn = nalgebra::Quaternion::new(turn.w, turn.x, turn.y, turn.z);
        let away = UnitQuaternion::from_quaternion(turn) * nalgebra::Vector3::z();
        assert!((away + nalgebra::Vector3::y()).norm() < 1e-9, "{away}");
        // With six joints, none is at the base's origin.
        known.joints.pop();
        let update = known_arm(&known, arm::READY, None);
        assert_eq!(update.entities[0].spheres.len(), 8);
    }

    #[test]
    fn the_arm_is_a_chain_from_the_base_to_the_flange() {
        let update = arm(arm::READY, None);
        let points = &update.entities[0].lines[0].points;
        assert_eq!((points.len(), points[0].x, points[0].z), (9, 0.0, 0.0));
        let flange = base_from_flange(arm::READY).translation.vector;
        let last = &points[8];
        assert_eq!([last.x, last.y, last.z], <[f64; 3]>::from(flange));
        // No link is longer than the upper arm with its offset.
        for pair in points.windows(2) {
            let step = [0, 1, 2].map(|k| {
                let of = |p: &Point3| [p.x, p.y, p.z][k];
                of(&pair[1]) - of(&pair[0])
            });
            assert!(
                step.iter().map(|x| x * x).sum::<f64>().sqrt() < 0.4,
                "{pair:?}"
            );
        }
    }
}
