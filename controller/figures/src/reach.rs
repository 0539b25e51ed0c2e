//! What an arm reaches, from the side or from above, in its base frame.

use crate::canvas::{Canvas, GRID, label, ticks};
use crate::frame::{GOAL, KEY, MARGIN};

/// Height of a panel, px.
const HEIGHT: f64 = 270.0;
/// Rows of the key, px below a panel.
const ROWS: [f64; 2] = [48.0, 63.0];
const AXIS: &str = "stroke=\"#222222\" stroke-width=\"1\"";
const REACH: &str = "fill=\"#009e73\" fill-opacity=\"0.22\" shape-rendering=\"crispEdges\"";
const WALL: &str = "fill=\"#b9bdc4\" fill-opacity=\"0.55\"";
const LINK: &str = "stroke=\"#555b66\" stroke-width=\"7\" stroke-linecap=\"round\" \
    stroke-linejoin=\"round\" opacity=\"0.75\"";
const JOINT: &str = "fill=\"#ffffff\" stroke=\"#555b66\" stroke-width=\"1.5\"";
const SIGHT: &str = "stroke=\"#d81f1f\" stroke-width=\"0.8\" opacity=\"0.7\"";
const PATTERN: &str = "stroke=\"#222222\" stroke-width=\"2.5\"";
const REACHED: &str = "fill=\"#0072b2\"";
const BEYOND: &str = "stroke=\"#d55e00\" stroke-width=\"1.6\"";

/// A view along an axis of the base; all places in m, along the two axes that it shows.
#[derive(Clone, Debug, Default)]
pub struct Reach {
    /// Names of the axes, to the right and upwards.
    pub axes: [&'static str; 2],
    /// The least and the greatest place that is shown.
    pub window: [[f64; 2]; 2],
    /// Rectangles (left, lower, right, upper) that together are what the camera reaches.
    pub reached: Vec<[f64; 4]>,
    /// What is beyond each wall, as polygons in the window, with the wall's name.
    pub walls: Vec<(Vec<[f64; 2]>, String)>,
    /// The arm at the goal: base, joints, camera.
    pub arm: Vec<[f64; 2]>,
    /// Edges of what the camera sees there.
    pub sight: Vec<[[f64; 2]; 2]>,
    /// The pattern's points.
    pub pattern: Vec<[f64; 2]>,
    /// Cameras of starts, and whether the arm reaches each.
    pub starts: Vec<([f64; 2], bool)>,
    /// Title.
    pub title: String,
}

impl Reach {
    /// The drawing.
    pub fn canvas(&self) -> Canvas {
        let [low, high] = self.window;
        let scale = HEIGHT / (high[1] - low[1]);
        let width = scale * (high[0] - low[0]);
        let [left, top, right, lower] = MARGIN;
        let bottom = top + HEIGHT;
        let mut canvas = Canvas::new(left + width.max(KEY) + right, bottom + lower);
        let at = |[x, y]: [f64; 2]| [left + scale * (x - low[0]), bottom - scale * (y - low[1])];
        self.grid(&mut canvas, at);
        // Views of one figure have clips of their own.
        let clip = format!("reach-{}{}", self.axes[0], self.axes[1]);
        canvas.element(format_args!(
            "<clipPath id=\"{clip}\"><rect x=\"{left}\" y=\"{top}\" width=\"{width:.2}\" height=\"{HEIGHT}\"/>\
             </clipPath><g clip-path=\"url(#{clip})\">"
        ));
        for &[x, y, right, upper] in &self.reached {
            let ([x, lower], [right, upper]) = (at([x, y]), at([right, upper]));
            canvas.rect([x, upper], [right - x, lower - upper], REACH);
        }
        for (corners, name) in &self.walls {
            let corners: Vec<[f64; 2]> = corners.iter().map(|corner| at(*corner)).collect();
            let path: Vec<String> = (corners.iter())
                .map(|[x, y]| format!("{x:.2} {y:.2}"))
                .collect();
            canvas.path(&format!("M{}Z", path.join("L")), WALL);
            let middle = |k: usize| corners.iter().map(|corner| corner[k]).sum::<f64>();
            let [x, y] = [0, 1].map(|k| middle(k) / corners.len().max(1) as f64);
            canvas.text(x, y + 4.0, 10.0, "middle", name);
        }
        canvas.polyline(self.arm.iter().map(|place| at(*place)), LINK);
        for place in &self.arm {
            canvas.circle(at(*place), 3.5, JOINT);
        }
        for &[from, to] in &self.sight {
            canvas.line(at(from), at(to), SIGHT);
        }
        canvas.polyline(self.pattern.iter().map(|point| at(*point)), PATTERN);
        for &(place, is_reached) in &self.starts {
            match is_reached {
                true => canvas.circle(at(place), 2.6, REACHED),
                false => canvas.cross(at(place), 3.0, BEYOND),
            }
        }
        if let Some(camera) = self.arm.last() {
            canvas.circle(at(*camera), 5.0, &format!("fill=\"#ffffff\" {GOAL}"));
        }
        canvas.element(format_args!("</g>"));
        canvas.frame([left, top], [width, HEIGHT]);
        canvas.text(left + width / 2.0, 19.0, 12.0, "middle", &self.title);
        key(&mut canvas, [left, bottom]);
        canvas
    }

    fn grid(&self, canvas: &mut Canvas, at: impl Fn([f64; 2]) -> [f64; 2]) {
        let [low, high] = self.window;
        let ([left, bottom], [right, top]) = (at(low), at(high));
        for x in ticks(low[0], high[0], 5) {
            let [place, _] = at([x, low[1]]);
            canvas.line([place, top], [place, bottom], GRID);
            canvas.line([place, bottom], [place, bottom + 4.0], AXIS);
            canvas.text(place, bottom + 15.0, 10.0, "middle", &label(x));
        }
        for y in ticks(low[1], high[1], 5) {
            let [_, place] = at([low[0], y]);
            canvas.line([left, place], [right, place], GRID);
            canvas.line([left - 4.0, place], [left, place], AXIS);
            canvas.text(left - 7.0, place + 3.5, 10.0, "end", &label(y));
        }
        let [across, up] = self.axes.map(|name| format!("{name} (m)"));
        canvas.text((left + right) / 2.0, bottom + 32.0, 11.0, "middle", &across);
        canvas.text_upwards(14.0, (top + bottom) / 2.0, &up);
    }
}

/// What the marks mean: two rows from the left.
fn key(canvas: &mut Canvas, [left, bottom]: [f64; 2]) {
    let [first, second] = ROWS.map(|row| bottom + row);
    canvas.circle([left + 6.0, first], 2.6, REACHED);
    canvas.text(left + 15.0, first + 3.5, 10.0, "start", "start in reach");
    canvas.cross([left + 6.0, second], 3.0, BEYOND);
    canvas.text(left + 15.0, second + 3.5, 10.0, "start", "start beyond");
    let middle = left + 115.0;
    canvas.rect([middle, first - 5.0], [12.0, 10.0], REACH);
    let words = "reached, turned as at the goal";
    canvas.text(middle + 18.0, first + 3.5, 10.0, "start", words);
    canvas.circle(
        [middle + 6.0, second],
        4.0,
        &format!("fill=\"#ffffff\" {GOAL}"),
    );
    canvas.text(
        middle + 18.0,
        second + 3.5,
        10.0,
        "start",
        "camera at the goal",
    );
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn up_is_up_and_each_start_has_its_mark() {
        let view = Reach {
            axes: ["x", "z"],
            window: [[0.0, 0.0], [1.0, 1.0]],
            reached: vec![[0.2, 0.6, 0.4, 0.7]],
            starts: vec![([0.5, 0.5], true), ([0.9, 0.9], false), ([0.8, 0.9], false)],
            ..Reach::default()
        };
        let svg = view.canvas().svg();
        // 270 px a metre; the upper edge of the picture is at 30.
        assert!(svg.contains("<rect x=\"106.00\" y=\"111.00\" width=\"54.00\" height=\"27.00\""));
        // One of each in the key.
        assert_eq!(svg.matches(REACHED).count(), 2);
        assert_eq!(svg.matches(BEYOND).count(), 3);
    }
}
