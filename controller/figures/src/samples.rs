//! The samples in a memory.

use scene::Scene;

use crate::Points;
use crate::canvas::{Canvas, FEATURES};
use crate::frame::Frame;

/// Trajectories of a memory on the image plane: each feature its own colour, darker towards the
/// goal.
#[derive(Clone, Debug)]
pub struct Samples<'a> {
    /// The scene.
    pub scene: &'a Scene,
    /// Features of each sample of each trajectory, px.
    pub trajectories: Vec<Vec<Points>>,
    /// Features at the goal, px.
    pub goal: Points,
    /// Title.
    pub title: String,
}

impl Samples<'_> {
    /// Draws the figure; sizes are in px.
    pub fn canvas(&self) -> Canvas {
        let mut frame = Frame::new(self.scene, &self.title);
        for trajectory in &self.trajectories {
            let count = trajectory.len().max(1) as f64;
            for (j, points) in trajectory.iter().enumerate() {
                let opacity = 0.12 + 0.5 * j as f64 / count;
                for (point, colour) in points.iter().zip(FEATURES) {
                    let style = format!("fill=\"{colour}\" opacity=\"{opacity:.2}\"");
                    frame.circle(*point, 0.8, &style);
                }
            }
        }
        for (i, point) in self.goal.iter().enumerate() {
            frame.goal(i, *point);
        }
        frame.explained("a colour per feature, darker towards the goal (red); grey: occlusions")
    }
}
