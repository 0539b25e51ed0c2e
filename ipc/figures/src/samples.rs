//! The samples in a memory.

use scene::Scene;

use crate::Points;
use crate::canvas::{Canvas, FEATURES};
use crate::image_plane::Frame;

/// Trajectories of a memory on the image plane: each feature its own colour, darker towards the goal.
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
    /// The drawing.
    pub fn canvas(&self) -> Canvas {
        let frame = Frame::new(self.scene);
        let mut canvas = frame.begin(self.scene, &self.title);
        for trajectory in &self.trajectories {
            let count = trajectory.len().max(1) as f64;
            for (j, points) in trajectory.iter().enumerate() {
                let opacity = 0.12 + 0.5 * j as f64 / count;
                for (p, colour) in points.iter().zip(FEATURES) {
                    canvas.circle(
                        frame.at(*p),
                        0.8,
                        &format!("fill=\"{colour}\" opacity=\"{opacity:.2}\""),
                    );
                }
            }
        }
        for p in &self.goal {
            let style = "fill=\"none\" stroke=\"#d81f1f\" stroke-width=\"2\"";
            canvas.circle(frame.at(*p), 5.0, style);
        }
        let words = "a colour a feature, darker towards the goal (red); grey: occlusions";
        frame.explain(&mut canvas, words);
        canvas
    }
}
