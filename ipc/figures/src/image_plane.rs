//! The image plane: paths of the features among the occlusions.

use std::fmt::Write;

use scene::{Mask, Part, Scene};

use crate::Points;
use crate::canvas::{Canvas, label, ticks};

/// Longest side of the image in the drawing, px.
const SIDE: f64 = 360.0;
/// Left, top, right, bottom of the frame.
const MARGIN: [f64; 4] = [52.0, 30.0, 14.0, 62.0];
/// Width that the key below an image takes, px: an upright image is narrower.
const KEY: f64 = 350.0;
/// Least way between two crosses of one feature, px of the drawing.
const APART: f64 = 7.0;
const BLUE: &str = "#1f4fd8";
const RED: &str = "#d81f1f";
const SHADE: &str = "#b9bdc4";

/// Feature paths on the image plane, as in the paper: big blue dots at the start, small ones at each cycle, red
/// circles at the target, red crosses at way points, occlusions shaded.
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
    /// Title.
    pub title: String,
}

impl ImagePlane<'_> {
    /// The drawing.
    pub fn canvas(&self) -> Canvas {
        let frame = Frame::new(self.scene);
        let mut canvas = frame.begin(self.scene, &self.title);
        let marks = format!("stroke=\"{RED}\" stroke-width=\"1.3\" opacity=\"0.75\"");
        for points in self.way_points_apart(APART / frame.scale) {
            points
                .iter()
                .for_each(|p| canvas.cross(frame.at(*p), 2.6, &marks));
        }
        for i in 0..self.goal.len() {
            let path = self
                .path
                .iter()
                .filter_map(|points| points.get(i))
                .map(|p| frame.at(*p));
            canvas.polyline(
                path.clone(),
                &format!("stroke=\"{BLUE}\" stroke-width=\"0.8\" opacity=\"0.5\""),
            );
            path.for_each(|p| canvas.circle(p, 1.5, &format!("fill=\"{BLUE}\"")));
        }
        if let Some(start) = self.path.first() {
            start
                .iter()
                .for_each(|p| canvas.circle(frame.at(*p), 4.5, &format!("fill=\"{BLUE}\"")));
        }
        for p in &self.goal {
            let style = format!("fill=\"none\" stroke=\"{RED}\" stroke-width=\"2\"");
            canvas.circle(frame.at(*p), 5.0, &style);
        }
        self.key(&frame, &mut canvas);
        canvas
    }

    /// What each mark means, below the image.
    fn key(&self, frame: &Frame, canvas: &mut Canvas) {
        let y = frame.key();
        let at = |x: f64| [MARGIN[0] + x, y - 3.5];
        let blue = format!("fill=\"{BLUE}\"");
        canvas.circle(at(6.0), 4.5, &blue);
        (0..3).for_each(|k| canvas.circle(at(62.0 + 5.0 * f64::from(k)), 1.5, &blue));
        canvas.circle(
            at(134.0),
            5.0,
            &format!("fill=\"none\" stroke=\"{RED}\" stroke-width=\"2\""),
        );
        let [x, middle] = at(184.0);
        let shade = format!("fill=\"{SHADE}\"");
        canvas.rect([x, middle - 5.0], [10.0, 10.0], &shade);
        let mut names = vec![
            (14.0, "start"),
            (78.0, "cycles"),
            (143.0, "goal"),
            (198.0, "occlusion"),
        ];
        if !self.way_points.is_empty() {
            canvas.cross(
                at(274.0),
                2.6,
                &format!("stroke=\"{RED}\" stroke-width=\"1.3\""),
            );
            names.push((282.0, "way points"));
        }
        for (x, name) in names {
            canvas.text(MARGIN[0] + x, y, 10.0, "start", name);
        }
    }

    /// The way points without those that lie nearer than this (px) to the last ones that are kept: at 30 Hz crosses would
    /// run into a band.
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

/// From image px to drawing px, with equal scales and v downwards.
pub(crate) struct Frame {
    scale: f64,
    width: f64,
    height: f64,
}

impl Frame {
    pub(crate) fn new(scene: &Scene) -> Self {
        let scale = SIDE / scene.camera.width.max(scene.camera.height);
        Self {
            scale,
            width: scale * scene.camera.width,
            height: scale * scene.camera.height,
        }
    }

    pub(crate) fn at(&self, [u, v]: [f64; 2]) -> [f64; 2] {
        [MARGIN[0] + self.scale * u, MARGIN[1] + self.scale * v]
    }

    /// Base line of the words that explain the marks, below the axis, px of the drawing.
    pub(crate) fn key(&self) -> f64 {
        MARGIN[1] + self.height + 52.0
    }

    /// One line of words below the axis that explains the marks.
    pub(crate) fn explain(&self, canvas: &mut Canvas, words: &str) {
        canvas.text(MARGIN[0], self.key(), 10.0, "start", words);
    }

    /// A canvas with axes and occlusions.
    pub(crate) fn begin(&self, scene: &Scene, title: &str) -> Canvas {
        let (w, h) = (self.width, self.height);
        let wide = w.max(KEY) + MARGIN[0] + MARGIN[2];
        let mut canvas = Canvas::new(wide, h + MARGIN[1] + MARGIN[3]);
        let clip = format!("image-{w:.0}x{h:.0}");
        canvas.element(format_args!(
            "<clipPath id=\"{clip}\"><rect x=\"{}\" y=\"{}\" width=\"{w:.2}\" height=\"{h:.2}\"/></clipPath>",
            MARGIN[0], MARGIN[1]
        ));
        let shade = format!("fill=\"{SHADE}\" clip-path=\"url(#{clip})\"");
        for part in scene.parts() {
            canvas.path(&self.outline(part), &shade);
        }
        // Rows of pixels meet without a seam only where edges are not softened.
        let crisp = format!("{shade} shape-rendering=\"crispEdges\"");
        for mask in scene.masks() {
            canvas.path(&self.pixels(mask), &crisp);
        }
        canvas.frame([MARGIN[0], MARGIN[1]], [w, h]);
        let axis = "stroke=\"#222222\" stroke-width=\"1\"";
        for u in ticks(0.0, scene.camera.width, 5) {
            let [x, _] = self.at([u, 0.0]);
            let y = MARGIN[1] + h;
            canvas.line([x, y], [x, y + 4.0], axis);
            canvas.text(x, y + 15.0, 10.0, "middle", &label(u));
        }
        for v in ticks(0.0, scene.camera.height, 5) {
            let [_, y] = self.at([0.0, v]);
            canvas.line([MARGIN[0] - 4.0, y], [MARGIN[0], y], axis);
            canvas.text(MARGIN[0] - 7.0, y + 3.5, 10.0, "end", &label(v));
        }
        let (middle, below) = (MARGIN[0] + w / 2.0, MARGIN[1] + h + 32.0);
        canvas.text(middle, below, 11.0, "middle", "u (px)");
        canvas.text_upwards(14.0, MARGIN[1] + h / 2.0, "v (px)");
        canvas.text(middle, 19.0, 12.0, "middle", title);
        canvas
    }

    /// The white pixels of a mask.
    fn pixels(&self, mask: &Mask) -> String {
        let mut path = String::new();
        // A pixel is the square about its whole-numbered centre.
        let corner = |i: usize, j: usize| self.at([i as f64 - 0.5, j as f64 - 0.5]);
        for [columns, rows] in mask.rectangles() {
            let [left, upper] = corner(columns.start, rows.start);
            let [right, lower] = corner(columns.end, rows.end);
            let _ = write!(
                path,
                "M{left:.2} {upper:.2}H{right:.2}V{lower:.2}H{left:.2}Z"
            );
        }
        path
    }

    /// The border of a part: |x|^p + |y|^p = 1, by its direction from the centre.
    fn outline(&self, part: &Part) -> String {
        const STEPS: usize = 240;
        let mut path = String::new();
        for i in 0..STEPS {
            let theta = std::f64::consts::TAU * i as f64 / STEPS as f64;
            let (c, s) = (theta.cos(), theta.sin());
            let radius = (c.abs().powf(part.p) + s.abs().powf(part.p)).powf(-1.0 / part.p);
            let [x, y] = self.at([
                part.center[0] + part.half[0] * radius * c,
                part.center[1] + part.half[1] * radius * s,
            ]);
            let _ = write!(path, "{}{x:.2} {y:.2}", if i == 0 { "M" } else { "L" });
        }
        path + "Z"
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
