//! Random starts: poses of the object in the camera frame, drawn from the scene's region.

use nalgebra::{Matrix3, Rotation3, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use scene::{Pose, Scene};
use vpc::features::signed_area;
use vpc::{Points, Task, constraint, task};

use crate::clearance;
use crate::mixture::Mixture;
use crate::reach::Reach;

/// Draws before a region is given up as having no valid start.
const MAX_DRAWS: usize = 100_000;

/// The scene's region holds no valid start.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error(
    "starts: none of {MAX_DRAWS} draws from the region is clear of image border and occlusions and far enough from \
     the goal, and within the reach of the scene's arm; allowed: a region, `clearance_px` and `min_error_px` that leave room"
)]
pub struct NoStart;

/// A number uniformly between `low` and `high`.
fn uniform(rng: &mut ChaCha8Rng, low: f64, high: f64) -> f64 {
    low + (high - low) * rng.random::<f64>()
}

/// A pose drawn uniformly from the region: a tilt about the image axes first, then a roll about the
/// optical axis.
pub fn draw(scene: &Scene, rng: &mut ChaCha8Rng) -> Pose {
    let region = &scene.starts;
    let translation =
        std::array::from_fn(|k| uniform(rng, region.translation_min[k], region.translation_max[k]));
    let mut within = |most: f64| uniform(rng, -most, most);
    let tilt = Vector3::new(within(region.tilt_max), within(region.tilt_max), 0.0);
    let roll = Vector3::new(0.0, 0.0, within(region.roll_max));
    let rotation = Rotation3::new(roll) * Rotation3::new(tilt);
    Pose {
        translation,
        rotation: rotation.scaled_axis().into(),
    }
}

/// The features of a start, where it meets the scene's conditions: every point with its marker
/// clear of border and occlusions, and far enough from the goal.
pub fn features_if_valid(scene: &Scene, task: &Task, pose: &Pose) -> Option<Points> {
    let region = &scene.starts;
    let points = task.features_at(pose)?;
    let radii = task::placed(&task.pattern, pose).map(|x| task.radius(x.z));
    let clear = points.iter().zip(radii).all(|(&pixel, radius)| {
        let distance = clearance::of_pixel(scene, pixel);
        let least = distance.min(constraint::border_clearance(task, pixel));
        distance > 0.0 && least >= region.clearance_px + radius
    });
    let mean: f64 = points
        .iter()
        .zip(&task.goal)
        .map(|(s, t)| (s[0] - t[0]).hypot(s[1] - t[1]))
        .sum::<f64>()
        / points.len() as f64;
    // The camera must see the front of the pattern.
    let facing = signed_area(&points) * signed_area(&task.goal) > 0.0;
    (clear && facing && mean >= region.min_error_px).then_some(points)
}

/// A valid start: from the failures' mixture where one is given, else from the whole region; where
/// the scene's arm is known, within its [reach](Reach).
///
/// # Errors
/// [`NoStart`] where the region holds none.
pub fn valid(
    scene: &Scene,
    task: &Task,
    near: Option<&Mixture>,
    rng: &mut ChaCha8Rng,
) -> Result<Pose, NoStart> {
    let reach = Reach::of(scene);
    let is_fit =
        |pose: &Pose| inside(scene, pose) && features_if_valid(scene, task, pose).is_some();
    for _ in 0..MAX_DRAWS {
        let pose = match near {
            Some(mixture) => pose_of(mixture.sample(rng)),
            None => draw(scene, rng),
        };
        if !is_fit(&pose) {
            continue;
        }
        let Some(reach) = &reach else {
            return Ok(pose);
        };
        if let Some(nearest) = reach.nearest(&pose).filter(is_fit) {
            return Ok(nearest);
        }
    }
    if near.is_some() {
        valid(scene, task, None, rng)
    } else {
        Err(NoStart)
    }
}

/// The first `count` valid starts of a seed, from the whole region: those of `vpc-memory starts`.
///
/// # Errors
/// [`NoStart`] where the region holds none.
pub fn drawn(scene: &Scene, task: &Task, count: usize, seed: u64) -> Result<Vec<Pose>, NoStart> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    (0..count)
        .map(|_| valid(scene, task, None, &mut rng))
        .collect()
}

/// A pose as the point of R^6 that mixtures are fitted to.
pub fn coordinates(pose: &Pose) -> [f64; 6] {
    let ([x, y, z], [rx, ry, rz]) = (pose.translation, pose.rotation);
    [x, y, z, rx, ry, rz]
}

fn pose_of([x, y, z, rx, ry, rz]: [f64; 6]) -> Pose {
    Pose {
        translation: [x, y, z],
        rotation: [rx, ry, rz],
    }
}

/// Whether a pose lies in the region (a mixture reaches beyond it).
fn inside(scene: &Scene, pose: &Pose) -> bool {
    let region = &scene.starts;
    let placed = (0..3).all(|k| {
        (region.translation_min[k]..=region.translation_max[k]).contains(&pose.translation[k])
    });
    // R = Rz(roll) R(tilt), tilt about an axis in the image plane: the third row of R holds the
    // tilt alone.
    let r: Matrix3<f64> = Rotation3::new(Vector3::from(pose.rotation)).into_inner();
    let angle = r[(2, 2)].clamp(-1.0, 1.0).acos();
    let axis = Vector3::new(r[(2, 1)], -r[(2, 0)], 0.0);
    let tilt = axis
        .try_normalize(1e-12)
        .map_or(Vector3::zeros(), |axis| axis * angle);
    let roll = (Rotation3::from_matrix_unchecked(r) * Rotation3::new(-tilt))
        .scaled_axis()
        .z;
    placed
        && tilt.x.abs() <= region.tilt_max + 1e-9
        && tilt.y.abs() <= region.tilt_max + 1e-9
        && roll.abs() <= region.roll_max + 1e-9
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;

    #[test]
    fn every_drawn_pose_is_in_its_region_and_a_foreign_one_is_not() {
        let scene = Scene::parse(scene::PAPER_SIM, "sim").unwrap();
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        for _ in 0..1000 {
            assert!(inside(&scene, &draw(&scene, &mut rng)));
        }
        let tilted = Pose {
            translation: [0.0, 0.0, 0.8],
            rotation: [0.8, 0.0, 0.0],
        };
        assert!(!inside(&scene, &tilted));
    }

    #[test]
    fn the_fixed_starts_are_valid_but_two() {
        let scene = Scene::parse(scene::PAPER_SIM, "sim").unwrap();
        let task = Task::new(&scene).unwrap();
        let starts = scene::parse_starts(scene::PAPER_SIM_STARTS, "sim").unwrap();
        assert_eq!(starts.len(), 100);
        let mut refused = Vec::new();
        for (i, start) in starts.iter().enumerate() {
            assert!(inside(&scene, start), "start {i}");
            if features_if_valid(&scene, &task, start).is_none() {
                let points = task.features_at(start).unwrap();
                let distances = points.iter().map(|&p| clearance::of_pixel(&scene, p));
                refused.push((i, distances.fold(f64::INFINITY, f64::min)));
            }
        }
        // Below the middle of the lowest bar and of the bar at the top, where every measure of
        // distance agrees: the list does not keep the scene's 20 px there.
        let [(27, lowest), (99, top)] = refused[..] else {
            panic!("{refused:?}")
        };
        assert!((lowest - 7.6447).abs() < 1e-4 && (top - 8.5235).abs() < 1e-4);
    }

    #[test]
    fn the_fixed_starts_of_the_tags_are_those_of_their_seed() {
        let scene = Scene::parse(scene::TAGS_ROBOT, "tags").unwrap();
        let task = Task::new(&scene).unwrap();
        let mut rng = ChaCha8Rng::seed_from_u64(15);
        for start in scene::parse_starts(scene::TAGS_ROBOT_STARTS, "tags").unwrap() {
            let drawn = coordinates(&valid(&scene, &task, None, &mut rng).unwrap());
            let pairs = coordinates(&start).into_iter().zip(drawn);
            assert!(pairs.into_iter().all(|(x, y)| (x - y).abs() < 1e-12));
        }
    }

    #[test]
    fn no_corner_of_a_marker_is_nearer_than_a_start_may_be() {
        let scene = Scene::parse(scene::TAGS_ROBOT, "tags").unwrap();
        let task = Task::new(&scene).unwrap();
        let half = 0.5 * scene.marker_size;
        let mut least = f64::INFINITY;
        for start in scene::parse_starts(scene::TAGS_ROBOT_STARTS, "tags").unwrap() {
            for [x, y, _] in scene.pattern.iter().copied() {
                for (a, b) in [(-half, -half), (half, -half), (half, half), (-half, half)] {
                    let corner = [[x + a, y + b, 0.0]];
                    let corner = task::placed(&corner, &start).next().unwrap();
                    let pixel = vpc::camera::project(&scene.camera, corner.into()).unwrap();
                    let border = constraint::border_clearance(&task, pixel);
                    least = least.min(clearance::of_pixel(&scene, pixel).min(border));
                }
            }
        }
        // A tilted marker beside the optical axis reaches a little further than its half diagonal.
        assert!((11.0..15.5).contains(&least), "{least}");
    }

    #[test]
    fn a_start_is_valid_from_the_scenes_clearance_on() {
        starts_beside_the_spot(0.0, [-10.0, 0.1, 19.9, 20.1]);
    }

    #[test]
    fn the_clearance_of_a_start_is_that_of_its_markers_edge() {
        // A square of 0.01 m, 1.2 m away, has a half diagonal of 4.71 px.
        starts_beside_the_spot(0.01, [0.1, 20.1, 24.6, 24.8]);
    }

    fn starts_beside_the_spot(marker_size: f64, distances: [f64; 4]) {
        let mut scene = Scene::parse(scene::PAPER_SIM, "sim").unwrap();
        scene.marker_size = marker_size;
        let task = Task::new(&scene).unwrap();
        // One corner beside the spot on the right, a circle about (850, 560) of radius 75 px; the
        // others in the open.
        let beside = |distance: f64| {
            let (u, v) = (850.0 - 75.0 - distance, 560.0);
            let pose = Pose {
                translation: [
                    (u - 512.0) / 800.0 * 1.2 - 0.15,
                    (v - 512.0) / 800.0 * 1.2 + 0.15,
                    1.2,
                ],
                rotation: [0.0; 3],
            };
            features_if_valid(&scene, &task, &pose).is_some()
        };
        assert_eq!(distances.map(beside), [false, false, false, true]);
    }
}
