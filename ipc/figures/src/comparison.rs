//! Strategies side by side: image planes above, velocity commands below, like the paper's figure of one execution.

use crate::canvas::Canvas;
use crate::{ImagePlane, Velocity};

/// One column a strategy.
#[derive(Clone, Debug)]
pub struct Comparison<'a> {
    /// Image plane and velocity commands of each strategy.
    pub columns: Vec<(ImagePlane<'a>, Velocity)>,
}

impl Comparison<'_> {
    /// The drawing.
    pub fn canvas(&self) -> Canvas {
        let drawn: Vec<(Canvas, Canvas)> = self
            .columns
            .iter()
            .map(|(plane, velocity)| (plane.canvas(), velocity.canvas()))
            .collect();
        let widest = |c: &(Canvas, Canvas)| c.0.size().0.max(c.1.size().0);
        let width = drawn.iter().map(widest).sum();
        let above = drawn.iter().map(|c| c.0.size().1).fold(0.0, f64::max);
        let below = drawn.iter().map(|c| c.1.size().1).fold(0.0, f64::max);
        let mut canvas = Canvas::new(width, above + below);
        let mut x = 0.0;
        for column in &drawn {
            canvas.inset(x, 0.0, &column.0);
            canvas.inset(x, above, &column.1);
            x += widest(column);
        }
        canvas
    }
}
