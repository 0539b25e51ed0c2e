//! The referee: judges a run by the scene's own words.

use scene::{Name, Pose, Scene};

use crate::camera::{FreeCamera, Points};
use crate::occlusion;

/// Where a violation took place.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Place {
    /// Outside the image.
    OutsideImage,
    /// In the occlusion of this name.
    Occlusion(Name),
}

/// What a referee says of a moment.
#[derive(Clone, Debug, PartialEq)]
pub enum Verdict {
    /// On the way.
    Running,
    /// Every component of s - s* is within the scene's convergence.
    Arrived,
    /// A point is deeper in an occlusion or outside the image than the scene allows. Final.
    Violation {
        /// Index of the point.
        point: usize,
        /// How deep, px.
        depth_px: f64,
        /// In what.
        place: Place,
    },
    /// The scene's time is up.
    TimeOut,
    /// The goal itself cannot be seen.
    LostSight,
}

/// Judges true features, moment by moment.
#[derive(Clone, Debug)]
pub struct Referee {
    scene: Scene,
    goal: Option<Points>,
    least_clearance: f64,
}

impl Referee {
    /// A referee for a scene.
    pub fn new(scene: &Scene) -> Self {
        let goal: &Pose = &scene.goal;
        let goal = FreeCamera::new(scene, goal).features().ok();
        Self {
            scene: scene.clone(),
            goal,
            least_clearance: f64::INFINITY,
        }
    }

    /// The features at the goal, px.
    pub fn goal(&self) -> Option<&Points> {
        self.goal.as_ref()
    }

    /// Least signed distance of any judged point from an occlusion or the image border, px.
    pub fn least_clearance(&self) -> f64 {
        self.least_clearance
    }

    /// Largest component of s - s*, px.
    pub fn error(&self, points: &[[f64; 2]]) -> f64 {
        let Some(goal) = &self.goal else {
            return f64::INFINITY;
        };
        points
            .iter()
            .flatten()
            .zip(goal.iter().flatten())
            .map(|(s, t)| (s - t).abs())
            .fold(0.0, f64::max)
    }

    /// Judges the true features at `time_s` seconds after the start. Violations come before arrival, arrival before
    /// the end of time.
    pub fn judge(&mut self, points: &[[f64; 2]], time_s: f64) -> Verdict {
        let allowed = self.scene.success.violation_px;
        for (point, &pixel) in points.iter().enumerate() {
            if !pixel.iter().all(|x| x.is_finite()) {
                let place = Place::OutsideImage;
                return Verdict::Violation {
                    point,
                    depth_px: f64::INFINITY,
                    place,
                };
            }
            let (clearance, place) = self.clearance(pixel);
            self.least_clearance = self.least_clearance.min(clearance);
            if clearance < -allowed {
                return Verdict::Violation {
                    point,
                    depth_px: -clearance,
                    place,
                };
            }
        }
        if self.goal.is_none() {
            Verdict::LostSight
        } else if self.error(points) <= self.scene.success.convergence_px {
            Verdict::Arrived
        } else if time_s >= self.scene.success.time_s {
            Verdict::TimeOut
        } else {
            Verdict::Running
        }
    }

    /// The signed distance of a pixel from the border or from the occlusion nearest to it, where that is nearer than
    /// any point before.
    fn clearance(&self, [u, v]: [f64; 2]) -> (f64, Place) {
        let camera = &self.scene.camera;
        // Euclidean outside a corner, straight elsewhere.
        let inside = u.min(v).min(camera.width - u).min(camera.height - v);
        let out = [
            (-u).max(u - camera.width).max(0.0),
            (-v).max(v - camera.height).max(0.0),
        ];
        let border = if inside < 0.0 {
            -out[0].hypot(out[1])
        } else {
            inside
        };
        // What is no nearer than anything seen so far decides nothing.
        let mut nearest = (border, Place::OutsideImage);
        for occlusion in &self.scene.occlusions {
            let bound = nearest.0.min(self.least_clearance);
            let distance = occlusion::distance_below(occlusion, [u, v], bound);
            if distance < bound {
                nearest = (distance, Place::Occlusion(occlusion.name.clone()));
            }
        }
        nearest
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn referee() -> Referee {
        Referee::new(&Scene::parse(scene::PAPER_SIM, "sim").unwrap())
    }

    fn goal_with(point: [f64; 2]) -> Vec<[f64; 2]> {
        let mut points = referee().goal().unwrap().to_vec();
        points[2] = point;
        points
    }

    #[test]
    fn the_goal_is_arrival_and_just_short_of_it_is_not() {
        let mut referee = referee();
        let goal = referee.goal().unwrap().to_vec();
        assert_eq!(referee.judge(&goal, 20.0), Verdict::Arrived);
        assert_eq!(
            referee.judge(&goal_with([714.1, 712.0]), 1.0),
            Verdict::Running
        );
        assert_eq!(
            referee.judge(&goal_with([714.1, 712.0]), 15.0),
            Verdict::TimeOut
        );
    }

    #[test]
    fn depth_within_the_tolerance_is_allowed_and_more_is_named() {
        // The spot on the right is a circle about (850, 560) of radius 75.
        assert_eq!(
            referee().judge(&goal_with([850.0 - 61.0, 560.0]), 1.0),
            Verdict::Running
        );
        match referee().judge(&goal_with([850.0 - 59.0, 560.0]), 1.0) {
            Verdict::Violation {
                point: 2,
                depth_px,
                place: Place::Occlusion(name),
            } => {
                assert!((depth_px - 16.0).abs() < 1e-6);
                assert_eq!(name.as_str(), "spot, right");
            }
            other => panic!("{other:?}"),
        }
        let off = referee().judge(&goal_with([1040.0, 500.0]), 1.0);
        assert!(
            matches!(
                off,
                Verdict::Violation {
                    place: Place::OutsideImage,
                    ..
                }
            ),
            "{off:?}"
        );
        assert!(matches!(
            referee().judge(&goal_with([f64::NAN, 0.0]), 1.0),
            Verdict::Violation { .. }
        ));
    }
}
