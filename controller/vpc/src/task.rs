//! The task: the scene as the law sees it, with what follows from it by projection.

use scene::{Area, Camera, Cost, Limits, MAX_AREAS, Part, Pose, Scene};

use crate::features::{self, Points};
use crate::{DOF, MAX_POINTS, Twist, camera, motion};

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
    /// Depth of each point at the goal, m.
    pub goal_depth: heapless::Vec<f64, MAX_POINTS>,
    /// Area of the pattern at the goal, px^2.
    pub goal_area: f64,
    /// Orientation of the pattern at the goal, rad.
    pub goal_angle: f64,
    /// Greatest size of each component of the camera velocity.
    pub limits: Twist,
    /// Weights of the cost.
    pub cost: Cost,
    /// Parts of all occlusions, px.
    pub parts: heapless::Vec<Part, MAX_ALL_PARTS>,
    /// Areas of all masks, px.
    pub areas: heapless::Vec<Area, MAX_AREAS>,
    /// Sampling time, s.
    pub ts: f64,
}

/// Why a scene gives no task.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum TaskError {
    /// A point of the pattern is behind the camera at the goal.
    GoalBehindCamera {
        /// Index of the point.
        point: usize,
    },
    /// A point of the pattern lies outside the image at the goal.
    GoalOffImage {
        /// Index of the point.
        point: usize,
        /// Where it lies, px.
        pixel: [f64; 2],
    },
    /// A point of the pattern is hidden by an occlusion at the goal.
    GoalOccluded {
        /// Index of the point.
        point: usize,
        /// Where it lies, px.
        pixel: [f64; 2],
        /// Index of the part among all parts, in the order of the scene.
        part: usize,
    },
    /// A point of the pattern is hidden by a mask at the goal.
    GoalMasked {
        /// Index of the point.
        point: usize,
        /// Where it lies, px.
        pixel: [f64; 2],
    },
    /// There are more parts than [`MAX_ALL_PARTS`].
    TooManyParts {
        /// How many there are.
        count: usize,
    },
}

impl core::error::Error for TaskError {}

impl core::fmt::Display for TaskError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::GoalBehindCamera { point } => {
                write!(f, "goal: point {point} of the pattern is behind the camera")
            }
            Self::GoalOffImage {
                point,
                pixel: [u, v],
            } => {
                write!(
                    f,
                    "goal: point {point} of the pattern is at ({u:.1}, {v:.1}) px, outside the image"
                )
            }
            Self::GoalOccluded {
                point,
                pixel: [u, v],
                part,
            } => {
                write!(
                    f,
                    "goal: point {point} of the pattern is at ({u:.1}, {v:.1}) px, inside part {part} of the occlusions"
                )
            }
            Self::GoalMasked {
                point,
                pixel: [u, v],
            } => {
                write!(
                    f,
                    "goal: point {point} of the pattern is at ({u:.1}, {v:.1}) px, inside a mask"
                )
            }
            Self::TooManyParts { count } => {
                write!(
                    f,
                    "occlusions: {count} parts; allowed: at most {MAX_ALL_PARTS}"
                )
            }
        }
    }
}

impl Task {
    /// The task of a scene.
    ///
    /// # Errors
    /// [`TaskError`] where the goal cannot be seen or there are too many parts.
    pub fn new(scene: &Scene) -> Result<Self, TaskError> {
        let count = scene.parts().count();
        if count > MAX_ALL_PARTS {
            return Err(TaskError::TooManyParts { count });
        }
        let parts: heapless::Vec<Part, MAX_ALL_PARTS> = scene.parts().copied().collect();
        let areas: heapless::Vec<Area, MAX_AREAS> = scene.areas().copied().collect();
        let (goal, goal_depth) =
            see(scene, &scene.goal).map_err(|point| TaskError::GoalBehindCamera { point })?;
        for (point, &pixel) in goal.iter().enumerate() {
            let ([u, v], camera) = (pixel, &scene.camera);
            if !(0.0..=camera.width).contains(&u) || !(0.0..=camera.height).contains(&v) {
                return Err(TaskError::GoalOffImage { point, pixel });
            }
            if let Some(part) = parts
                .iter()
                .position(|part| crate::constraint::hides(part, pixel))
            {
                return Err(TaskError::GoalOccluded { point, pixel, part });
            }
            if areas
                .iter()
                .any(|area| crate::field::clearance(area, pixel).distance < 0.0)
            {
                return Err(TaskError::GoalMasked { point, pixel });
            }
        }
        let Limits { linear, angular } = scene.limits;
        Ok(Self {
            camera: scene.camera,
            pattern: scene.pattern.clone(),
            goal_area: features::area(&goal),
            goal_angle: features::angle(&goal),
            goal,
            goal_depth,
            limits: core::array::from_fn(|i| if i < DOF / 2 { linear } else { angular }),
            cost: scene.cost,
            parts,
            areas,
            ts: scene.sampling_time(),
        })
    }

    /// The features of the pattern at a pose of the object in the camera frame, px; `None` where a point is behind
    /// the camera.
    pub fn features_at(&self, pose: &Pose) -> Option<Points> {
        let rotation = motion::rotation(pose.rotation);
        let translation = nalgebra::Vector3::from(pose.translation);
        self.pattern
            .iter()
            .map(|&p| {
                let x = rotation * nalgebra::Vector3::from(p) + translation;
                camera::project(&self.camera, x.into())
            })
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

/// Features and depths of the pattern at a pose, or the index of a point behind the camera.
fn see(scene: &Scene, pose: &Pose) -> Result<(Points, heapless::Vec<f64, MAX_POINTS>), usize> {
    let rotation = motion::rotation(pose.rotation);
    let translation = nalgebra::Vector3::from(pose.translation);
    let (mut points, mut depths) = (Points::new(), heapless::Vec::new());
    for (i, &p) in scene.pattern.iter().enumerate() {
        let x = rotation * nalgebra::Vector3::from(p) + translation;
        let pixel = camera::project(&scene.camera, x.into()).ok_or(i)?;
        points.push(pixel).map_err(|_| i)?;
        depths.push(x.z).map_err(|_| i)?;
    }
    Ok((points, depths))
}
