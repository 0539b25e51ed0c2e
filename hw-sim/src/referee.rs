//! The referee: judges a run by the scene's own words.

use std::fmt;

use scene::{Name, Scene};

use crate::camera::{Outline, Points, project};
use crate::occlusion::Shape;
use crate::pose::from_scene;

/// How a run ended.
#[derive(Clone, Debug, PartialEq)]
pub enum End {
    /// At the goal: every component of s - s* is within the scene's convergence. A robot has
    /// released the object there and backed away.
    Arrived,
    /// A point is deeper in an occlusion, or farther outside the image, than the scene allows. As
    /// in the paper, points count: a marker that is partly hidden is no violation.
    Violation(Violation),
    /// The time is up.
    TimeOut,
    /// A point of the pattern is behind the camera.
    LostSight,
    /// The robot stopped itself.
    Reflex,
}

/// A point where it must not be.
#[derive(Clone, Debug, PartialEq)]
pub struct Violation {
    /// Index of the point.
    pub point: usize,
    /// How deep, px.
    pub depth_px: f64,
    /// In the occlusion of this name; `None` outside the image.
    pub occlusion: Option<Name>,
}

impl fmt::Display for Violation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "point {} is {:.1} px deep ", self.point, self.depth_px)?;
        match &self.occlusion {
            Some(name) => write!(f, "inside `{name}`"),
            None => write!(f, "outside the image"),
        }
    }
}

/// Instants of a period at which the referee looks, that of the frame among them.
pub const INSTANTS: u32 = 12;

/// Judges true features, moment by moment.
#[derive(Clone, Debug)]
pub struct Referee {
    scene: Scene,
    shapes: Vec<Shape>,
    goal: Points,
    least_clearance: f64,
    least_between: f64,
    least_edge: f64,
}

impl Referee {
    /// A referee for a scene. What may be crossed is no violation.
    pub fn new(scene: &Scene) -> Self {
        let forbidden = scene.occlusions.iter().filter(|one| !one.crossable);
        Self {
            scene: scene.clone(),
            shapes: forbidden.map(Shape::new).collect(),
            // A checked scene sees its goal.
            goal: project(scene, &from_scene(&scene.goal)).unwrap_or_default(),
            least_clearance: f64::INFINITY,
            least_between: f64::INFINITY,
            least_edge: f64::INFINITY,
        }
    }

    /// The features at the goal, px.
    pub fn goal(&self) -> &Points {
        &self.goal
    }

    /// Least signed distance of any point of a frame from an occlusion or the image border, px;
    /// negative inside.
    pub fn least_clearance(&self) -> f64 {
        self.least_clearance
    }

    /// The same at the instants between frames.
    pub fn least_between(&self) -> f64 {
        self.least_between
    }

    /// Least signed distance of any part of a marker's edge from an occlusion or the image border at
    /// any instant, px; negative where a marker was partly hidden. `None` where markers are points.
    pub fn least_edge(&self) -> Option<f64> {
        (self.scene.marker_size > 0.0).then_some(self.least_edge)
    }

    /// Largest component of s - s*, px.
    pub fn error(&self, points: &[[f64; 2]]) -> f64 {
        let pairs = points.iter().flatten().zip(self.goal.iter().flatten());
        pairs.map(|(s, goal)| (s - goal).abs()).fold(0.0, f64::max)
    }

    /// Judges the true features of a frame: [`End::Violation`], [`End::Arrived`], or neither.
    /// Violations come first.
    pub fn judge(&mut self, points: &[[f64; 2]]) -> Option<End> {
        let (least, violation) = self.deepest(points, self.least_clearance);
        self.least_clearance = least;
        let arrived = || self.error(points) <= self.scene.success.convergence_px;
        violation.or_else(|| arrived().then_some(End::Arrived))
    }

    /// Judges the true features at an instant between frames: [`End::Violation`] or nothing.
    pub fn judge_between(&mut self, points: &[[f64; 2]]) -> Option<End> {
        let (least, violation) = self.deepest(points, self.least_between);
        self.least_between = least;
        violation
    }

    /// Measures how clear the true [edges of the markers](crate::camera::outlines) are.
    pub fn measure_edges(&mut self, outlines: impl Iterator<Item = Option<Outline>>) {
        for outline in outlines {
            let edge = outline.iter().flatten();
            self.least_edge = edge.fold(self.least_edge, |least, &pixel| {
                least.min(self.clearance(pixel, least).0)
            });
            if outline.is_none() {
                self.least_edge = f64::NEG_INFINITY;
            }
        }
    }

    /// The least clearance of some points and of `least`, and the first point that is too deep.
    fn deepest(&self, points: &[[f64; 2]], mut least: f64) -> (f64, Option<End>) {
        for (point, &pixel) in points.iter().enumerate() {
            let (clearance, occlusion) = if pixel.iter().all(|x| x.is_finite()) {
                self.clearance(pixel, least)
            } else {
                (f64::NEG_INFINITY, None)
            };
            least = least.min(clearance);
            if clearance < -self.scene.success.violation_px {
                let violation = Violation {
                    point,
                    depth_px: -clearance,
                    occlusion,
                };
                return (least, Some(End::Violation(violation)));
            }
        }
        (least, None)
    }

    /// The signed distance of a pixel from the border or from the occlusion nearest to it, where
    /// that is below `least`.
    fn clearance(&self, [u, v]: [f64; 2], least: f64) -> (f64, Option<Name>) {
        let camera = &self.scene.camera;
        // Euclidean outside a corner, straight elsewhere.
        let inside = u.min(v).min(camera.width - u).min(camera.height - v);
        let out = |x: f64, size: f64| (-x).max(x - size).max(0.0);
        let border = if inside < 0.0 {
            -out(u, camera.width).hypot(out(v, camera.height))
        } else {
            inside
        };
        // What is no nearer than anything seen so far decides nothing.
        let mut nearest = (border, None);
        for shape in &self.shapes {
            let bound = nearest.0.min(least);
            let distance = shape.distance_below([u, v], bound);
            if distance < bound {
                nearest = (distance, Some(shape.name.clone()));
            }
        }
        nearest
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::outlines;

    fn referee() -> Referee {
        Referee::new(&Scene::parse(scene::PAPER_SIM, "sim").unwrap())
    }

    fn goal_with(point: [f64; 2]) -> Vec<[f64; 2]> {
        let mut points = referee().goal().to_vec();
        points[2] = point;
        points
    }

    #[test]
    fn the_goal_is_arrival_and_just_short_of_it_is_not() {
        let mut referee = referee();
        let goal = referee.goal().to_vec();
        assert_eq!(referee.judge(&goal), Some(End::Arrived));
        assert_eq!(referee.judge(&goal_with([714.1, 712.0])), None);
    }

    #[test]
    fn the_edge_of_a_marker_is_measured() {
        let mut scene = Scene::parse(scene::TAGS_ROBOT, "tags").unwrap();
        let goal = from_scene(&scene.goal);
        let edge = |scene: &Scene| {
            let mut referee = Referee::new(scene);
            referee.measure_edges(outlines(scene, &goal));
            let points = project(scene, &goal).unwrap();
            (referee.least_edge(), referee.judge(&points))
        };
        // The lower tags end at v = 240 + 615 * (-0.01 + 0.045 + 0.015) / 0.35; the grasped object,
        // nearly a rectangle, begins at v = 385.
        let lower = 240.0 + 615.0 * 0.05 / 0.35;
        let (least, end) = edge(&scene);
        assert!((least.unwrap() - (385.0 - lower)).abs() < 0.5, "{least:?}");
        assert_eq!(end, Some(End::Arrived));
        scene.occlusions[1].parts[0].center[1] -= 65.0;
        let (least, end) = edge(&scene);
        assert!((least.unwrap() - (320.0 - lower)).abs() < 0.5, "{least:?}");
        assert_eq!(end, Some(End::Arrived));
        scene.marker_size = 0.0;
        assert_eq!(edge(&scene).0, None);
    }

    #[test]
    fn depth_within_the_tolerance_is_allowed_and_more_is_named() {
        // The spot on the right is a circle about (850, 560) of radius 75.
        assert_eq!(referee().judge(&goal_with([850.0 - 61.0, 560.0])), None);
        match referee().judge(&goal_with([850.0 - 59.0, 560.0])) {
            Some(End::Violation(violation)) => {
                assert!((violation.depth_px - 16.0).abs() < 1e-6);
                let words = "point 2 is 16.0 px deep inside `spot, right`";
                assert_eq!(violation.to_string(), words);
            }
            other => panic!("{other:?}"),
        }
        for outside in [[1040.0, 500.0], [f64::NAN, 0.0]] {
            match referee().judge(&goal_with(outside)) {
                Some(End::Violation(violation)) => assert_eq!(violation.occlusion, None),
                other => panic!("{other:?}"),
            }
        }
    }
}
