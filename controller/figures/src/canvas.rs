//! A canvas: SVG elements in px, from the top left corner.

use std::fmt::Write;

use crate::Photo;

/// Colours of features, in the order of the pattern; distinguishable to the colour-blind (Okabe and
/// Ito).
pub(crate) const FEATURES: [&str; 8] = [
    "#0072b2", "#e69f00", "#009e73", "#cc79a7", "#56b4e9", "#d55e00", "#8c6d31", "#555555",
];

/// The colour of feature `index`.
pub(crate) fn colour(index: usize) -> &'static str {
    FEATURES[index % FEATURES.len()]
}

/// Style of lines across a panel.
pub(crate) const GRID: &str = "stroke=\"#e4e6ea\"";
/// Style of lines at limits.
pub(crate) const LIMIT: &str = "stroke=\"#888888\" stroke-dasharray=\"5 4\"";

/// An SVG drawing under construction.
#[derive(Clone, Debug)]
pub struct Canvas {
    width: f64,
    height: f64,
    photo: Option<Photo>,
    body: String,
}

impl Canvas {
    /// An empty canvas of this size, px.
    pub fn new(width: f64, height: f64) -> Self {
        Self {
            width,
            height,
            photo: None,
            body: String::new(),
        }
    }

    /// A canvas of this size over a photo, px: its pixels have the photo behind the drawing, its SVG
    /// has nothing.
    pub(crate) fn over(photo: Photo, width: f64, height: f64) -> Self {
        Self {
            photo: Some(photo),
            ..Self::new(width, height)
        }
    }

    /// What lies behind the drawing, if it is not white.
    pub(crate) fn photo(&self) -> Option<&Photo> {
        self.photo.as_ref()
    }

    /// Width and height, px.
    pub fn size(&self) -> (f64, f64) {
        (self.width, self.height)
    }

    /// The SVG document.
    pub fn svg(&self) -> String {
        let (w, h) = (self.width, self.height);
        let ground = match self.photo {
            Some(_) => String::new(),
            None => format!("<rect width=\"{w}\" height=\"{h}\" fill=\"#ffffff\"/>"),
        };
        format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{w}\" height=\"{h}\" viewBox=\"0 0 {w} {h}\" \
             font-family=\"DejaVu Sans, sans-serif\">\n{ground}\n{}</svg>\n",
            self.body
        )
    }

    /// Adds an element; formatting into a string cannot fail.
    pub(crate) fn element(&mut self, element: std::fmt::Arguments<'_>) {
        let _ = writeln!(self.body, "{element}");
    }

    /// Puts another canvas at (x, y).
    pub(crate) fn inset(&mut self, x: f64, y: f64, canvas: &Self) {
        self.element(format_args!(
            "<g transform=\"translate({x:.2} {y:.2})\">\n{}</g>",
            canvas.body
        ));
    }

    pub(crate) fn text(&mut self, x: f64, y: f64, size: f64, anchor: &str, text: &str) {
        let text = text
            .replace('&', "&amp;")
            .replace('<', "&lt;")
            .replace('>', "&gt;");
        self.element(format_args!(
            "<text x=\"{x:.2}\" y=\"{y:.2}\" font-size=\"{size}\" text-anchor=\"{anchor}\" fill=\"#222222\">{text}</text>"
        ));
    }

    /// Text that reads upwards, centred at (x, y).
    pub(crate) fn text_upwards(&mut self, x: f64, y: f64, text: &str) {
        self.element(format_args!(
            "<text x=\"{x}\" y=\"{y:.2}\" font-size=\"11\" text-anchor=\"middle\" fill=\"#222222\" \
             transform=\"rotate(-90 {x} {y:.2})\">{text}</text>"
        ));
    }

    /// A rectangle of this upper left corner and size.
    pub(crate) fn rect(&mut self, [x, y]: [f64; 2], [width, height]: [f64; 2], style: &str) {
        self.element(format_args!(
            "<rect x=\"{x:.2}\" y=\"{y:.2}\" width=\"{width:.2}\" height=\"{height:.2}\" {style}/>"
        ));
    }

    /// The border of a panel.
    pub(crate) fn frame(&mut self, corner: [f64; 2], size: [f64; 2]) {
        self.rect(corner, size, "fill=\"none\" stroke=\"#222222\"");
    }

    /// A shape of several outlines.
    pub(crate) fn path(&mut self, outlines: &str, style: &str) {
        self.element(format_args!("<path d=\"{outlines}\" {style}/>"));
    }

    pub(crate) fn line(&mut self, a: [f64; 2], b: [f64; 2], style: &str) {
        self.element(format_args!(
            "<line x1=\"{:.2}\" y1=\"{:.2}\" x2=\"{:.2}\" y2=\"{:.2}\" {style}/>",
            a[0], a[1], b[0], b[1]
        ));
    }

    /// An axis of time below a panel that ends at `y`: `x` gives the place of each of `times` (s),
    /// `middle` that of the title.
    pub(crate) fn time_axis(&mut self, times: &[f64], x: impl Fn(f64) -> f64, y: f64, middle: f64) {
        for &t in times {
            let x = x(t);
            self.line([x, y], [x, y + 4.0], "stroke=\"#222222\"");
            self.text(x, y + 15.0, 10.0, "middle", &label(t));
        }
        self.text(middle, y + 31.0, 11.0, "middle", "time (s)");
    }

    pub(crate) fn polyline(&mut self, points: impl Iterator<Item = [f64; 2]>, style: &str) {
        let mut list = String::new();
        points.for_each(|[x, y]| {
            let _ = write!(list, "{x:.2},{y:.2} ");
        });
        self.element(format_args!(
            "<polyline points=\"{}\" fill=\"none\" {style}/>",
            list.trim_end()
        ));
    }

    pub(crate) fn circle(&mut self, [x, y]: [f64; 2], radius: f64, style: &str) {
        self.element(format_args!(
            "<circle cx=\"{x:.2}\" cy=\"{y:.2}\" r=\"{radius}\" {style}/>"
        ));
    }

    /// A diagonal cross.
    pub(crate) fn cross(&mut self, [x, y]: [f64; 2], arm: f64, style: &str) {
        let (left, right, upper, lower) = (x - arm, x + arm, y - arm, y + arm);
        let down = format!("M{left:.2} {upper:.2}L{right:.2} {lower:.2}");
        let up = format!("M{left:.2} {lower:.2}L{right:.2} {upper:.2}");
        self.path(&(down + &up), style);
    }
}

/// Round numbers, about `count` of them, between two values.
pub(crate) fn ticks(low: f64, high: f64, count: usize) -> Vec<f64> {
    let raw = (high - low) / count as f64;
    if !(raw.is_finite() && raw > 0.0) {
        return vec![low];
    }
    let power = 10f64.powf(raw.log10().floor());
    let step = [1.0, 2.0, 5.0, 10.0]
        .into_iter()
        .map(|m| m * power)
        .find(|s| *s >= raw)
        .unwrap_or(raw);
    let first = (low / step - 1e-9).ceil() as i64;
    let last = (high / step + 1e-9).floor() as i64;
    (first..=last).map(|i| i as f64 * step).collect()
}

/// A number as a tick shows it.
pub(crate) fn label(x: f64) -> String {
    let text = format!("{x:.6}");
    let text = text.trim_end_matches('0').trim_end_matches('.');
    if text == "-0" { "0" } else { text }.to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_round_and_inside() {
        assert_eq!(ticks(0.0, 1024.0, 5), [0.0, 500.0, 1000.0]);
        assert_eq!(ticks(-0.5, 0.5, 4).len(), 3);
        assert_eq!(label(-0.0), "0");
        assert_eq!(label(0.250), "0.25");
        // A joint that hardly moves: neighbouring ticks must not read the same.
        assert_eq!(label(0.0005), "0.0005");
        assert_eq!(label(3.0 * 0.1), "0.3");
    }
}
