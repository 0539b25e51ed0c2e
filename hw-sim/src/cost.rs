//! The paper's running cost of a command, by the emulator's own mathematics.

use scene::Scene;

use crate::camera::{Hidden, Points, project};
use crate::pose::{RigidPose, seen_after};

/// Share of the image width at which the weight of the velocity has its full value.
const FULL_R_DISTANCE: f64 = 0.25;

/// l(v) / Np: the command is held for `np` periods by a camera that sees the object at `pose`;
/// `goal` are the features there.
///
/// Source: paper, Eq. (cost), with the schedule of R as in `controller/vpc/METHOD.md`.
///
/// # Errors
/// [`Hidden`] where a point comes behind the camera.
pub fn running_cost(
    scene: &Scene,
    goal: &Points,
    pose: &RigidPose,
    twist: &[f64; 6],
    np: usize,
) -> Result<f64, Hidden> {
    let squares = |points: &Points| -> f64 {
        let pairs = points.iter().flatten().zip(goal.iter().flatten());
        pairs.map(|(s, goal)| (s - goal).powi(2)).sum()
    };
    let mean = squares(&project(scene, pose)?) / goal.len() as f64;
    let full = FULL_R_DISTANCE * scene.camera.width;
    let share = (mean / full.powi(2)).min(1.0);
    let weighted = scene.cost.r.iter().zip(twist).map(|(r, v)| r * v * v);
    let effort = share * weighted.sum::<f64>() * (np - 1) as f64;
    let mut error = 0.0;
    for j in 1..=np {
        let time_s = j as f64 * scene.sampling_time();
        error += squares(&project(scene, &seen_after(pose, twist, time_s))?);
    }
    Ok((scene.cost.k_q * error + effort) / np as f64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::FreeCamera;

    #[test]
    fn standing_costs_distance_and_moving_costs_velocity() {
        let scene = Scene::parse(scene::PAPER_SIM, "sim").unwrap();
        let goal = FreeCamera::new(&scene, &scene.goal).features().unwrap();
        let mut start = scene.goal;
        start.translation[2] *= 2.0;
        let camera = FreeCamera::new(&scene, &start);
        // At twice the distance all eight coordinates are off by 100 px.
        let cost = |twist, np| running_cost(&scene, &goal, &camera.pose, &twist, np).unwrap();
        let still = scene.cost.k_q * 8.0 * 100.0_f64.powi(2);
        assert!((cost([0.0; 6], 3) / still - 1.0).abs() < 1e-9);
        assert!((cost([0.0; 6], 30) / still - 1.0).abs() < 1e-9);
        // One step: no weight. A turn about the axis moves no point of the mean distance.
        let nearer = cost([0.0, 0.0, 0.3, 0.0, 0.0, 0.0], 1);
        assert!(nearer < still);
        let spin = cost([0.0, 0.0, 0.0, 0.0, 0.0, 1e-6], 3) - still;
        assert!(spin.abs() < 1e-3 * still);
        let there = FreeCamera::new(&scene, &scene.goal).pose;
        assert_eq!(
            running_cost(&scene, &goal, &there, &[0.0; 6], 3).unwrap(),
            0.0
        );
    }
}
