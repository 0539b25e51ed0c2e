//! A scene before a memory is built for it.

use std::fmt::Write;

use scene::Scene;

use crate::Points;
use crate::canvas::{Canvas, FEATURES};
use crate::image_plane::Frame;

/// A scene: occlusions and the zone round them in which the memory is asked, the goal, some starts.
#[derive(Clone, Debug)]
pub struct Preview<'a> {
    /// The scene.
    pub scene: &'a Scene,
    /// Rectangles (left, top, right, bottom, px) that together are the zone round the occlusions.
    pub zone: Vec<[f64; 4]>,
    /// Features at the goal, px.
    pub goal: Points,
    /// Features of each start, px.
    pub starts: Vec<Points>,
    /// Title.
    pub title: String,
}

impl Preview<'_> {
    /// The drawing: the pattern of each start as a polygon with a dot in each feature's colour, that of the goal in
    /// red.
    pub fn canvas(&self) -> Canvas {
        let frame = Frame::new(self.scene);
        let mut zone = String::new();
        for [left, top, right, bottom] in &self.zone {
            let ([x, y], [to_x, to_y]) = (frame.at([*left, *top]), frame.at([*right, *bottom]));
            let _ = write!(zone, "M{x:.2} {y:.2}H{to_x:.2}V{to_y:.2}H{x:.2}Z");
        }
        let mut canvas = frame.begin(self.scene, &self.title);
        let orange = "fill=\"#e69f00\" opacity=\"0.25\" shape-rendering=\"crispEdges\"";
        canvas.path(&zone, orange);
        for start in &self.starts {
            let round = start.iter().chain(start.first()).map(|p| frame.at(*p));
            canvas.polyline(
                round,
                "stroke=\"#777777\" stroke-width=\"0.5\" opacity=\"0.6\"",
            );
            for (p, colour) in start.iter().zip(FEATURES) {
                canvas.circle(frame.at(*p), 1.8, &format!("fill=\"{colour}\""));
            }
        }
        let round = self
            .goal
            .iter()
            .chain(self.goal.first())
            .map(|p| frame.at(*p));
        canvas.polyline(round, "stroke=\"#d81f1f\" stroke-width=\"1.5\"");
        for (p, colour) in self.goal.iter().zip(FEATURES) {
            let style = format!("fill=\"{colour}\" stroke=\"#d81f1f\" stroke-width=\"2\"");
            canvas.circle(frame.at(*p), 5.0, &style);
        }
        let words = "red: goal; thin: starts; grey: occlusions; orange: the memory is asked";
        frame.explain(&mut canvas, words);
        canvas
    }
}
