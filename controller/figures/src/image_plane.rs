//! The image plane: paths of the features past the occlusions.

use scene::Scene;

use crate::Points;
use crate::canvas::{Canvas, colour};
use crate::frame::{Frame, GOAL, KEY, MARGIN, SHADE};

/// Least distance between two crosses of one feature, px of the drawing.
const APART: f64 = 7.0;
/// Colour of marks in the key: any feature's.
const ANY: &str = "#555555";
/// A row of the key, and width of its letters, px.
const ROW: f64 = 14.0;
const LETTER: f64 = 6.2;

/// The style of a way that was foreseen.
fn foreseen(colour: &str) -> String {
    format!("stroke=\"{colour}\" stroke-width=\"1.4\" stroke-dasharray=\"5 4\"")
}

/// The style of the outline of where a hidden point is believed.
fn outline(colour: &str) -> String {
    format!("stroke=\"{colour}\" stroke-width=\"0.6\"")
}

/// The style of a way point.
fn way_point(colour: &str) -> String {
    format!("stroke=\"{colour}\" stroke-width=\"1.3\"")
}

fn filled(colour: &str) -> String {
    format!("fill=\"{colour}\"")
}

/// What a mark of the key looks like.
#[derive(Clone, Copy)]
enum Mark {
    Start,
    Cycles,
    Goal,
    Occlusion,
    WayPoints,
    Foreseen,
    Hidden,
}

impl Mark {
    /// What it means.
    fn words(self) -> &'static str {
        match self {
            Self::Start => "start",
            Self::Cycles => "cycles",
            Self::Goal => "goal",
            Self::Occlusion => "occlusion",
            Self::WayPoints => "way points",
            Self::Foreseen => "foreseen",
            Self::Hidden => "hidden, 2 deviations",
        }
    }

    /// Its width, px.
    fn width(self) -> f64 {
        match self {
            Self::Cycles | Self::Foreseen => 16.0,
            _ => 11.0,
        }
    }

    /// Draws it from `x` on about the height `y`.
    fn draw(self, canvas: &mut Canvas, [x, y]: [f64; 2]) {
        match self {
            Self::Start => canvas.circle([x + 5.0, y], 4.5, &filled(ANY)),
            Self::Cycles => {
                [2.0, 7.0, 12.0]
                    .iter()
                    .for_each(|dx| canvas.circle([x + dx, y], 1.5, &filled(ANY)));
            }
            Self::Goal => canvas.circle([x + 5.0, y], 5.0, &format!("fill=\"none\" {GOAL}")),
            Self::Occlusion => canvas.rect([x, y - 5.0], [10.0, 10.0], SHADE),
            Self::WayPoints => canvas.cross([x + 5.0, y], 2.6, &way_point(ANY)),
            Self::Foreseen => {
                canvas.polyline([[x, y], [x + 14.0, y]].into_iter(), &foreseen(ANY));
            }
            Self::Hidden => {
                let style = format!("fill=\"none\" {}", outline(ANY));
                canvas.circle([x + 5.0, y], 5.0, &style);
            }
        }
    }
}

/// Places of marks in rows no wider than [`KEY`]: where each begins in its row, px, and which row.
fn rows(marks: &[Mark]) -> Vec<(f64, usize)> {
    let (mut x, mut row) = (0.0, 0);
    let place = |mark: &Mark| {
        let width = mark.width() + 4.0 + LETTER * mark.words().len() as f64;
        if x + width > KEY {
            (x, row) = (0.0, row + 1);
        }
        let place = (x, row);
        x += width + 10.0;
        place
    };
    marks.iter().map(place).collect()
}

/// Feature paths on the image plane, as in the paper, a colour for each feature: big dots at the
/// start, small ones at each cycle, red rings at the target, crosses at way points, occlusions
/// shaded.
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
    /// The way of each point that was foreseen, px: in a still, at the start.
    pub foreseen: Vec<Points>,
    /// Outlines of where hidden points are believed, px, with the index of each point.
    pub ellipses: Vec<(usize, Points)>,
    /// Title.
    pub title: String,
}

impl ImagePlane<'_> {
    /// Draws the figure; sizes are in px.
    pub fn canvas(&self) -> Canvas {
        let mut frame = Frame::new(self.scene, &self.title);
        for points in self.way_points_apart(frame.in_image(APART)) {
            for (i, point) in points.iter().enumerate() {
                frame.cross(*point, 2.6, &way_point(colour(i)));
            }
        }
        for i in 0..self.goal.len() {
            let path = self.path.iter().filter_map(|points| points.get(i).copied());
            let line = format!(
                "stroke=\"{}\" stroke-width=\"0.8\" opacity=\"0.5\"",
                colour(i)
            );
            frame.polyline(path.clone(), &line);
            path.for_each(|point| frame.circle(point, 1.5, &filled(colour(i))));
        }
        for (i, corners) in &self.ellipses {
            let closed = corners.iter().chain(corners.first()).copied();
            frame.polyline(closed, &outline(colour(*i)));
        }
        for (i, way) in self.foreseen.iter().enumerate() {
            frame.polyline(way.iter().copied(), &foreseen(colour(i)));
        }
        for (i, point) in self.path.iter().take(1).flatten().enumerate() {
            frame.circle(*point, 4.5, &filled(colour(i)));
        }
        for (i, point) in self.goal.iter().enumerate() {
            frame.goal(i, *point);
        }
        self.key(frame.key(), &mut frame.canvas);
        frame.canvas
    }

    /// What each mark means, below the image.
    fn key(&self, y: f64, canvas: &mut Canvas) {
        let mut marks = vec![Mark::Start, Mark::Cycles, Mark::Goal, Mark::Occlusion];
        if !self.way_points.is_empty() {
            marks.push(Mark::WayPoints);
        }
        if !self.foreseen.is_empty() {
            marks.push(Mark::Foreseen);
        }
        if !self.ellipses.is_empty() {
            marks.push(Mark::Hidden);
        }
        for (mark, (x, row)) in marks.iter().zip(rows(&marks)) {
            let (x, y) = (MARGIN[0] + x, y + ROW * row as f64);
            mark.draw(canvas, [x, y - 3.5]);
            canvas.text(x + mark.width() + 4.0, y, 10.0, "start", mark.words());
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

    #[test]
    fn way_points_that_hardly_move_are_one_cross() {
        let scene = Scene::parse(scene::PAPER_ROBOT, "robot").unwrap();
        let plane = ImagePlane {
            scene: &scene,
            path: Vec::new(),
            goal: Vec::new(),
            way_points: (0..100).map(|k| vec![[f64::from(k), 50.0]]).collect(),
            foreseen: Vec::new(),
            ellipses: Vec::new(),
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
    fn every_entry_of_the_key_ends_within_the_drawing() {
        let all = [
            Mark::Start,
            Mark::Cycles,
            Mark::Goal,
            Mark::Occlusion,
            Mark::WayPoints,
            Mark::Foreseen,
            Mark::Hidden,
        ];
        for (mark, (x, row)) in all.iter().zip(rows(&all)) {
            let end = x + mark.width() + 4.0 + LETTER * mark.words().len() as f64;
            assert!(end <= KEY && row < 2, "{}: {end}, row {row}", mark.words());
        }
    }

    #[test]
    fn each_feature_has_its_colour_from_start_to_goal() {
        let scene = Scene::parse(scene::PAPER_ROBOT, "robot").unwrap();
        let points = vec![[50.0, 50.0], [90.0, 50.0]];
        let plane = ImagePlane {
            scene: &scene,
            path: vec![points.clone()],
            goal: points.clone(),
            way_points: vec![points.clone()],
            foreseen: vec![points.clone(), points],
            ellipses: (0..2)
                .map(|i| (i, vec![[40.0, 50.0], [50.0, 40.0]]))
                .collect(),
            title: String::new(),
        };
        let canvas = plane.canvas();
        assert!(crate::output::pixels(&canvas, 1.0).is_ok());
        let svg = canvas.svg();
        // Line, cycle, start, goal, way point, foreseen way and ellipse.
        for i in 0..2 {
            assert_eq!(svg.matches(colour(i)).count(), 7, "{}", colour(i));
        }
    }

    #[test]
    fn the_key_fits_below_the_image_and_names_way_points() {
        let mut scene = Scene::parse(scene::PAPER_ROBOT, "robot").unwrap();
        scene.camera.height = 3.0 * scene.camera.width;
        let drawn = |way_points: Vec<Points>| {
            let plane = ImagePlane {
                scene: &scene,
                path: Vec::new(),
                goal: Vec::new(),
                way_points,
                foreseen: Vec::new(),
                ellipses: Vec::new(),
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
