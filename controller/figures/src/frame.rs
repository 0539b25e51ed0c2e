//! The frame of an image plane: axes in px and the occlusions.

use std::fmt::Write;

use scene::Scene;

use crate::canvas::{Canvas, colour, label, ticks};

/// Longest side of the image in the drawing, px.
const SIDE: f64 = 360.0;
/// Left, top, right and bottom margin.
pub(crate) const MARGIN: [f64; 4] = [52.0, 30.0, 14.0, 74.0];
/// Width that the key below an image takes, px: an upright image is narrower.
pub(crate) const KEY: f64 = 350.0;
/// Fill of occlusions.
pub(crate) const SHADE: &str = "fill=\"#b9bdc4\"";
/// Stroke of the features at the goal.
pub(crate) const GOAL: &str = "stroke=\"#d81f1f\" stroke-width=\"2\"";

/// A drawing in the coordinates of an image, with equal scales and v downwards.
pub(crate) struct Frame {
    pub canvas: Canvas,
    scale: f64,
    height: f64,
}

impl Frame {
    /// A frame with axes, occlusions and title.
    pub fn new(scene: &Scene, title: &str) -> Self {
        let scale = SIDE / scene.camera.width.max(scene.camera.height);
        let (width, height) = (scale * scene.camera.width, scale * scene.camera.height);
        let wide = width.max(KEY) + MARGIN[0] + MARGIN[2];
        let mut frame = Self {
            canvas: Canvas::new(wide, height + MARGIN[1] + MARGIN[3]),
            scale,
            height,
        };
        frame.occlusions(scene, [width, height]);
        frame.canvas.frame([MARGIN[0], MARGIN[1]], [width, height]);
        frame.axes(scene);
        let middle = MARGIN[0] + width / 2.0;
        frame.canvas.text(middle, 19.0, 12.0, "middle", title);
        frame
    }

    fn occlusions(&mut self, scene: &Scene, [w, h]: [f64; 2]) {
        let clip = format!("image-{w:.0}x{h:.0}");
        self.canvas.element(format_args!(
            "<clipPath id=\"{clip}\"><rect x=\"{}\" y=\"{}\" width=\"{w:.2}\" height=\"{h:.2}\"/></clipPath>",
            MARGIN[0], MARGIN[1]
        ));
        let shade = format!("{SHADE} clip-path=\"url(#{clip})\"");
        for part in scene.parts() {
            let corners = part.outline(240).map(|corner| self.at(corner));
            let corners: Vec<_> = corners.map(|[x, y]| format!("{x:.2} {y:.2}")).collect();
            self.canvas
                .path(&format!("M{}Z", corners.join("L")), &shade);
        }
        // Rows of pixels meet without a seam only where edges are not softened.
        let crisp = format!("{shade} shape-rendering=\"crispEdges\"");
        for mask in scene.masks() {
            // A pixel is the square about its whole-numbered centre.
            let areas = mask.rectangles().into_iter().map(|[columns, rows]| {
                [columns.start, rows.start, columns.end, rows.end].map(|edge| edge as f64 - 0.5)
            });
            self.rectangles(areas, &crisp);
        }
    }

    fn axes(&mut self, scene: &Scene) {
        let axis = "stroke=\"#222222\" stroke-width=\"1\"";
        let (left, bottom) = (MARGIN[0], MARGIN[1] + self.height);
        for u in ticks(0.0, scene.camera.width, 5) {
            let [x, _] = self.at([u, 0.0]);
            self.canvas.line([x, bottom], [x, bottom + 4.0], axis);
            self.canvas
                .text(x, bottom + 15.0, 10.0, "middle", &label(u));
        }
        for v in ticks(0.0, scene.camera.height, 5) {
            let [_, y] = self.at([0.0, v]);
            self.canvas.line([left - 4.0, y], [left, y], axis);
            self.canvas
                .text(left - 7.0, y + 3.5, 10.0, "end", &label(v));
        }
        let [middle, _] = self.at([scene.camera.width / 2.0, 0.0]);
        self.canvas
            .text(middle, bottom + 32.0, 11.0, "middle", "u (px)");
        self.canvas
            .text_upwards(14.0, bottom - self.height / 2.0, "v (px)");
    }

    /// The place of a pixel in the drawing.
    fn at(&self, [u, v]: [f64; 2]) -> [f64; 2] {
        [MARGIN[0] + self.scale * u, MARGIN[1] + self.scale * v]
    }

    /// A length of the drawing in pixels of the image.
    pub fn in_image(&self, length: f64) -> f64 {
        length / self.scale
    }

    pub fn circle(&mut self, point: [f64; 2], radius: f64, style: &str) {
        self.canvas.circle(self.at(point), radius, style);
    }

    /// A circle whose radius is in px of the image.
    pub fn circle_in_image(&mut self, point: [f64; 2], radius: f64, style: &str) {
        self.circle(point, self.scale * radius, style);
    }

    /// The number of a feature beside it: from 0, as in messages.
    pub fn number(&mut self, point: [f64; 2], index: usize) {
        let [x, y] = self.at(point);
        self.canvas
            .text(x + 7.0, y - 6.0, 10.0, "start", &index.to_string());
    }

    /// The goal of feature `index`: a red ring, filled faintly with its colour.
    pub fn goal(&mut self, index: usize, point: [f64; 2]) {
        let style = format!("fill=\"{}\" fill-opacity=\"0.35\" {GOAL}", colour(index));
        self.circle(point, 5.0, &style);
    }

    pub fn cross(&mut self, point: [f64; 2], arm: f64, style: &str) {
        self.canvas.cross(self.at(point), arm, style);
    }

    pub fn polyline(&mut self, points: impl Iterator<Item = [f64; 2]>, style: &str) {
        let (scale, [left, top, ..]) = (self.scale, MARGIN);
        let placed = points.map(|[u, v]| [left + scale * u, top + scale * v]);
        self.canvas.polyline(placed, style);
    }

    /// Rectangles (left, top, right, bottom) as one shape.
    pub fn rectangles(&mut self, areas: impl Iterator<Item = [f64; 4]>, style: &str) {
        let mut path = String::new();
        for [left, top, right, bottom] in areas {
            let ([x, y], [to_x, to_y]) = (self.at([left, top]), self.at([right, bottom]));
            let _ = write!(path, "M{x:.2} {y:.2}H{to_x:.2}V{to_y:.2}H{x:.2}Z");
        }
        self.canvas.path(&path, style);
    }

    /// Base line of the words that explain the marks, below the axis, px of the drawing.
    pub fn key(&self) -> f64 {
        MARGIN[1] + self.height + 52.0
    }

    /// Ends the drawing with a line that explains the marks.
    pub fn explained(mut self, words: &str) -> Canvas {
        let y = self.key();
        self.canvas.text(MARGIN[0], y, 10.0, "start", words);
        self.canvas
    }
}
