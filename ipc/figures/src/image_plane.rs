//! The image plane: paths of the features past the occlusions.

use scene::Scene;

use crate::Points;
use crate::canvas::Canvas;
use crate::frame::{Frame, GOAL, MARGIN, SHADE};

/// Least distance between two crosses of one feature, px of the drawing.
const APART: f64 = 7.0;
/// Style of features.
const FEATURE: &str = "fill=\"#1f4fd8\"";
/// Style of paths.
const PATH: &str = "stroke=\"#1f4fd8\" stroke-width=\"0.8\" opacity=\"0.5\"";
/// Style of foreseen ways.
const FORESEEN: &str = "stroke=\"#d98a00\" stroke-width=\"1.2\" stroke-dasharray=\"5 4\"";
/// Style of way points.
const WAY_POINT: &str = "stroke=\"#d81f1f\" stroke-width=\"1.3\" opacity=\"0.75\"";

/// Feature paths on the image plane, as in the paper: big blue dots at the start, small ones at
/// each cycle, red circles at the target, red crosses at way points, occlusions shaded.
#[derive(Clone, Debug)]
pub struct ImagePlane<'a> {
    /// The scene.
    pub scene: &'a Scene,
    /// Features of each cycle, px; the first are the start.
    pub path: Vec<Points>,
    /// Features at the goal, px.
    pub goal: Points,
    /// Way points tracked, px.
    pub way_points: Vec<Points>,
    /// The way of each point that was foreseen at the start, px.
    pub foreseen: Vec<Points>,
    /// Title.
    pub title: String,
}

impl ImagePlane<'_> {
    /// Draws the figure; sizes are in px.
    pub fn canvas(&self) -> Canvas {
        let mut frame = Frame::new(self.scene, &self.title);
        for point in self
            .way_points_apart(frame.in_image(APART))
            .into_iter()
            .flatten()
        {
            frame.cross(*point, 2.6, WAY_POINT);
        }
        for i in 0..self.goal.len() {
            let path = self.path.iter().filter_map(|points| points.get(i).copied());
            frame.polyline(path.clone(), PATH);
            path.for_each(|point| frame.circle(point, 1.5, FEATURE));
        }
        for way in &self.foreseen {
            frame.polyline(way.iter().copied(), FORESEEN);
        }
        for point in self.path.iter().take(1).flatten() {
            frame.circle(*point, 4.5, FEATURE);
        }
        for point in &self.goal {
            frame.circle(*point, 5.0, GOAL);
        }
        self.key(frame.key(), &mut frame.canvas);
        frame.canvas
    }

    /// What each mark means, below the image.
    fn key(&self, y: f64, canvas: &mut Canvas) {
        let at = |x: f64| [MARGIN[0] + x, y - 3.5];
        canvas.circle(at(6.0), 4.5, FEATURE);
        for x in [62.0, 67.0, 72.0] {
            canvas.circle(at(x), 1.5, FEATURE);
        }
        canvas.circle(at(134.0), 5.0, GOAL);
        canvas.rect([at(184.0)[0], y - 8.5], [10.0, 10.0], SHADE);
        let mut names = vec![
            (14.0, "start"),
            (78.0, "cycles"),
            (143.0, "goal"),
            (198.0, "occlusion"),
        ];
        if !self.way_points.is_empty() {
            canvas.cross(at(274.0), 2.6, WAY_POINT);
            names.push((282.0, "way points"));
        }
        if !self.foreseen.is_empty() {
            canvas.polyline([at(352.0), at(366.0)].into_iter(), FORESEEN);
            names.push((370.0, "foreseen at the start"));
        }
        for (x, name) in names {
            canvas.text(MARGIN[0] + x, y, 10.0, "start", name);
        }
    }

    /// The way points at least this far (px) from the last ones kept: at 30 Hz the crosses would
    /// merge into a band.
    fn way_points_apart(&self, least: f64) -> Vec<&Points> {
        let mut kept: Vec<&Points> = Vec::new();
        for points in &self.way_points {
            let far = |last: &&Points| {
                let mut pairs = last.iter().zip(points);
                pairs.any(|(a, b)| (a[0] - b[0]).hypot(a[1] - b[1]) >= least)
            };
            if kept.last().is_none_or(far) {
                kept.push(points);
            }
        }
        kept
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::KEY;

    #[test]
    fn way_points_that_hardly_move_are_one_cross() {
        let scene = Scene::parse(scene::PAPER_ROBOT, "robot").unwrap();
        let plane = ImagePlane {
            scene: &scene,
            path: Vec::new(),
            goal: Vec::new(),
            way_points: (0..100).map(|k| vec![[f64::from(k), 50.0]]).collect(),
            foreseen: Vec::new(),
            title: String::new(),
        };
        let places: Vec<f64> = plane
            .way_points_apart(30.0)
            .iter()
            .map(|p| p[0][0])
            .collect();
        assert_eq!(places, [0.0, 30.0, 60.0, 90.0]);
    }

    #[test]
    fn the_key_fits_below_an_upright_image_and_names_way_points_where_there_are_some() {
        let mut scene = Scene::parse(scene::PAPER_ROBOT, "robot").unwrap();
        scene.camera.height = 3.0 * scene.camera.width;
        let drawn = |way_points: Vec<Points>| {
            let plane = ImagePlane {
                scene: &scene,
                path: Vec::new(),
                goal: Vec::new(),
                way_points,
                foreseen: Vec::new(),
                title: String::new(),
            };
            plane.canvas()
        };
        let without = drawn(Vec::new());
        assert!(without.size().0 >= MARGIN[0] + KEY);
        assert!(without.svg().contains(">occlusion<"));
        assert!(!without.svg().contains(">way points<"));
        assert!(
            drawn(vec![vec![[50.0, 50.0]]])
                .svg()
                .contains(">way points<")
        );
    }
}
