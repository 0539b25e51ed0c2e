//! Strategies side by side: image planes above, velocity commands below, like the paper's figure of
//! one execution.

use crate::canvas::Canvas;
use crate::{ImagePlane, Velocity};

/// One column a strategy.
#[derive(Clone, Debug)]
pub struct Comparison<'a> {
    /// Image plane and velocity commands of each strategy.
    pub columns: Vec<(ImagePlane<'a>, Velocity)>,
}

impl Comparison<'_> {
    /// Draws the figure; sizes are in px.
    pub fn canvas(&self) -> Canvas {
        let columns = self.columns.iter().map(|(plane, velocity)| {
            let (plane, velocity) = (plane.canvas(), velocity.canvas());
            let width = plane.size().0.max(velocity.size().0);
            let mut column = Canvas::new(width, plane.size().1 + velocity.size().1);
            column.inset(0.0, 0.0, &plane);
            column.inset(0.0, plane.size().1, &velocity);
            column
        });
        side_by_side(columns)
    }
}

/// Canvases in a row, their upper edges aligned.
pub fn side_by_side(canvases: impl Iterator<Item = Canvas>) -> Canvas {
    let canvases: Vec<Canvas> = canvases.collect();
    let width = canvases.iter().map(|canvas| canvas.size().0).sum();
    let height = canvases
        .iter()
        .map(|canvas| canvas.size().1)
        .fold(0.0, f64::max);
    let mut row = Canvas::new(width, height);
    let mut x = 0.0;
    for canvas in &canvases {
        row.inset(x, 0.0, canvas);
        x += canvas.size().0;
    }
    row
}
