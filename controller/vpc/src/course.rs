//! The course that ways are refined on: what a step costs, and how that changes with pose and
//! command.
//!
//! | Symbol | Here | Meaning |
//! |---|---|---|
//! | T_k | `state` | the pattern in the camera frame before step k |
//! | v_k | `command` | the camera's velocity against the pattern in step k |
//! | T_k+1 = exp(-Ts v_k) T_k | [`Motion`] | the model |
//! | l(T_k, v_k) / Np | `Course::step` | the running cost by which futures are compared |
//! | c | `clearance` | clearance of a marker from a border, px |
//! | b(c) = mu (c / B - 1 - ln(c / B)) | [`Barrier`] | what it costs, below B |
//!
//! Source: J. Hauser and A. Saccon, "A barrier function method for the optimization of trajectory
//! functionals with constraints", CDC 2006, for the barrier that a parabola continues.

use nalgebra::{Matrix2, Matrix2x6, Matrix6, RowVector6, Vector2, Vector3, Vector6};
use serde::{Deserialize, Serialize};

use crate::clearance::Clearance;
use crate::cost::FULL_R_DISTANCE;
use crate::motion::{Motion, Sensitivity, rotation};
use crate::task::Task;
use crate::{DOF, Twist, camera, constraint, interaction};

/// Weight of the error that is left at the end, in steps.
const TERMINAL: f64 = 10.0;
/// B: the distance from a border below which a clearance costs, px.
const BAND: f64 = 24.0;

/// What a clearance costs.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Barrier {
    /// mu.
    pub weight: f64,
    /// The clearance below which a parabola continues it, px.
    pub depth: f64,
}

impl Barrier {
    /// Clearances cost nothing.
    pub const NONE: Self = Self {
        weight: 0.0,
        depth: BAND,
    };

    /// The barrier times another one, down to `last`.
    pub(crate) fn steeper(&self, by: &Self, last: &Self) -> Self {
        Self {
            weight: (self.weight * by.weight).max(last.weight),
            depth: (self.depth * by.depth).max(last.depth),
        }
    }

    /// Value, slope and curvature at a clearance, px.
    fn at(&self, clearance: f64) -> [f64; 3] {
        let Self { weight, depth } = *self;
        if clearance >= BAND {
            return [0.0; 3];
        }
        let at = clearance.max(depth);
        let below = clearance - at;
        let value = weight * (at / BAND - 1.0 - libm::log(at / BAND));
        let slope = weight * (1.0 / BAND - 1.0 / at);
        let curvature = weight / (at * at);
        [
            value + below * (slope + 0.5 * below * curvature),
            slope + below * curvature,
            curvature,
        ]
    }
}

/// What a way costs.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Worth {
    /// The sum of l(T_k, v_k) / Np, and the end.
    pub cost: f64,
    /// What the clearances cost.
    pub barrier: f64,
    /// The greatest violation, px.
    pub worst_px: f64,
}

impl Worth {
    /// All costs.
    pub fn merit(&self) -> f64 {
        self.cost + self.barrier
    }
}

/// The problem that ways are refined for.
#[derive(Clone, Copy, Debug)]
pub struct Course<'a> {
    /// Camera, pattern, goal, weights, occlusions.
    pub task: &'a Task,
    /// The pattern in the camera frame at the beginning.
    pub start: Motion,
    /// Least and greatest velocity of the camera against the pattern, m/s and rad/s.
    pub bounds: [Twist; 2],
    /// Steps of the window of l.
    pub np: usize,
    /// Steps of a way that count.
    pub steps: usize,
    /// Clearance that is kept, px.
    pub margin_px: f64,
    /// What clearances cost.
    pub barrier: Barrier,
    /// Share of its curvature that is added to that of a command.
    pub damping: f64,
}

/// A quadratic in a small motion of the pattern.
#[derive(Clone, Copy)]
pub(crate) struct Quadratic {
    pub slope: Vector6<f64>,
    pub curvature: Matrix6<f64>,
}

/// The derivatives of a step's cost, with the cost to go, in pose and command.
pub(crate) struct Stage {
    pub of_pose: Vector6<f64>,
    pub of_command: Vector6<f64>,
    pub pose: Matrix6<f64>,
    /// Command by pose.
    pub mixed: Matrix6<f64>,
    pub command: Matrix6<f64>,
}

impl Stage {
    /// Adds a quadratic of the pattern's pose after `motion`, which the command makes in `seconds`.
    fn add(&mut self, command: &Twist, seconds: f64, motion: &Motion, there: &Quadratic) {
        let by_pose = motion.adjoint();
        let by_command = Sensitivity::of_camera(command, seconds).square();
        self.of_pose += by_pose.transpose() * there.slope;
        self.of_command += by_command.transpose() * there.slope;
        let of_command = there.curvature * by_command;
        self.pose += by_pose.transpose() * (there.curvature * by_pose);
        self.mixed += of_command.transpose() * by_pose;
        self.command += by_command.transpose() * of_command;
    }
}

/// How a first guess leaves the straight way in its middle: where the pattern is then, in the
/// camera frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Detour {
    /// Its shift, m.
    pub aside: [f64; 3],
    /// Its turn about its own origin, an axis of the camera times an angle, rad.
    pub turn: [f64; 3],
}

impl Course<'_> {
    /// A command inside the bounds.
    pub(crate) fn within(&self, command: &Vector6<f64>) -> Twist {
        let [least, most] = self.bounds.map(Vector6::from);
        clamped(command, &least, &most).into()
    }

    /// A first guess: screws to the goal at full speed, by a detour.
    pub(crate) fn guess(&self, detour: &Detour, way: &mut [Twist]) {
        way.fill([0.0; DOF]);
        let goal = Motion {
            rotation: rotation(self.task.goal_pose.rotation),
            translation: self.task.goal_pose.translation.into(),
        };
        let whole = self.start.inverse().then(&goal).logarithm();
        let half = Motion::of_camera(&(whole * -0.5).into(), 1.0);
        let mut middle = self.start.then(&half);
        middle.rotation = rotation(detour.turn) * middle.rotation;
        middle.translation += Vector3::from(detour.aside);
        let (mut from, mut left) = (self.start, way);
        for to in [middle, goal] {
            let tau = from.inverse().then(&to).logarithm();
            let each = tau.iter().zip(&self.task.limits);
            let steps = each.map(|(tau, most)| tau.abs() / (most * self.task.ts));
            let steps = libm::ceil(steps.fold(1.0, f64::max));
            let twist = tau / (-steps * self.task.ts);
            let (these, others) = left.split_at_mut(left.len().min(steps as usize));
            these.fill(twist.into());
            (from, left) = (to, others);
        }
    }

    /// Adds to `worth` what a step costs; the pattern after it, or `None` where a point comes
    /// behind the camera.
    pub(crate) fn step(
        &self,
        state: &Motion,
        command: &Twist,
        worth: &mut Worth,
    ) -> Option<Motion> {
        let (task, np) = (self.task, self.np as f64);
        let half = Motion::of_camera(command, 0.5 * task.ts);
        let step = half.then(&half);
        let (mut now, mut later) = (0.0, 0.0);
        for (p, goal) in task.pattern.iter().zip(&task.goal) {
            let mut x = state.apply(&Vector3::from(*p));
            now += square(camera::project(&task.camera, x.into())?, goal);
            self.count(&half.apply(&x), worth)?;
            for j in 0..self.np {
                x = step.apply(&x);
                later += square(camera::project(&task.camera, x.into())?, goal);
                if j == 0 {
                    self.count(&x, worth)?;
                }
            }
        }
        let pairs = task.cost.r.iter().zip(command);
        let effort: f64 = pairs.map(|(r, v)| r * v * v).sum();
        let share = (now / self.full()).min(1.0);
        worth.cost += (task.cost.k_q * later + share * (np - 1.0) * effort) / np;
        Some(state.then(&step))
    }

    /// Adds to `worth` what is left at the end.
    pub(crate) fn end(&self, state: &Motion, worth: &mut Worth) -> Option<()> {
        let task = self.task;
        for (p, goal) in task.pattern.iter().zip(&task.goal) {
            let x = state.apply(&Vector3::from(*p));
            let pixel = camera::project(&task.camera, x.into())?;
            worth.cost += TERMINAL * task.cost.k_q * square(pixel, goal);
        }
        Some(())
    }

    /// The expansion of the end.
    pub(crate) fn expand_end(&self, state: &Motion) -> Quadratic {
        self.around(state, &Motion::REST, TERMINAL * self.task.cost.k_q, false)
    }

    /// The Gauss-Newton expansion of a step, with that of the cost to go after it.
    pub(crate) fn expand(&self, state: &Motion, command: &Twist, to_go: &Quadratic) -> Stage {
        let (task, np) = (self.task, self.np as f64);
        let points = task.pattern.iter().zip(&task.goal);
        let now: f64 = points
            .map(|(p, goal)| {
                let x = state.apply(&Vector3::from(*p));
                square(camera::pixel(&task.camera, [x.x / x.z, x.y / x.z]), goal)
            })
            .sum();
        // r = now / full, up to 1, weighs the effort.
        let (weight, r) = ((np - 1.0) / np, (now / self.full()).min(1.0));
        let weights = Vector6::from(task.cost.r);
        let pull = weights.component_mul(&Vector6::from(*command));
        let mut stage = Stage {
            of_pose: Vector6::zeros(),
            of_command: pull * (2.0 * weight * r),
            pose: Matrix6::zeros(),
            mixed: Matrix6::zeros(),
            command: Matrix6::from_diagonal(&(weights * (2.0 * weight * r))),
        };
        if r < 1.0 && r > 0.0 {
            let rise = self
                .around(state, &Motion::REST, 1.0 / self.full(), false)
                .slope;
            let of_root = rise * (0.5 / libm::sqrt(r));
            let effort = pull.dot(&Vector6::from(*command));
            stage.of_pose += rise * (weight * effort);
            stage.pose += of_root * of_root.transpose() * (2.0 * weight * effort);
            stage.mixed += pull * of_root.transpose() * (2.0 * weight * libm::sqrt(r));
        }
        let half = Motion::of_camera(command, 0.5 * task.ts);
        let halfway = self.around(state, &half, 0.0, true);
        if halfway.slope != Vector6::zeros() {
            stage.add(command, 0.5 * task.ts, &half, &halfway);
        }
        let step = half.then(&half);
        let mut motion = step;
        for j in 1..=self.np {
            let mut there = self.around(state, &motion, task.cost.k_q / np, j == 1);
            if j == 1 {
                there.slope += to_go.slope;
                there.curvature += to_go.curvature;
            }
            stage.add(command, j as f64 * task.ts, &motion, &there);
            motion = motion.then(&step);
        }
        stage
    }

    /// The expansion of k_q times the squared errors after a motion of the pattern, and of what the
    /// clearances cost there if they count.
    fn around(&self, state: &Motion, motion: &Motion, k_q: f64, has_borders: bool) -> Quadratic {
        let task = self.task;
        let mut found = Quadratic {
            slope: Vector6::zeros(),
            curvature: Matrix6::zeros(),
        };
        for (p, goal) in task.pattern.iter().zip(&task.goal) {
            let x = motion.apply(&state.apply(&Vector3::from(*p)));
            let pixel = camera::pixel(&task.camera, [x.x / x.z, x.y / x.z]);
            let error = Vector2::new(pixel[0] - goal[0], pixel[1] - goal[1]);
            let mut pull = error * (2.0 * k_q);
            let mut stiffness = Matrix2::from_diagonal_element(2.0 * k_q);
            if has_borders {
                for clearance in self.clearances(pixel, task.radius(x.z)) {
                    let [_, slope, curvature] = self.barrier.at(clearance.distance);
                    let normal = Vector2::from(clearance.normal);
                    pull += normal * slope;
                    stiffness += normal * normal.transpose() * curvature;
                }
            }
            let by_motion = slope(task, &x);
            found.slope += by_motion.transpose() * pull;
            found.curvature += by_motion.transpose() * (stiffness * by_motion);
        }
        found
    }

    /// Adds to `worth` what the clearances of a point at `x` (camera frame, m) cost.
    fn count(&self, x: &Vector3<f64>, worth: &mut Worth) -> Option<()> {
        let pixel = camera::project(&self.task.camera, (*x).into())?;
        for clearance in self.clearances(pixel, self.task.radius(x.z)) {
            let [value, ..] = self.barrier.at(clearance.distance);
            worth.barrier += value;
            worth.worst_px = worth.worst_px.max(-clearance.distance);
        }
        Some(())
    }

    /// The clearances of a marker that cost something, less the margin.
    fn clearances(&self, pixel: [f64; 2], radius: f64) -> impl Iterator<Item = Clearance> {
        let kept = self.margin_px + radius;
        let near = constraint::borders_near(self.task, [pixel; 2], kept + BAND);
        near.map(move |(_, border)| {
            let clearance = border.clearance(pixel);
            Clearance {
                distance: clearance.distance - kept,
                ..clearance
            }
        })
    }

    /// The sum of squared errors at which R has its full value, px^2.
    fn full(&self) -> f64 {
        let distance = FULL_R_DISTANCE * self.task.camera.width;
        self.task.pattern.len() as f64 * distance * distance
    }
}

/// How the pixel of a point at `x` (camera frame) changes with a small motion of the pattern.
fn slope(task: &Task, x: &Vector3<f64>) -> Matrix2x6<f64> {
    let [u, v] = interaction::of_point([x.x / x.z, x.y / x.z], x.z);
    Matrix2x6::from_rows(&[
        RowVector6::from(u) * -task.camera.fx,
        RowVector6::from(v) * -task.camera.fy,
    ])
}

/// The squared distance of two pixels, px^2.
fn square(a: [f64; 2], b: &[f64; 2]) -> f64 {
    (a[0] - b[0]) * (a[0] - b[0]) + (a[1] - b[1]) * (a[1] - b[1])
}

/// A vector inside its bounds.
pub(crate) fn clamped(x: &Vector6<f64>, least: &Vector6<f64>, most: &Vector6<f64>) -> Vector6<f64> {
    x.zip_zip_map(least, most, |x, least, most| x.max(least).min(most))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_expansion_has_the_slopes_of_the_cost() {
        let mut scene = scene::Scene::parse(scene::PAPER_SIM, "sim").unwrap();
        // The normal of an occlusion's part is exact at its border alone.
        scene.occlusions.clear();
        let task = Task::new(&scene).unwrap();
        // Points are near the left side, and the errors are small enough for r < 1.
        let course = Course {
            task: &task,
            start: Motion {
                rotation: rotation([0.1, -0.2, 0.3]),
                translation: [-0.15, 0.03, 0.6].into(),
            },
            bounds: [[-1.0; DOF], [1.0; DOF]],
            np: 3,
            steps: 1,
            margin_px: 80.0,
            barrier: Barrier {
                weight: 20.0,
                depth: 15.0,
            },
            damping: 0.0,
        };
        let command = [0.1, -0.2, 0.05, 0.3, -0.1, 0.2];
        let merit = |state: &Motion, command: &Twist| {
            let mut worth = Worth::default();
            let end = course.step(state, command, &mut worth).unwrap();
            course.end(&end, &mut worth).unwrap();
            assert!(worth.barrier > 0.0);
            worth.merit()
        };
        let end = course.start.then(&Motion::of_camera(&command, task.ts));
        let stage = course.expand(&course.start, &command, &course.expand_end(&end));
        for k in 0..DOF {
            let numeric = |at: &dyn Fn(f64) -> f64| (at(1e-6) - at(-1e-6)) / 2e-6;
            let by_command = numeric(&|h| {
                let mut command = command;
                command[k] += h;
                merit(&course.start, &command)
            });
            let by_pose = numeric(&|h| {
                let mut tau = [0.0; DOF];
                tau[k] = h;
                // The camera's motion by -tau moves the pattern by tau.
                let moved = Motion::of_camera(&tau.map(|tau| -tau), 1.0);
                merit(&course.start.then(&moved), &command)
            });
            for (exact, numeric) in [
                (stage.of_command[k], by_command),
                (stage.of_pose[k], by_pose),
            ] {
                assert!(
                    (exact - numeric).abs() < 1e-4 * (1.0 + numeric.abs()),
                    "{k} {exact} {numeric}"
                );
            }
        }
    }

    #[test]
    fn a_barrier_is_smooth_and_ends_where_it_should() {
        let barrier = Barrier {
            weight: 2.0,
            depth: 0.5,
        };
        for clearance in [-3.0, 0.2, 0.5, 0.7, 10.0, BAND - 1e-3, BAND, 30.0] {
            let [_, slope, _] = barrier.at(clearance);
            let [above, ..] = barrier.at(clearance + 1e-5);
            let [below, ..] = barrier.at(clearance - 1e-5);
            assert!(((above - below) / 2e-5 - slope).abs() < 1e-3, "{clearance}");
        }
        assert_eq!(barrier.at(BAND), [0.0; 3]);
    }
}
