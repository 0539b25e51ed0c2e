//! A scene before a memory is built for it.

use scene::Scene;

use crate::Points;
use crate::canvas::{Canvas, FEATURES};
use crate::frame::Frame;

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
    /// The drawing: the pattern of each start as a polygon with a dot in each feature's colour,
    /// that of the goal in red.
    pub fn canvas(&self) -> Canvas {
        let mut frame = Frame::new(self.scene, &self.title);
        let orange = "fill=\"#e69f00\" opacity=\"0.25\" shape-rendering=\"crispEdges\"";
        frame.rectangles(self.zone.iter().copied(), orange);
        for start in &self.starts {
            let round = start.iter().chain(start.first()).copied();
            let thin = "stroke=\"#777777\" stroke-width=\"0.5\" opacity=\"0.6\"";
            frame.polyline(round, thin);
            for (point, colour) in start.iter().zip(FEATURES) {
                frame.circle(*point, 1.8, &format!("fill=\"{colour}\""));
            }
        }
        let round = self.goal.iter().chain(self.goal.first()).copied();
        frame.polyline(round, "stroke=\"#d81f1f\" stroke-width=\"1.5\"");
        for (point, colour) in self.goal.iter().zip(FEATURES) {
            let style = format!("fill=\"{colour}\" stroke=\"#d81f1f\" stroke-width=\"2\"");
            frame.circle(*point, 5.0, &style);
        }
        frame.explained("red: goal; thin: starts; grey: occlusions; orange: the memory is asked")
    }
}
