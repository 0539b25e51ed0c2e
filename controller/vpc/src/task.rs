//! The task: the scene as the law sees it, with what follows from it by projection.

use core::f64::consts::FRAC_1_SQRT_2;

use ::arm::damper::Towards;
use ::arm::{Arm, Dampers, Joints};
use nalgebra::Vector3;
use scene::{Area, Camera, Cost, MAX_AREAS, Part, Pose, Scene};

use crate::features::{self, Points};
use crate::obstacle::Obstacle;
use crate::span::Span;
use crate::{MAX_POINTS, Twist, camera, motion};

/// Most parts of all occlusions together.
pub const MAX_ALL_PARTS: usize = 48;

/// What the law needs of a scene.
#[derive(Clone, Debug)]
pub struct Task {
    /// The camera.
    pub camera: Camera,
    /// Points of the pattern in the object frame, m.
    pub pattern: heapless::Vec<[f64; 3], MAX_POINTS>,
    /// s*: the features at the goal, px.
    pub goal: Points,
    /// The pattern in the camera frame at the goal.
    pub goal_pose: Pose,
    /// Depth of each point at the goal, m.
    pub goal_depth: heapless::Vec<f64, MAX_POINTS>,
    /// Area of the pattern at the goal, px^2.
    pub goal_area: f64,
    /// Orientation of the pattern at the goal, rad.
    pub goal_angle: f64,
    /// Greatest size of each component of the camera velocity, m/s and rad/s.
    pub limits: Twist,
    /// Greatest change of each in a second, m/s^2 and rad/s^2; infinite where none is given.
    pub acceleration: Twist,
    /// Weights of the cost.
    pub cost: Cost,
    /// Parts of all occlusions, px.
    pub parts: heapless::Vec<Part, MAX_ALL_PARTS>,
    /// Areas of all masks, px.
    pub areas: heapless::Vec<Area, MAX_AREAS>,
    /// Time between two cycles, s.
    pub period: f64,
    /// Least length of a step of the preview, s: the period, or longer.
    pub ts: f64,
    /// A step, or a period and a stop from the limits if that takes longer, s. After a command that
    /// is clear for this time, braking is clear, too.
    pub reach: f64,
    /// h: half the diagonal of a marker's square at a depth of 1 m, px m; 0 where markers are
    /// points.
    pub half_diagonal: f64,
    /// The arm that carries the camera, where it is known.
    pub arm: Option<Arm>,
    /// The bounding box of each obstacle, px.
    boxes: heapless::Vec<[[f64; 2]; 2], { MAX_ALL_PARTS + MAX_AREAS }>,
}

/// Why a scene gives no task. Points are counted from 0, in the order of the pattern.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[allow(missing_docs)] // the messages say it
pub enum TaskError {
    #[error("goal: point {point} of the pattern is behind the camera")]
    GoalBehindCamera { point: usize },
    #[error("goal: point {point} of the pattern is at ({:.1}, {:.1}) px, outside the image", .pixel[0], .pixel[1])]
    GoalOffImage { point: usize, pixel: [f64; 2] },
    #[error(
        "goal: point {point} of the pattern is at ({:.1}, {:.1}) px, inside part {part} of the occlusions",
        .pixel[0], .pixel[1]
    )]
    GoalOccluded {
        point: usize,
        pixel: [f64; 2],
        part: usize,
    },
    #[error("goal: point {point} of the pattern is at ({:.1}, {:.1}) px, inside a mask", .pixel[0], .pixel[1])]
    GoalMasked { point: usize, pixel: [f64; 2] },
    #[error(
        "goal: the marker of point {point} reaches {radius:.1} px from its point, which is only {clearance:.1} px \
         clear of occlusions and image border; allowed: a goal at which every marker is wholly in sight"
    )]
    GoalMarkerHidden {
        point: usize,
        radius: f64,
        clearance: f64,
    },
    #[error("occlusions: {count} parts; allowed: at most {MAX_ALL_PARTS}")]
    TooManyParts { count: usize },
}

impl Task {
    /// The task of a scene.
    ///
    /// # Errors
    /// [`TaskError`] if the goal cannot be seen or there are too many parts.
    pub fn new(scene: &Scene) -> Result<Self, TaskError> {
        let count = scene.parts().count();
        if count > MAX_ALL_PARTS {
            return Err(TaskError::TooManyParts { count });
        }
        let (mut goal, mut goal_depth) = (Points::new(), heapless::Vec::new());
        for (point, x) in placed(&scene.pattern, &scene.goal).enumerate() {
            let behind = TaskError::GoalBehindCamera { point };
            let pixel = camera::project(&scene.camera, x.into()).ok_or(behind)?;
            goal.extend([pixel]);
            goal_depth.extend([x.z]);
        }
        let mut task = Self {
            camera: scene.camera,
            pattern: scene.pattern.clone(),
            goal_area: features::area(&goal),
            goal_angle: features::angle(&goal),
            goal,
            goal_pose: scene.goal,
            goal_depth,
            limits: scene.limits.velocity(),
            acceleration: scene.limits.acceleration(),
            cost: scene.cost,
            parts: scene.parts().copied().collect(),
            areas: scene.areas().copied().collect(),
            period: scene.sampling_time(),
            ts: scene.sampling_time(),
            reach: scene.sampling_time(),
            half_diagonal: scene.camera.fx.max(scene.camera.fy) * scene.marker_size * FRAC_1_SQRT_2,
            arm: None,
            boxes: heapless::Vec::new(),
        };
        task.arm = scene.arm.as_ref().map(Arm::from);
        task.boxes = task.obstacles().map(Obstacle::bounding_box).collect();
        task.check_goal()?;
        Ok(task)
    }

    /// Leaves out the crossable occlusions of its scene.
    pub(crate) fn open(&mut self, scene: &Scene) {
        let kept = || scene.occlusions.iter().filter(|one| !one.crossable);
        self.parts = kept().flat_map(|one| &one.parts).copied().collect();
        let masks = kept().filter_map(|one| one.mask.as_ref());
        self.areas = masks.flat_map(|mask| mask.areas()).copied().collect();
        self.boxes = self.obstacles().map(Obstacle::bounding_box).collect();
    }

    /// Whether every point is in sight at the goal, and then whether every marker is wholly so.
    fn check_goal(&self) -> Result<(), TaskError> {
        let Camera { width, height, .. } = self.camera;
        for (point, &pixel) in self.goal.iter().enumerate() {
            let [u, v] = pixel;
            if !(0.0..=width).contains(&u) || !(0.0..=height).contains(&v) {
                return Err(TaskError::GoalOffImage { point, pixel });
            }
            let mut obstacles = self.obstacles().enumerate();
            match obstacles.find(|(_, obstacle)| obstacle.hides(pixel)) {
                Some((part, Obstacle::Part(_))) => {
                    return Err(TaskError::GoalOccluded { point, pixel, part });
                }
                Some((_, Obstacle::Area(_))) => {
                    return Err(TaskError::GoalMasked { point, pixel });
                }
                None => (),
            }
        }
        let goals = self.goal.iter().zip(&self.goal_depth).enumerate();
        for (point, (&pixel, &depth)) in goals.filter(|_| self.has_markers()) {
            let [u, v] = pixel;
            let border = u.min(v).min(width - u).min(height - v);
            let obstacles = self.obstacles().map(|each| each.clearance(pixel).distance);
            let (radius, clearance) = (self.radius(depth), obstacles.fold(border, f64::min));
            if clearance < radius {
                return Err(TaskError::GoalMarkerHidden {
                    point,
                    radius,
                    clearance,
                });
            }
        }
        Ok(())
    }

    /// Whether markers are more than points.
    pub fn has_markers(&self) -> bool {
        self.half_diagonal > 0.0
    }

    /// The radius of a marker at a depth, m, in the image, px: half the diagonal of its square, so
    /// that its edge is no further from its point. 0 where markers are points.
    pub fn radius(&self, depth: f64) -> f64 {
        if self.has_markers() {
            self.half_diagonal / depth
        } else {
            0.0
        }
    }

    /// Time that a stop from a velocity takes, s, where all components end together.
    pub fn stop_s(&self, twist: &Twist) -> f64 {
        let each = twist.iter().zip(self.acceleration);
        each.map(|(v, most)| v.abs() / most).fold(0.0, f64::max)
    }

    /// Whether a stop from the limits takes longer than a step of the preview.
    pub(crate) fn brakes(&self) -> bool {
        self.reach > self.ts
    }

    /// [`Task::stop_s`] with its derivatives.
    pub(crate) fn stop(&self, twist: &Twist) -> Span {
        let mut stop = Span::fixed(0.0);
        let each = twist.iter().zip(self.acceleration).enumerate();
        for (k, (v, most)) in each {
            let seconds = v.abs() / most;
            if seconds > stop.seconds {
                stop = Span::fixed(seconds);
                if let Some(slope) = stop.slope.get_mut(k) {
                    *slope = v.signum() / most;
                }
            }
        }
        stop
    }

    /// What the arm allows with its joints at `q` of a command in force for `seconds`, on the way
    /// to a posture, if there is one; `None` where arm or joints are not known.
    pub(crate) fn dampers(
        &self,
        q: Option<&Joints>,
        seconds: f64,
        posture: Option<Joints>,
    ) -> Option<Dampers> {
        let arm = self.arm.as_ref()?;
        let towards = posture.map(|q| Towards {
            q,
            limits: self.limits,
        });
        let towards = towards.as_ref();
        Some(Dampers::towards(
            arm,
            q?,
            &self.acceleration,
            seconds,
            towards,
        ))
    }

    /// Every part and every area that features must keep clear of.
    pub fn obstacles(&self) -> impl Iterator<Item = Obstacle<'_>> {
        let areas = self.areas.iter().map(Obstacle::Area);
        self.parts.iter().map(Obstacle::Part).chain(areas)
    }

    /// The obstacle of this index among [`Task::obstacles`]; as fast as two look-ups.
    pub fn obstacle(&self, index: usize) -> Option<Obstacle<'_>> {
        match self.parts.get(index) {
            Some(part) => Some(Obstacle::Part(part)),
            None => self.areas.get(index - self.parts.len()).map(Obstacle::Area),
        }
    }

    /// The obstacles whose bounding box comes within `margin` px of the box from `low` to `high`,
    /// with their indices.
    pub(crate) fn obstacles_near(
        &self,
        low: [f64; 2],
        high: [f64; 2],
        margin: f64,
    ) -> impl Iterator<Item = (usize, Obstacle<'_>)> {
        let is_near = move |[from, to]: &[[f64; 2]; 2]| {
            high[0] > from[0] - margin
                && low[0] < to[0] + margin
                && high[1] > from[1] - margin
                && low[1] < to[1] + margin
        };
        let boxes = self.boxes.iter().enumerate();
        let near = boxes.filter(move |(_, box_)| is_near(box_));
        near.filter_map(|(index, _)| Some((index, self.obstacle(index)?)))
    }

    /// The features of the pattern at a pose of the object in the camera frame, px; `None` if a
    /// point is behind the camera.
    pub fn features_at(&self, pose: &Pose) -> Option<Points> {
        let points = placed(&self.pattern, pose);
        points
            .map(|x| camera::project(&self.camera, x.into()))
            .collect()
    }

    /// The recall input x of some features: (s, area, angle).
    pub fn recall_input(
        &self,
        points: &[[f64; 2]],
    ) -> heapless::Vec<f64, { features::MAX_INPUTS }> {
        features::recall_input(points, self.goal_angle)
    }
}

/// The points of a pattern in the camera frame, m.
pub fn placed(pattern: &[[f64; 3]], pose: &Pose) -> impl Iterator<Item = Vector3<f64>> {
    let rotation = motion::rotation(pose.rotation);
    let translation = Vector3::from(pose.translation);
    pattern
        .iter()
        .map(move |&p| rotation * Vector3::from(p) + translation)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tags() -> Scene {
        Scene::parse(scene::TAGS_ROBOT, "tags").unwrap()
    }

    #[test]
    fn a_marker_is_as_large_as_it_is_near() {
        let task = Task::new(&tags()).unwrap();
        let half_diagonal_px = 0.5 * core::f64::consts::SQRT_2 * 0.03 * 615.0 / 0.35;
        assert!((task.radius(0.35) - half_diagonal_px).abs() < 1e-9);
        assert!((task.radius(0.7) - 0.5 * half_diagonal_px).abs() < 1e-9);
        let mut scene = tags();
        scene.camera.fy = 2.0 * 615.0;
        scene.goal.translation[2] = 0.7;
        // The greater of the focal lengths counts.
        assert!((Task::new(&scene).unwrap().radius(0.7) - half_diagonal_px).abs() < 1e-9);
        let points = Scene::parse(scene::PAPER_ROBOT, "robot").unwrap();
        assert_eq!(Task::new(&points).unwrap().radius(0.0), 0.0);
    }

    #[test]
    fn a_goal_at_which_a_marker_is_not_wholly_in_sight_is_refused() {
        let mut scene = tags();
        // The grasped object, 85 px below the lower points, up to 30 px below them.
        scene.occlusions[1].parts[0].center[1] -= 55.0;
        let refused = Task::new(&scene).unwrap_err().to_string();
        let words =
            "goal: the marker of point 2 reaches 37.3 px from its point, which is only 29.4 px";
        assert!(refused.starts_with(words), "{refused}");
        scene.marker_size = 0.02;
        assert!(Task::new(&scene).is_ok());
        let mut scene = tags();
        // The upper left point 30 px from the upper side of the image.
        scene.goal.translation[1] = 0.045 - 210.0 * 0.35 / 615.0;
        let refused = Task::new(&scene).unwrap_err();
        assert!(matches!(
            refused,
            TaskError::GoalMarkerHidden { point: 0, .. }
        ));
    }
}
