//! Joint positions and velocities against their limits.

use crate::canvas::{Canvas, FEATURES, GRID, LIMIT, label, ticks};

const WIDTH: f64 = 852.0;
const PANEL: f64 = 58.0;
const GAP: f64 = 12.0;
const TOP: f64 = 58.0;
const BOTTOM: f64 = 40.0;
/// Left edges of the two columns, and their width.
const LEFT: [f64; 2] = [62.0, 490.0];
const COLUMN: f64 = 346.0;

/// Every joint in a row: its position between the ends of its range, its velocity at the scale of
/// what it does, with the share of its limit in words.
#[derive(Clone, Debug)]
pub struct Joints {
    /// Time of each sample, s.
    pub time_s: Vec<f64>,
    /// Positions of each sample, rad.
    pub q: Vec<[f64; 7]>,
    /// Velocities of each sample, rad/s.
    pub dq: Vec<[f64; 7]>,
    /// Of each joint: least and greatest position in rad, greatest speed in rad/s; m where it
    /// slides. As many as the arm has.
    pub limits: Vec<[f64; 3]>,
    /// What the law keeps of each range at both ends, rad or m; 0: nothing.
    pub margin: f64,
    /// Spans of time in which a joint binds the law's command: joint, begin and end, s.
    pub bound: Vec<(usize, [f64; 2])>,
    /// Instants to mark, s, and their names.
    pub marks: Vec<(f64, String)>,
    /// Title.
    pub title: String,
}

impl Joints {
    /// Draws the figure; sizes are in px.
    pub fn canvas(&self) -> Canvas {
        let height = TOP + self.limits.len() as f64 * (PANEL + GAP) - GAP + BOTTOM;
        let mut canvas = Canvas::new(WIDTH, height);
        canvas.text(WIDTH / 2.0, 17.0, 12.0, "middle", &self.title);
        // In words above, because neighbours are often too close for names beside them.
        let named = |(t, name): &(f64, String)| format!("{name} {t:.1} s");
        let marks: Vec<String> = self.marks.iter().map(named).collect();
        if !marks.is_empty() {
            let text = format!("dotted: {}", marks.join(", "));
            canvas.text(WIDTH / 2.0, 32.0, 10.0, "middle", &text);
        }
        let positions = match (self.margin > 0.0, self.bound.is_empty()) {
            (false, _) => "position (rad), range white",
            (true, true) => "position (rad), range white, margin light",
            (true, false) => "position (rad), range white, margin light, orange: binds",
        };
        for (column, text) in [positions, "velocity (rad/s)"].iter().enumerate() {
            canvas.text(LEFT[column] + COLUMN / 2.0, TOP - 8.0, 11.0, "middle", text);
        }
        for joint in 0..self.limits.len() {
            let top = TOP + joint as f64 * (PANEL + GAP);
            self.positions(&mut canvas, top, joint);
            self.velocities(&mut canvas, top, joint);
        }
        let bottom = height - BOTTOM;
        for left in LEFT {
            let times = ticks(0.0, self.end(), 8);
            canvas.time_axis(&times, |t| self.x(left, t), bottom, left + COLUMN / 2.0);
        }
        canvas
    }

    fn end(&self) -> f64 {
        self.time_s.last().copied().unwrap_or(1.0).max(1e-3)
    }

    fn x(&self, left: f64, t: f64) -> f64 {
        left + COLUMN * t / self.end()
    }

    fn positions(&self, canvas: &mut Canvas, top: f64, joint: usize) {
        let [least, greatest, _] = self.limits[joint];
        if !(greatest - least).is_finite() {
            return self.endless(canvas, top, joint);
        }
        // A strip beyond either end, so that the end is seen.
        let beyond = 0.08 * (greatest - least);
        let (low, high) = (least - beyond, greatest + beyond);
        let y = |q: f64| top + PANEL * (high - q.clamp(low, high)) / (high - low);
        for (from, to) in [(high, greatest), (least, low)] {
            let size = [COLUMN, y(to) - y(from)];
            canvas.rect([LEFT[0], y(from)], size, "fill=\"#d9dce1\"");
        }
        if self.margin > 0.0 {
            for (from, to) in [
                (greatest, greatest - self.margin),
                (least + self.margin, least),
            ] {
                let size = [COLUMN, y(to) - y(from)];
                canvas.rect([LEFT[0], y(from)], size, "fill=\"#eff0f3\"");
            }
        }
        for (_, [from, to]) in self.bound.iter().filter(|(bound, _)| *bound == joint) {
            let [from, to] = [from, to].map(|t| self.x(LEFT[0], *t));
            let size = [(to - from).max(1.0), PANEL];
            canvas.rect([from, top], size, "fill=\"#e69f00\" fill-opacity=\"0.35\"");
        }
        self.position(canvas, top, joint, [least, greatest], y);
    }

    /// The position of a joint that turns without end.
    fn endless(&self, canvas: &mut Canvas, top: f64, joint: usize) {
        let positions = self.q.iter().map(|q| q[joint]);
        let least = positions.clone().fold(f64::INFINITY, f64::min);
        let greatest = positions.fold(f64::NEG_INFINITY, f64::max);
        let middle = 0.5 * (least + greatest);
        let half = (0.6 * (greatest - least)).max(0.1);
        let y = |q: f64| top + PANEL * (0.5 - 0.5 * (q - middle) / half);
        self.position(canvas, top, joint, [least, greatest], y);
    }

    /// The curve of a joint's position, with its name and the values at its axis; `y` places one.
    fn position(
        &self,
        canvas: &mut Canvas,
        top: f64,
        joint: usize,
        values: [f64; 2],
        y: impl Fn(f64) -> f64,
    ) {
        for value in values {
            let text = format!("{value:.2}");
            canvas.text(LEFT[0] - 6.0, y(value) + 3.5, 9.0, "end", &text);
        }
        self.curve(canvas, LEFT[0], joint, &self.q, y);
        let name = format!("q{}", joint + 1);
        canvas.text(LEFT[0] + 8.0, top + 18.0, 11.0, "start", &name);
        self.frame(canvas, LEFT[0], top);
    }

    fn velocities(&self, canvas: &mut Canvas, top: f64, joint: usize) {
        let limit = self.limits[joint][2];
        let speeds = self.dq.iter().map(|dq| dq[joint].abs());
        let most = speeds.fold(0.0, f64::max);
        let range = (1.25 * most).clamp(1e-3, 1.15 * limit);
        let y = |v: f64| top + PANEL * (0.5 - 0.5 * v.clamp(-range, range) / range);
        let right = LEFT[1] + COLUMN;
        for value in ticks(-range, range, 4) {
            canvas.line([LEFT[1], y(value)], [right, y(value)], GRID);
            canvas.text(LEFT[1] - 6.0, y(value) + 3.5, 9.0, "end", &label(value));
        }
        if range >= limit {
            for value in [-limit, limit] {
                canvas.line([LEFT[1], y(value)], [right, y(value)], LIMIT);
            }
        }
        self.curve(canvas, LEFT[1], joint, &self.dq, y);
        let share = format!("at most {:.1} % of {limit} rad/s", 100.0 * most / limit);
        canvas.text(right - 6.0, top + 12.0, 9.0, "end", &share);
        self.frame(canvas, LEFT[1], top);
    }

    fn curve(
        &self,
        canvas: &mut Canvas,
        left: f64,
        joint: usize,
        samples: &[[f64; 7]],
        y: impl Fn(f64) -> f64,
    ) {
        let points = self.time_s.iter().zip(samples);
        let line = points.map(|(t, sample)| [self.x(left, *t), y(sample[joint])]);
        let colour = FEATURES[joint];
        canvas.polyline(line, &format!("stroke=\"{colour}\" stroke-width=\"1.5\""));
    }

    fn frame(&self, canvas: &mut Canvas, left: f64, top: f64) {
        // Below the words in the corner of a velocity.
        let from = if left > LEFT[0] { top + 16.0 } else { top };
        for (t, _) in &self.marks {
            let x = self.x(left, *t);
            let style = "stroke=\"#888888\" stroke-dasharray=\"2 3\"";
            canvas.line([x, from], [x, top + PANEL], style);
        }
        canvas.frame([left, top], [COLUMN, PANEL]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_largest_share_of_a_limit_is_said_in_words() {
        let mut dq = vec![[0.0; 7]; 30];
        dq[12][3] = -0.5;
        let joints = Joints {
            time_s: (0..30).map(|k| 0.1 * f64::from(k)).collect(),
            q: vec![[0.1; 7]; 30],
            dq,
            limits: vec![[-2.0, 2.0, 2.0]; 7],
            margin: 0.0,
            bound: Vec::new(),
            marks: vec![(1.0, "release".into())],
            title: "joints".into(),
        };
        let svg = joints.canvas().svg();
        assert_eq!(svg.matches("at most 25.0 % of 2 rad/s").count(), 1);
        assert_eq!(svg.matches("at most 0.0 % of 2 rad/s").count(), 6);
        assert_eq!(svg.matches(">dotted: release 1.0 s<").count(), 1);
    }

    #[test]
    fn margins_and_what_binds_are_drawn_for_as_many_joints_as_there_are() {
        let mut joints = Joints {
            time_s: vec![0.0, 1.0],
            q: vec![[0.1; 7]; 2],
            dq: vec![[0.0; 7]; 2],
            limits: vec![[-2.0, 2.0, 2.0]; 6],
            margin: 0.2,
            bound: vec![(3, [0.25, 0.75])],
            marks: Vec::new(),
            title: "joints".into(),
        };
        let svg = joints.canvas().svg();
        let count = |svg: &str, text: &str| svg.matches(text).count();
        assert_eq!((count(&svg, ">q6<"), count(&svg, ">q7<")), (1, 0));
        assert_eq!(
            (count(&svg, "#eff0f3"), count(&svg, "fill-opacity")),
            (12, 1)
        );
        assert_eq!(count(&svg, "orange: binds"), 1);
        joints.limits[5] = [f64::NEG_INFINITY, f64::INFINITY, 2.0];
        joints.bound.clear();
        let svg = joints.canvas().svg();
        assert_eq!((count(&svg, "#eff0f3"), count(&svg, "orange")), (10, 0));
        assert!(!svg.contains("NaN") && !svg.contains("inf"));
    }
}
