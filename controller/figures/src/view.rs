//! The camera's view: its photo, and over it what the controller knows.

use scene::Scene;

use crate::canvas::colour;
use crate::{Canvas, Photo, Points};

/// Width of the drawing, px.
const WIDTH: f64 = 400.0;
/// Style of occlusions.
const OCCLUSION: &str = "stroke=\"#ff6a5a\" stroke-width=\"1.2\" stroke-dasharray=\"4 3\"";
/// Style of the features at the goal.
const GOAL: &str = "fill=\"none\" stroke=\"#ff6a5a\" stroke-width=\"2\"";
/// Style of foreseen ways.
const FORESEEN: &str = "stroke=\"#ffc14d\" stroke-width=\"1.4\" stroke-dasharray=\"5 4\"";

/// The view at one moment. All points are px of the scene's camera.
#[derive(Clone, Debug)]
pub struct View<'a> {
    /// The scene.
    pub scene: &'a Scene,
    /// What the camera sees.
    pub photo: Photo,
    /// Features so far, of each frame; the last are those of the photo.
    pub path: &'a [Points],
    /// Bit i: feature i is measured in the photo, not guessed.
    pub visible: u32,
    /// Features at the goal.
    pub goal: &'a [[f64; 2]],
    /// The foreseen way of each feature.
    pub foreseen: Vec<Points>,
    /// Some words, in the upper left corner.
    pub words: String,
}

impl View<'_> {
    /// Draws the view.
    pub fn canvas(&self) -> Canvas {
        let scale = WIDTH / self.scene.camera.width;
        let at = |[u, v]: [f64; 2]| [scale * u, scale * v];
        let height = (scale * self.scene.camera.height).round();
        let mut canvas = Canvas::over(self.photo.clone(), WIDTH, height);
        for part in self.scene.parts() {
            canvas.polyline(part.outline(120).map(at), OCCLUSION);
        }
        for way in &self.foreseen {
            canvas.polyline(way.iter().copied().map(at), FORESEEN);
        }
        for &point in self.goal {
            canvas.circle(at(point), 5.0, GOAL);
        }
        for i in 0..self.goal.len() {
            let colour = colour(i);
            let path = self.path.iter().filter_map(|points| points.get(i));
            let style = format!("stroke=\"{colour}\" stroke-width=\"1.5\"");
            canvas.polyline(path.copied().map(at), &style);
            let fill = match self.visible >> i & 1 {
                1 => colour,
                _ => "none",
            };
            if let Some(&now) = self.path.last().and_then(|points| points.get(i)) {
                let style = format!("fill=\"{fill}\" stroke=\"#ffffff\" stroke-width=\"1.2\"");
                canvas.circle(at(now), 4.0, &style);
            }
        }
        let [x, y, side] = [8.0, 8.0, 17.0];
        let wide = 12.0 + 6.2 * self.words.chars().count() as f64;
        canvas.rect([x, y], [wide, side], "fill=\"#ffffff\" opacity=\"0.8\"");
        canvas.text(x + 6.0, y + 12.5, 11.0, "start", &self.words);
        canvas
    }
}
