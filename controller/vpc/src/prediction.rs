//! Prediction of the features over the preview window, with exact first derivatives.
//!
//! Source: paper, Eq. (model): s_j = s_{j-1} + Ts L_j v_j.

use heapless::Vec;
use libm::sqrt;
use nalgebra::Vector3;

use crate::motion::Motion;
use crate::task::Task;
use crate::{
    DOF, MAX_NP, MAX_POINTS, MAX_VARIABLES, Points, Twist, camera, features, interaction, pose,
};

/// How features move under a camera velocity.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum Model {
    /// The paper's: the interaction matrix with the depths that the points have at the goal.
    TargetDepth,
    /// The interaction matrix with one depth Z = Z* sqrt(a*/a), from the measured area; no more knowledge needed.
    AreaDepth,
    /// The paper's "global model": pose of the known pattern by homography, then exact rigid motion. Where no pose
    /// fits the features it falls back to [`Model::AreaDepth`] for the cycle.
    #[default]
    Pose,
}

/// A pose whose reprojection error is above this share of the pattern's size in the image does not explain the
/// features.
const POSE_RESIDUAL: f64 = 0.1;

/// Where the preview starts: the measured features, and what the model knows of their depth.
#[derive(Clone, Debug)]
pub struct Origin {
    /// Measured features, px.
    pub points: Points,
    knowledge: Knowledge,
}

#[derive(Clone, Debug)]
enum Knowledge {
    Depths(Vec<f64, MAX_POINTS>),
    Space(Vec<Vector3<f64>, MAX_POINTS>),
}

impl Origin {
    /// The start of a preview from measured features.
    pub fn new(task: &Task, model: Model, points: &Points) -> Self {
        let knowledge = match model {
            Model::TargetDepth => Knowledge::Depths(task.goal_depth.clone()),
            Model::AreaDepth => area_depth(task, points),
            Model::Pose => space(task, points).unwrap_or_else(|| area_depth(task, points)),
        };
        Self {
            points: points.clone(),
            knowledge,
        }
    }

    /// The depth of each point, m.
    pub fn depths(&self) -> Vec<f64, MAX_POINTS> {
        match &self.knowledge {
            Knowledge::Depths(depths) => depths.clone(),
            Knowledge::Space(points) => points.iter().map(|x| x.z).collect(),
        }
    }
}

fn area_depth(task: &Task, points: &Points) -> Knowledge {
    let area = features::area(points).max(1e-3 * task.goal_area);
    let ratio = sqrt(task.goal_area / area);
    Knowledge::Depths(task.goal_depth.iter().map(|z| z * ratio).collect())
}

fn space(task: &Task, points: &Points) -> Option<Knowledge> {
    let image: Vec<[f64; 2], MAX_POINTS> = points
        .iter()
        .map(|&p| camera::normalise(&task.camera, p))
        .collect();
    let estimate = pose::estimate(&task.pattern, &image)?;
    (estimate.residual <= POSE_RESIDUAL * sqrt(features::area(&image)))
        .then(|| Knowledge::Space(pose::points(&estimate, &task.pattern)))
}

/// A plan: `nc` camera velocities; the last one holds to the end of the window. Only the first `6 nc` entries count.
pub type Plan = [f64; MAX_VARIABLES];

/// Derivative of one feature component with respect to the plan.
pub type Gradient = [f64; MAX_VARIABLES];

/// The previewed features and their derivatives with respect to the plan.
#[derive(Clone, Debug)]
pub struct Preview {
    np: usize,
    nc: usize,
    count: usize,
    points: [[[f64; 2]; MAX_POINTS]; MAX_NP],
    gradients: [[[Gradient; 2]; MAX_POINTS]; MAX_NP],
}

/// A previewed point: its pixel and the derivative of each component with respect to the plan.
#[derive(Clone, Copy, Debug)]
pub struct Previewed<'a> {
    /// Where it is, px.
    pub pixel: [f64; 2],
    /// Derivatives of u and v.
    pub gradient: &'a [Gradient; 2],
}

impl Preview {
    /// A preview of `np` steps (1 to [`MAX_NP`]) and `nc` free commands (1 to [`crate::MAX_NC`], at most `np`).
    pub fn new(np: usize, nc: usize) -> Self {
        let np = np.clamp(1, MAX_NP);
        Self {
            np,
            nc: nc.clamp(1, crate::MAX_NC.min(np)),
            count: 0,
            points: [[[0.0; 2]; MAX_POINTS]; MAX_NP],
            gradients: [[[[0.0; MAX_VARIABLES]; 2]; MAX_POINTS]; MAX_NP],
        }
    }

    /// Steps previewed.
    pub fn np(&self) -> usize {
        self.np
    }

    /// Free commands.
    pub fn nc(&self) -> usize {
        self.nc
    }

    /// Variables of the plan: 6 nc.
    pub fn variables(&self) -> usize {
        DOF * self.nc
    }

    /// The command of step `j` (0 to np - 1) in a plan.
    pub fn block(&self, j: usize) -> usize {
        j.min(self.nc - 1)
    }

    /// The previewed points of step `j` (0 is one sampling time ahead), px.
    pub fn step(&self, j: usize) -> &[[f64; 2]] {
        self.points
            .get(j)
            .and_then(|step| step.get(..self.count))
            .unwrap_or(&[])
    }

    /// Every previewed point with its step.
    pub fn previewed(&self) -> impl Iterator<Item = (usize, Previewed<'_>)> {
        let steps = self
            .points
            .iter()
            .zip(&self.gradients)
            .take(self.np)
            .enumerate();
        steps.flat_map(move |(j, (points, gradients))| {
            points
                .iter()
                .zip(gradients)
                .take(self.count)
                .map(move |(&pixel, gradient)| (j, Previewed { pixel, gradient }))
        })
    }

    /// Predicts the features under `plan`. `false` where a point would come behind the camera, which no command of
    /// the arm may do: the caller treats the plan as impossible.
    #[must_use]
    pub fn run(&mut self, task: &Task, origin: &Origin, plan: &Plan) -> bool {
        self.predict::<true>(task, origin, plan)
    }

    /// As [`Preview::run`] without derivatives: those of an earlier plan stay behind.
    #[must_use]
    pub fn look(&mut self, task: &Task, origin: &Origin, plan: &Plan) -> bool {
        self.predict::<false>(task, origin, plan)
    }

    fn predict<const GRADIENTS: bool>(
        &mut self,
        task: &Task,
        origin: &Origin,
        plan: &Plan,
    ) -> bool {
        self.count = origin.points.len();
        match &origin.knowledge {
            Knowledge::Depths(depths) => {
                self.run_depths::<GRADIENTS>(task, &origin.points, depths, plan)
            }
            Knowledge::Space(points) => self.run_space::<GRADIENTS>(task, points, plan),
        }
    }

    fn command(plan: &Plan, block: usize) -> Twist {
        core::array::from_fn(|k| plan[DOF * block + k])
    }

    fn run_depths<const GRADIENTS: bool>(
        &mut self,
        task: &Task,
        points: &Points,
        depths: &[f64],
        plan: &Plan,
    ) -> bool {
        let (ts, n) = (task.ts, self.variables());
        for (i, (&point, &z)) in points.iter().zip(depths).enumerate() {
            let mut p = camera::normalise(&task.camera, point);
            let mut gradient = [[0.0; MAX_VARIABLES]; 2];
            for j in 0..self.np {
                let block = self.block(j);
                let v = Self::command(plan, block);
                let (velocity, slope) = interaction::flow(p, z, &v);
                if GRADIENTS {
                    let matrix = interaction::of_point(p, z);
                    for k in 0..n {
                        let (x, y) = (gradient[0][k], gradient[1][k]);
                        gradient[0][k] = x + ts * (slope[0][0] * x + slope[0][1] * y);
                        gradient[1][k] = y + ts * (slope[1][0] * x + slope[1][1] * y);
                    }
                    for k in 0..DOF {
                        gradient[0][DOF * block + k] += ts * matrix[0][k];
                        gradient[1][DOF * block + k] += ts * matrix[1][k];
                    }
                }
                p = [p[0] + ts * velocity[0], p[1] + ts * velocity[1]];
                self.points[j][i] = camera::pixel(&task.camera, p);
                if !GRADIENTS {
                    continue;
                }
                for k in 0..n {
                    self.gradients[j][i][0][k] = task.camera.fx * gradient[0][k];
                    self.gradients[j][i][1][k] = task.camera.fy * gradient[1][k];
                }
            }
        }
        true
    }

    fn run_space<const GRADIENTS: bool>(
        &mut self,
        task: &Task,
        points: &[Vector3<f64>],
        plan: &Plan,
    ) -> bool {
        let n = self.variables();
        let first = Motion::of_camera(&Self::command(plan, 0), task.ts);
        let mut motions = [first; crate::MAX_NC];
        for (block, motion) in motions.iter_mut().enumerate().take(self.nc).skip(1) {
            *motion = Motion::of_camera(&Self::command(plan, block), task.ts);
        }
        for (i, &start) in points.iter().enumerate() {
            let mut x = start;
            let mut gradient = [[0.0; MAX_VARIABLES]; 3];
            for j in 0..self.np {
                let block = self.block(j);
                let motion = &motions[block];
                x = motion.apply(&x);
                if x.z <= 1e-6 {
                    return false;
                }
                let iz = 1.0 / x.z;
                let (a, b) = (x.x * iz, x.y * iz);
                self.points[j][i] = camera::pixel(&task.camera, [a, b]);
                if !GRADIENTS {
                    continue;
                }
                let own = motion.derivative(&x);
                let r = &motion.rotation;
                for k in 0..n {
                    let g = [gradient[0][k], gradient[1][k], gradient[2][k]];
                    for row in 0..3 {
                        gradient[row][k] =
                            r[(row, 0)] * g[0] + r[(row, 1)] * g[1] + r[(row, 2)] * g[2];
                    }
                }
                for row in 0..3 {
                    for k in 0..DOF {
                        gradient[row][DOF * block + k] += own[row][k];
                    }
                }
                let (fx, fy) = (task.camera.fx * iz, task.camera.fy * iz);
                for k in 0..n {
                    self.gradients[j][i][0][k] = fx * (gradient[0][k] - a * gradient[2][k]);
                    self.gradients[j][i][1][k] = fy * (gradient[1][k] - b * gradient[2][k]);
                }
            }
        }
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn task() -> Task {
        Task::new(&scene::Scene::parse(scene::PAPER_SIM, "sim").unwrap()).unwrap()
    }

    fn points(task: &Task) -> Points {
        let pose = scene::Pose {
            translation: [0.1, -0.2, 0.9],
            rotation: [0.3, -0.2, 0.8],
        };
        task.features_at(&pose).unwrap()
    }

    #[test]
    fn gradients_match_finite_differences_in_every_model_and_horizon() {
        let task = task();
        let measured = points(&task);
        for model in [Model::TargetDepth, Model::AreaDepth, Model::Pose] {
            let origin = Origin::new(&task, model, &measured);
            for (np, nc) in [(1, 1), (3, 1), (12, 3), (30, 1)] {
                let mut plan = [0.0; MAX_VARIABLES];
                plan.iter_mut()
                    .enumerate()
                    .for_each(|(k, x)| *x = 0.3 * libm::sin(1.0 + k as f64));
                let mut exact = Box::new(Preview::new(np, nc));
                assert!(exact.run(&task, &origin, &plan));
                let mut other = Box::new(Preview::new(np, nc));
                for k in 0..exact.variables() {
                    let h = 1e-6;
                    let mut shifted = |h: f64| {
                        let mut moved = plan;
                        moved[k] += h;
                        assert!(other.run(&task, &origin, &moved));
                        other.step(np - 1).to_vec()
                    };
                    let (plus, minus) = (shifted(h), shifted(-h));
                    for i in 0..4 {
                        for c in 0..2 {
                            let numeric = (plus[i][c] - minus[i][c]) / (2.0 * h);
                            let analytic = exact.gradients[np - 1][i][c][k];
                            let scale = 1.0 + analytic.abs();
                            assert!(
                                (numeric - analytic).abs() < 1e-6 * scale,
                                "{model:?} {np} {k}"
                            );
                        }
                    }
                }
            }
        }
    }

    #[test]
    fn the_pose_model_is_exact() {
        let task = task();
        let start = scene::Pose {
            translation: [0.1, -0.2, 0.9],
            rotation: [0.3, -0.2, 0.8],
        };
        let measured = task.features_at(&start).unwrap();
        let origin = Origin::new(&task, Model::Pose, &measured);
        let v = [0.2, -0.1, 0.3, 0.4, -0.5, 0.9];
        let mut plan = [0.0; MAX_VARIABLES];
        plan[..6].copy_from_slice(&v);
        let mut preview = Box::new(Preview::new(20, 1));
        assert!(preview.run(&task, &origin, &plan));
        let motion = Motion::of_camera(&v, 20.0 * task.ts);
        let rotation = crate::motion::rotation(start.rotation);
        for (i, p) in task.pattern.iter().enumerate() {
            let x =
                motion.apply(&(rotation * Vector3::from(*p) + Vector3::from(start.translation)));
            let truth = camera::project(&task.camera, x.into()).unwrap();
            let predicted = preview.step(19)[i];
            assert!(
                (truth[0] - predicted[0]).abs() < 1e-6 && (truth[1] - predicted[1]).abs() < 1e-6
            );
        }
    }

    #[test]
    fn at_the_goal_the_three_models_agree_on_the_depths() {
        let task = task();
        for model in [Model::TargetDepth, Model::AreaDepth, Model::Pose] {
            for z in Origin::new(&task, model, &task.goal).depths() {
                assert!((z - 0.6).abs() < 1e-9);
            }
        }
    }
}
