//! Prediction of the features over a window, with exact first derivatives.
//!
//! | Symbol | Here | Meaning |
//! |---|---|---|
//! | s_j | [`Preview::step`] | features after step j, px; j = 0 is one sampling time ahead |
//! | V = (v_1 .. v_Nc) | `plan` | free commands; the last one is held to the end of the window |
//! | Np, Nc | `np`, `NC` | steps previewed, free commands |
//! | Ts | `task.ts` | length of a step, s |
//! | L | `interaction` | interaction matrix, for the depth models |
//! | X_j = exp(-Ts (v_j - d)) X_{j-1} | [`Motion`] | points in the camera frame, m, for [`Model::Pose`] |
//! | d | `drift` | twist of the pattern in the camera frame ([`crate::drift`]) |
//! | r_j = h / Z_j | `radius` | half the diagonal of a point's marker at its depth, px |
//!
//! Source: paper, Eq. (model): s_j = s_{j-1} + Ts L_j v_j.
#![expect(
    clippy::indexing_slicing,
    reason = "a dense kernel: np, nc and the count of points are bounded where they are set"
)]

use ::arm::Joints;
use heapless::Vec;
use libm::sqrt;
use nalgebra::Vector3;

use crate::clearance::Place;
use crate::motion::{Motion, Own, Sensitivity};
use crate::pose::{Estimate, Tilt};
use crate::span::Span;
use crate::task::Task;
use crate::workspace::Workspace;
use crate::{
    DOF, MAX_NP, MAX_POINTS, MAX_VARIABLES, Points, Twist, arm, camera, features, interaction, pose,
};

/// The radius of the marker of each point, px; zeros where markers are points.
pub type Radii = Vec<f64, MAX_POINTS>;

/// How features move under a camera velocity.
///
/// The first is the paper's: the interaction matrix with the depths that the points have at the
/// goal. The second has one depth Z = Z* sqrt(a*/a), and needs no more geometry. The third is the
/// paper's "global model": the pose by homography, then exact rigid motion; where no pose fits the
/// features it falls back to [`Model::AreaDepth`] for the cycle.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
#[cfg_attr(feature = "file", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "file", derive(schemars::JsonSchema))]
#[cfg_attr(feature = "file", serde(rename_all = "kebab-case"))]
pub enum Model {
    /// With the points' depths at the goal, as in the paper.
    TargetDepth,
    /// With one depth, from the area of the features.
    AreaDepth,
    /// By the pose of the known pattern.
    #[default]
    Pose,
}

/// A pose whose reprojection error is above this share of the pattern's size in the image does not
/// explain the features.
const POSE_RESIDUAL: f64 = 0.1;

/// Where the preview starts: the measured features, and what the model knows of their depth.
#[derive(Clone, Debug)]
pub struct InitialState {
    /// Measured features, px.
    pub points: Points,
    geometry: Geometry,
    /// Which of two poses is believed; `None` where none is known.
    pub(crate) tilt: Option<Tilt>,
    /// How the pattern moves by itself.
    pub(crate) drift: Own,
    /// The joints of the arm, where it is known.
    pub(crate) q: Option<Joints>,
    /// Velocity of the arm's elbow from here on, rad/s.
    pub(crate) elbow: f64,
}

/// Longest step with which the motion of a depth model is integrated, as a share of the sampling
/// time.
const STEP: f64 = 0.5;
/// Most of these steps, so that the work is bounded.
const MOST_STEPS: f64 = 128.0;
/// Normalised image coordinates beyond this are no image any more.
const NO_IMAGE: f64 = 1e3;

#[derive(Clone, Debug)]
enum Geometry {
    /// Depth of each point, m.
    Depths(Vec<f64, MAX_POINTS>),
    /// Each point in the camera frame, m.
    Positions(Vec<Vector3<f64>, MAX_POINTS>),
}

impl InitialState {
    /// The start of a preview from measured features.
    pub fn new(task: &Task, model: Model, points: &Points) -> Self {
        Self::turned(task, model, points, None)
    }

    /// As [`InitialState::new`], with the evidence of earlier images for one of two poses.
    pub fn turned(task: &Task, model: Model, points: &Points, before: Option<&Tilt>) -> Self {
        let pose = match model {
            Model::Pose => pose_of(task, points, before),
            Model::TargetDepth | Model::AreaDepth => None,
        };
        let geometry = match (&pose, model) {
            (Some((pose, _)), _) => Geometry::Positions(pose::points(pose, &task.pattern)),
            (None, Model::TargetDepth) => Geometry::Depths(task.goal_depth.clone()),
            (None, Model::AreaDepth | Model::Pose) => area_depth(task, points),
        };
        Self {
            points: points.clone(),
            geometry,
            tilt: pose.map(|(_, tilt)| tilt),
            drift: Own::NONE,
            q: None,
            elbow: 0.0,
        }
    }

    /// The same with a pattern that moves by itself.
    pub fn with_drift(mut self, drift: Own) -> Self {
        self.drift = drift;
        self
    }

    /// The same with these joints of the arm.
    pub(crate) fn with_joints(mut self, q: Option<Joints>) -> Self {
        self.q = q;
        self
    }

    /// The same with an elbow that turns so from here on, rad/s.
    pub(crate) fn with_elbow(mut self, elbow: f64) -> Self {
        self.elbow = elbow;
        self
    }

    /// The same with a pattern at rest.
    pub(crate) fn without_drift(self) -> Self {
        self.with_drift(Own::NONE)
    }

    /// The pose of the pattern in the camera frame, where the model knows one.
    pub(crate) fn pose(&self, task: &Task) -> Option<Estimate> {
        let tilt = self.tilt.as_ref()?;
        Some(pose_of(task, &self.points, Some(tilt))?.0)
    }

    /// The twist of a camera at `twist` against the pattern.
    pub(crate) fn relative(&self, twist: &Twist) -> Twist {
        core::array::from_fn(|k| twist[k] - self.drift.twist[k])
    }

    /// The depth of each point, m.
    pub fn depths(&self) -> Vec<f64, MAX_POINTS> {
        match &self.geometry {
            Geometry::Depths(depths) => depths.clone(),
            Geometry::Positions(points) => points.iter().map(|x| x.z).collect(),
        }
    }

    /// The radius of each point's [marker](Task::radius), px.
    pub fn radii(&self, task: &Task) -> Radii {
        let radius = |depth: f64| task.radius(depth);
        match &self.geometry {
            Geometry::Depths(depths) => depths.iter().copied().map(radius).collect(),
            Geometry::Positions(points) => points.iter().map(|x| radius(x.z)).collect(),
        }
    }

    /// The features as the model explains them, px: for [`Model::Pose`] the projection of the
    /// pattern at its pose, else the measured ones themselves.
    pub fn explained(&self, task: &Task) -> Points {
        match &self.geometry {
            Geometry::Depths(_) => self.points.clone(),
            Geometry::Positions(points) => seen(task, points),
        }
    }

    /// The initial state after the camera has moved at `twist` for `seconds`. What the model does
    /// not explain of the features stays with them. `None` if a point would be behind the camera or
    /// far outside any image.
    pub fn moved(&self, task: &Task, model: Model, twist: &Twist, seconds: f64) -> Option<Self> {
        let (arm, joints) = (task.arm.as_ref(), self.q.as_ref());
        let q = arm::moved(arm, joints, twist, self.elbow, seconds);
        let twist = &arm::carried(arm, joints, twist, seconds);
        let drift = self.drift.after(0.5 * seconds).twist;
        let relative = core::array::from_fn(|k| twist[k] - drift[k]);
        let drift = match self.drift.is_none() {
            true => Own::NONE,
            false => {
                let motion = Motion::of_camera(twist, seconds);
                self.drift.after(seconds).carried(&motion)
            }
        };
        match &self.geometry {
            Geometry::Positions(before) => {
                let motion = Motion::of_camera(&relative, seconds);
                let after: Vec<_, MAX_POINTS> = before.iter().map(|x| motion.apply(x)).collect();
                let in_front = |x: &Vector3<f64>| x.z > 1e-6;
                let moves = seen(task, before).into_iter().zip(seen(task, &after));
                let pairs = self.points.iter().zip(moves);
                after.iter().all(in_front).then(|| Self {
                    points: pairs
                        .map(|(s, (b, a))| [a[0] + (s[0] - b[0]), a[1] + (s[1] - b[1])])
                        .collect(),
                    geometry: Geometry::Positions(after),
                    tilt: self.tilt.map(|tilt| Tilt {
                        normal: (motion.rotation * Vector3::from(tilt.normal)).into(),
                        ..tilt
                    }),
                    drift,
                    q,
                    elbow: self.elbow,
                })
            }
            Geometry::Depths(_) => {
                let steps = libm::ceil(seconds / (STEP * task.period)).clamp(1.0, MOST_STEPS);
                let mut initial = self.clone();
                for _ in 0..steps as u32 {
                    initial = initial.integrated(task, model, &relative, seconds / steps)?;
                }
                Some(initial.with_drift(drift).with_joints(q))
            }
        }
    }

    /// Where the points are after so many seconds under `twist`, px, and the radii of their markers
    /// there; `None` if one comes behind the camera.
    pub(crate) fn ends(&self, task: &Task, twist: &Twist, seconds: f64) -> Option<(Points, Radii)> {
        let camera = &task.camera;
        let twist = &self.relative(twist);
        match &self.geometry {
            Geometry::Positions(points) => {
                let motion = Motion::of_camera(twist, seconds);
                let (mut ends, mut radii) = (Points::new(), Radii::new());
                for x in points.iter().map(|x| motion.apply(x)) {
                    ends.extend([camera::project(camera, x.into())?]);
                    radii.extend([task.radius(x.z)]);
                }
                Some((ends, radii))
            }
            Geometry::Depths(depths) => {
                let ends = self.points.iter().zip(depths).map(|(&pixel, &depth)| {
                    let at = camera::normalise(camera, pixel);
                    let (rate, _) = interaction::flow(at, depth, twist);
                    let end = [at[0] + seconds * rate[0], at[1] + seconds * rate[1]];
                    camera::pixel(camera, end)
                });
                Some((ends.collect(), self.radii(task)))
            }
        }
    }

    /// Where the preview has the wanted points after a share of their way under `twist`, which
    /// takes so many seconds and ends at `ends`: (u, v) and the radius of the marker, px. `false` if
    /// one comes behind the camera.
    #[must_use]
    pub(crate) fn passes(
        &self,
        task: &Task,
        twist: &Twist,
        (share, seconds): (f64, f64),
        ends: &[[f64; 2]],
        wanted: &[bool],
        out: &mut [[f64; 3]],
    ) -> bool {
        let motion = match &self.geometry {
            Geometry::Positions(_) => Motion::of_camera(&self.relative(twist), share * seconds),
            Geometry::Depths(_) => Motion::REST,
        };
        let points = out.iter_mut().zip(wanted).enumerate();
        for (i, (out, _)) in points.filter(|(_, (_, wanted))| **wanted) {
            *out = match (&self.geometry, self.points.get(i), ends.get(i)) {
                (Geometry::Positions(points), ..) => {
                    let Some(x) = points.get(i) else { continue };
                    let x = motion.apply(x);
                    if x.z <= 1e-6 {
                        return false;
                    }
                    let [u, v] = camera::pixel(&task.camera, [x.x / x.z, x.y / x.z]);
                    [u, v, task.radius(x.z)]
                }
                (Geometry::Depths(depths), Some(a), Some(b)) => {
                    let [u, v] = core::array::from_fn(|c| a[c] + share * (b[c] - a[c]));
                    let depth = depths.get(i);
                    debug_assert!(depth.is_some(), "point {i} has no depth");
                    [u, v, depth.map_or(0.0, |&depth| task.radius(depth))]
                }
                _ => continue,
            };
        }
        true
    }

    /// Derivatives of u and v of a point after a share of its way by `twist`, which takes so long,
    /// and of the radius of its marker.
    pub(crate) fn passing_gradient(
        &self,
        task: &Task,
        twist: &Twist,
        (share, span): (f64, &Span),
        point: usize,
    ) -> ([Twist; 2], Twist) {
        let seconds = share * span.seconds;
        let focal = [task.camera.fx, task.camera.fy];
        let ([mut u, mut v], mut radius) = match &self.geometry {
            Geometry::Positions(points) => {
                let twist = &self.relative(twist);
                let x = Motion::of_camera(twist, seconds).apply(&points[point]);
                let [a, b, c] = Sensitivity::of_camera(twist, seconds).at(&x);
                let slope = |focal: f64, along: &Twist, at: f64| {
                    core::array::from_fn(|k| focal / x.z * (along[k] - at / x.z * c[k]))
                };
                let radius = c.map(|c| -task.radius(x.z) / x.z * c);
                ([slope(focal[0], &a, x.x), slope(focal[1], &b, x.y)], radius)
            }
            Geometry::Depths(depths) => {
                let at = camera::normalise(&task.camera, self.points[point]);
                let [u, v] = interaction::of_point(at, depths[point]);
                let pixel = [
                    u.map(|g| focal[0] * seconds * g),
                    v.map(|g| focal[1] * seconds * g),
                ];
                // The depths of these models stay as they are over the window.
                (pixel, [0.0; DOF])
            }
        };
        let relative = self.relative(twist);
        for gradient in [&mut u, &mut v, &mut radius] {
            span.lengthen(gradient, &relative);
        }
        ([u, v], radius)
    }

    /// One step of a depth model by the midpoint rule.
    fn integrated(&self, task: &Task, model: Model, v: &Twist, h: f64) -> Option<Self> {
        let slide = |from: &Points, at: &Self, h: f64| -> Option<Points> {
            let depths = at.depths();
            let pairs = from.iter().zip(at.points.iter().zip(&depths));
            let slid = pairs.map(|(&start, (&point, &z))| {
                let start = camera::normalise(&task.camera, start);
                let (rate, _) = interaction::flow(camera::normalise(&task.camera, point), z, v);
                let end = [start[0] + h * rate[0], start[1] + h * rate[1]];
                // Written so that a NaN fails.
                (end[0].abs() < NO_IMAGE && end[1].abs() < NO_IMAGE)
                    .then(|| camera::pixel(&task.camera, end))
            });
            slid.collect()
        };
        let at = |points: Points| {
            let geometry = match model {
                Model::TargetDepth => self.geometry.clone(),
                Model::AreaDepth | Model::Pose => area_depth(task, &points),
            };
            Self {
                points,
                geometry,
                tilt: None,
                drift: self.drift,
                q: None,
                elbow: 0.0,
            }
        };
        let middle = at(slide(&self.points, self, 0.5 * h)?);
        Some(at(slide(&self.points, &middle, h)?))
    }
}

/// Pixels of points in the camera frame that are in front of it.
fn seen(task: &Task, points: &[Vector3<f64>]) -> Points {
    let see = |x: &Vector3<f64>| camera::pixel(&task.camera, [x.x / x.z, x.y / x.z]);
    points.iter().map(see).collect()
}

fn area_depth(task: &Task, points: &Points) -> Geometry {
    let area = features::area(points).max(1e-3 * task.goal_area);
    let ratio = sqrt(task.goal_area / area);
    Geometry::Depths(task.goal_depth.iter().map(|z| z * ratio).collect())
}

/// The pose of the pattern, if one explains the features.
fn pose_of(task: &Task, points: &Points, before: Option<&Tilt>) -> Option<(Estimate, Tilt)> {
    let image: Vec<[f64; 2], MAX_POINTS> = points
        .iter()
        .map(|&p| camera::normalise(&task.camera, p))
        .collect();
    let found = pose::estimate(&task.pattern, &image, before)?;
    (found.0.residual <= POSE_RESIDUAL * sqrt(features::area(&image))).then_some(found)
}

/// A plan: `nc` camera velocities; the last one holds to the end of the window. Only the first `6
/// nc` entries count.
pub type Plan = [f64; MAX_VARIABLES];

/// The plan that repeats one twist.
///
/// Source: paper, Eq. (warm_start).
pub(crate) fn repeated(twist: &Twist) -> Plan {
    let mut plan = [0.0; MAX_VARIABLES];
    plan.chunks_exact_mut(DOF)
        .for_each(|command| command.copy_from_slice(twist));
    plan
}

/// The previewed features and their derivatives with respect to the first `N = 6 nc` entries of the
/// plan, in a workspace that the caller lends.
#[derive(Debug)]
pub struct Preview<'w, const N: usize> {
    np: usize,
    /// Points that there is room for in each step.
    room: usize,
    /// Points of the present preview, at most `room`.
    count: usize,
    /// Point i after step j is at `j * room + i`, here and in the other arrays.
    points: &'w mut [[f64; 2]],
    gradients: &'w mut [[[f64; N]; 2]],
    radii: &'w mut [f64],
    /// Derivatives of those radii that are not zero.
    growths: &'w mut [[f64; N]],
}

/// A previewed point, and the derivatives of its pixel and of its marker's radius with respect to
/// the plan.
#[derive(Clone, Copy, Debug)]
pub struct Previewed<'a, const N: usize> {
    /// Where it is.
    pub place: Place,
    /// Derivatives of u and v.
    pub gradient: &'a [[f64; N]; 2],
    /// Derivative of the radius; means nothing where that is zero.
    pub growth: &'a [f64; N],
}

impl<'w, const N: usize> Preview<'w, N> {
    /// Free commands.
    const NC: usize = N / DOF;

    /// Numbers of workspace for a preview of `np` steps (1 to [`MAX_NP`]) and `points` points.
    pub const fn room(np: usize, points: usize) -> usize {
        np * points * (2 + 2 * N + 1 + N)
    }

    /// A preview of `np` steps (1 to [`MAX_NP`]) and at most `points` points, in a workspace of
    /// [`Preview::room`] numbers; `None` if that is too short.
    pub fn new(np: usize, points: usize, workspace: &'w mut [f64]) -> Option<Self> {
        Self::cut(np, points, &mut Workspace(workspace))
    }

    pub(crate) fn cut(np: usize, points: usize, workspace: &mut Workspace<'w>) -> Option<Self> {
        let np = np.clamp(1, MAX_NP);
        let places = np * points;
        Some(Self {
            np,
            room: points,
            count: 0,
            points: workspace.arrays(places)?,
            gradients: workspace.arrays(2 * places)?.as_chunks_mut().0,
            radii: workspace.numbers(places)?,
            growths: workspace.arrays(places)?,
        })
    }

    /// Steps previewed.
    pub fn np(&self) -> usize {
        self.np
    }

    /// Where the command of step `j` (0 to np - 1) begins in the plan.
    pub fn offset(&self, j: usize) -> usize {
        DOF * j.min(Self::NC - 1)
    }

    /// The previewed points of step `j` (0 to np - 1; 0 is one sampling time ahead), px.
    pub fn step(&self, j: usize) -> &[[f64; 2]] {
        self.of_step(self.points, j)
    }

    /// The radii of their markers, px.
    pub fn radii(&self, j: usize) -> &[f64] {
        self.of_step(self.radii, j)
    }

    /// What one of the arrays holds of step `j`.
    fn of_step<'a, T>(&self, array: &'a [T], j: usize) -> &'a [T] {
        let from = j * self.room;
        let found = array.get(from..from + self.count);
        debug_assert!(found.is_some(), "step {j} of {}", self.np);
        found.unwrap_or(&[])
    }

    /// What one of the arrays holds of each step.
    fn by_step<'a, T>(&self, array: &'a [T]) -> impl Iterator<Item = &'a [T]> + use<'a, T, N> {
        array.chunks_exact(self.room.max(1))
    }

    /// The previewed points of step `j` with their markers.
    pub fn places(&self, j: usize) -> impl Iterator<Item = Place> {
        let pairs = self.step(j).iter().zip(self.radii(j));
        pairs.map(|(&pixel, &radius)| Place { pixel, radius })
    }

    /// The previewed points of every step, with their derivatives, step by step.
    pub fn steps(&self) -> impl Iterator<Item = impl Iterator<Item = Previewed<'_, N>>> {
        let places = self.by_step(self.points).zip(self.by_step(self.radii));
        let derivatives = self.by_step(self.gradients).zip(self.by_step(self.growths));
        places.zip(derivatives).map(|(places, derivatives)| {
            let places = places.0.iter().zip(places.1);
            let derivatives = derivatives.0.iter().zip(derivatives.1);
            let points = places.zip(derivatives).take(self.count);
            points.map(|((&pixel, &radius), (gradient, growth))| Previewed {
                place: Place { pixel, radius },
                gradient,
                growth,
            })
        })
    }

    /// Predicts the features under `plan`. Returns `false` if a point would come behind the camera:
    /// the caller treats the plan as impossible.
    #[must_use]
    pub fn linearize(
        &mut self,
        task: &Task,
        initial: &InitialState,
        plan: &[f64; N],
        ts: f64,
    ) -> bool {
        self.predict::<true>(task, initial, plan, ts)
    }

    /// As [`Preview::linearize`] without derivatives: those of an earlier plan stay behind.
    #[must_use]
    pub fn evaluate(
        &mut self,
        task: &Task,
        initial: &InitialState,
        plan: &[f64; N],
        ts: f64,
    ) -> bool {
        self.predict::<false>(task, initial, plan, ts)
    }

    fn predict<const GRADIENTS: bool>(
        &mut self,
        task: &Task,
        initial: &InitialState,
        plan: &[f64; N],
        ts: f64,
    ) -> bool {
        self.count = initial.points.len().min(self.room);
        match &initial.geometry {
            Geometry::Depths(depths) => {
                self.move_image_points::<GRADIENTS>(task, initial, (depths, ts), plan)
            }
            Geometry::Positions(points) => {
                self.move_points::<GRADIENTS>(task, initial, (points, ts), plan)
            }
        }
    }

    fn command(plan: &[f64; N], offset: usize) -> Twist {
        core::array::from_fn(|k| plan[offset + k])
    }

    fn move_image_points<const GRADIENTS: bool>(
        &mut self,
        task: &Task,
        initial: &InitialState,
        (depths, ts): (&[f64], f64),
        plan: &[f64; N],
    ) -> bool {
        let places = initial.points.iter().zip(depths);
        for (i, (&point, &z)) in places.enumerate().take(self.count) {
            let radius = task.radius(z);
            let mut p = camera::normalise(&task.camera, point);
            let mut gradient = [[0.0; N]; 2];
            for j in 0..self.np {
                let at = j * self.room + i;
                let offset = self.offset(j);
                let v = initial.relative(&Self::command(plan, offset));
                let (velocity, slope) = interaction::flow(p, z, &v);
                if GRADIENTS {
                    let matrix = interaction::of_point(p, z);
                    for k in 0..N {
                        let (x, y) = (gradient[0][k], gradient[1][k]);
                        gradient[0][k] = x + ts * (slope[0][0] * x + slope[0][1] * y);
                        gradient[1][k] = y + ts * (slope[1][0] * x + slope[1][1] * y);
                    }
                    for k in 0..DOF {
                        gradient[0][offset + k] += ts * matrix[0][k];
                        gradient[1][offset + k] += ts * matrix[1][k];
                    }
                }
                p = [p[0] + ts * velocity[0], p[1] + ts * velocity[1]];
                self.points[at] = camera::pixel(&task.camera, p);
                self.radii[at] = radius;
                if GRADIENTS {
                    self.growths[at] = [0.0; N];
                    let [u, v] = &mut self.gradients[at];
                    *u = gradient[0].map(|g| task.camera.fx * g);
                    *v = gradient[1].map(|g| task.camera.fy * g);
                }
            }
        }
        true
    }

    fn move_points<const GRADIENTS: bool>(
        &mut self,
        task: &Task,
        initial: &InitialState,
        (points, ts): (&[Vector3<f64>], f64),
        plan: &[f64; N],
    ) -> bool {
        let mut motions = [Motion::REST; crate::MAX_NC];
        let mut sensitivities = [Sensitivity::REST; crate::MAX_NC];
        for block in 0..Self::NC {
            let v = initial.relative(&Self::command(plan, DOF * block));
            motions[block] = Motion::of_camera(&v, ts);
            if GRADIENTS {
                sensitivities[block] = Sensitivity::of_camera(&v, ts);
            }
        }
        for (i, &start) in points.iter().enumerate().take(self.count) {
            let mut x = start;
            let mut gradient = [[0.0; N]; 3];
            for j in 0..self.np {
                let at = j * self.room + i;
                let offset = self.offset(j);
                let motion = &motions[offset / DOF];
                x = motion.apply(&x);
                if x.z <= 1e-6 {
                    return false;
                }
                let iz = 1.0 / x.z;
                let (a, b) = (x.x * iz, x.y * iz);
                self.points[at] = camera::pixel(&task.camera, [a, b]);
                let radius = task.half_diagonal * iz;
                self.radii[at] = radius;
                if !GRADIENTS {
                    continue;
                }
                let own = sensitivities[offset / DOF].at(&x);
                let r = &motion.rotation;
                for k in 0..N {
                    let g = [gradient[0][k], gradient[1][k], gradient[2][k]];
                    for row in 0..3 {
                        gradient[row][k] =
                            r[(row, 0)] * g[0] + r[(row, 1)] * g[1] + r[(row, 2)] * g[2];
                    }
                }
                for row in 0..3 {
                    for k in 0..DOF {
                        gradient[row][offset + k] += own[row][k];
                    }
                }
                let (fx, fy) = (task.camera.fx * iz, task.camera.fy * iz);
                let [u, v] = &mut self.gradients[at];
                for k in 0..N {
                    u[k] = fx * (gradient[0][k] - a * gradient[2][k]);
                    v[k] = fy * (gradient[1][k] - b * gradient[2][k]);
                }
                if radius > 0.0 {
                    let slope = -radius * iz;
                    self.growths[at] = gradient[2].map(|g| slope * g);
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
    fn gradients_match_finite_differences() {
        let task = task();
        let measured = points(&task);
        for model in [Model::TargetDepth, Model::AreaDepth, Model::Pose] {
            let initial = InitialState::new(&task, model, &measured);
            gradients_match::<6>(&task, &initial, 1);
            gradients_match::<6>(&task, &initial, 3);
            gradients_match::<18>(&task, &initial, 12);
            gradients_match::<6>(&task, &initial, 30);
        }
    }

    fn gradients_match<const N: usize>(task: &Task, initial: &InitialState, np: usize) {
        let plan: [f64; N] = core::array::from_fn(|k| 0.3 * libm::sin(1.0 + k as f64));
        let mut workspaces = [(); 2].map(|()| vec![0.0; Preview::<N>::room(np, 4)]);
        let [mut exact, mut other] = workspaces
            .each_mut()
            .map(|lent| Preview::<N>::new(np, 4, lent).unwrap());
        assert!(exact.linearize(task, initial, &plan, task.ts));
        for k in 0..N {
            let h = 1e-6;
            let mut shifted = |h: f64| {
                let mut moved = plan;
                moved[k] += h;
                assert!(other.evaluate(task, initial, &moved, task.ts));
                other.step(np - 1).to_vec()
            };
            let (plus, minus) = (shifted(h), shifted(-h));
            for i in 0..4 {
                for c in 0..2 {
                    let numeric = (plus[i][c] - minus[i][c]) / (2.0 * h);
                    let analytic = exact.gradients[4 * (np - 1) + i][c][k];
                    let scale = 1.0 + analytic.abs();
                    assert!(
                        (numeric - analytic).abs() < 1e-6 * scale,
                        "{initial:?} {np} {k}"
                    );
                }
            }
        }
    }

    #[test]
    fn the_growth_of_markers_matches_finite_differences() {
        let mut task = task();
        task.half_diagonal = 20.0;
        let initial = InitialState::new(&task, Model::Pose, &points(&task));
        let plan: [f64; 18] = core::array::from_fn(|k| 0.3 * libm::sin(1.0 + k as f64));
        let mut workspaces = [(); 2].map(|()| vec![0.0; Preview::<18>::room(5, 4)]);
        let [mut exact, mut other] = workspaces
            .each_mut()
            .map(|lent| Preview::new(5, 4, lent).unwrap());
        assert!(exact.linearize(&task, &initial, &plan, task.ts));
        let mut most: f64 = 0.0;
        for k in 0..18 {
            let mut radii = |h: f64| {
                let mut moved = plan;
                moved[k] += h;
                assert!(other.evaluate(&task, &initial, &moved, task.ts));
                other.radii(4).to_vec()
            };
            let (plus, minus) = (radii(1e-6), radii(-1e-6));
            for (i, point) in exact.steps().nth(4).unwrap().enumerate() {
                let numeric = (plus[i] - minus[i]) / 2e-6;
                assert!((numeric - point.growth[k]).abs() < 1e-6 * (1.0 + numeric.abs()));
                most = most.max(numeric.abs());
            }
        }
        assert!(most > 1.0, "{most}");
        // At the end of the first step.
        let twist: Twist = core::array::from_fn(|k| plan[k]);
        let (_, ends) = initial.ends(&task, &twist, task.ts).unwrap();
        assert!(exact.evaluate(&task, &initial, &plan, task.ts));
        for (a, b) in ends.iter().zip(exact.radii(0)) {
            assert!((a - b).abs() < 1e-9);
        }
    }

    #[test]
    fn the_gradients_on_the_way_of_a_command_count_that_it_takes_longer() {
        let mut task = task();
        task.half_diagonal = 20.0;
        let measured = points(&task);
        let drift = Own {
            twist: [0.05, 0.1, -0.1, 0.2, 0.0, 0.1],
            ..Own::NONE
        };
        let twist: Twist = core::array::from_fn(|k| 0.3 * libm::sin(1.0 + k as f64));
        let slope = [0.3, -0.2, 0.0, 0.1, 0.4, 0.0];
        for (model, slope) in [
            (Model::TargetDepth, slope),
            (Model::Pose, [0.0; DOF]),
            (Model::Pose, slope),
        ] {
            let initial = InitialState::new(&task, model, &measured).with_drift(drift);
            let seconds = |v: &Twist| 0.5 + v.iter().zip(slope).map(|(v, s)| v * s).sum::<f64>();
            let place = |v: &Twist| {
                let (ends, _) = initial.ends(&task, v, seconds(v)).unwrap();
                let (at, mut places) = ((0.4, seconds(v)), [[0.0; 3]; 4]);
                assert!(initial.passes(&task, v, at, &ends, &[true; 4], &mut places));
                places
            };
            let span = Span {
                seconds: seconds(&twist),
                slope,
            };
            for k in 0..DOF {
                let moved = |h: f64| {
                    let mut moved = twist;
                    moved[k] += h;
                    place(&moved)
                };
                let (plus, minus) = (moved(1e-6), moved(-1e-6));
                for i in 0..4 {
                    let (pixel, growth) = initial.passing_gradient(&task, &twist, (0.4, &span), i);
                    let exact = [pixel[0][k], pixel[1][k], growth[k]];
                    for (c, exact) in exact.into_iter().enumerate() {
                        let numeric = (plus[i][c] - minus[i][c]) / 2e-6;
                        let is_near = (numeric - exact).abs() < 1e-6 * (1.0 + numeric.abs());
                        assert!(is_near, "{model:?} {k} {i} {c}: {numeric} {exact}");
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
        let initial = InitialState::new(&task, Model::Pose, &measured);
        let v = [0.2, -0.1, 0.3, 0.4, -0.5, 0.9];
        let mut workspace = vec![0.0; Preview::<6>::room(20, 4)];
        let mut preview = Preview::<6>::new(20, 4, &mut workspace).unwrap();
        assert!(preview.linearize(&task, &initial, &v, task.ts));
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
            for z in InitialState::new(&task, model, &task.goal).depths() {
                assert!((z - 0.6).abs() < 1e-9);
            }
        }
    }
}
