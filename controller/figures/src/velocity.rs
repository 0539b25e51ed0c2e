//! Velocity commands over time.

use scene::Limits;

use crate::canvas::{Canvas, FEATURES, GRID, LIMIT, label, ticks};

const WIDTH: f64 = 426.0;
const PANEL: f64 = 120.0;
const MARGIN: [f64; 4] = [52.0, 40.0, 14.0, 40.0];
const GAP: f64 = 24.0;
/// More commands than this are drawn with a finer line: they may change from one to the next.
const DENSE: usize = 400;

/// The camera twist over time: linear components above, angular ones below, limits dashed, the
/// pattern's own motion dotted.
#[derive(Clone, Debug)]
pub struct Velocity {
    /// Time between two commands, s.
    pub period_s: f64,
    /// Commands (vx vy vz m/s, wx wy wz rad/s).
    pub twists: Vec<[f64; 6]>,
    /// The pattern's own motion in the same periods; empty where it stands.
    pub own: Vec<[f64; 6]>,
    /// Limits of each component.
    pub limits: Limits,
    /// Periods that the axis has room for; at least that of the commands.
    pub periods: usize,
    /// Title.
    pub title: String,
}

impl Velocity {
    /// Draws the figure; sizes are in px.
    pub fn canvas(&self) -> Canvas {
        let mut canvas = Canvas::new(WIDTH, MARGIN[1] + 2.0 * PANEL + GAP + MARGIN[3]);
        let title = match self.own.is_empty() {
            true => self.title.clone(),
            false => format!("{}; dotted: the pattern's own motion", self.title),
        };
        canvas.text(WIDTH / 2.0, 17.0, 12.0, "middle", &title);
        let below = MARGIN[1] + PANEL + GAP;
        let (linear, angular) = (self.limits.linear, self.limits.angular);
        self.panel(&mut canvas, MARGIN[1], 0, linear, "m/s", "v");
        self.panel(&mut canvas, below, 3, angular, "rad/s", "w");
        let times = ticks(0.0, self.end(), 6);
        let middle = (MARGIN[0] + WIDTH - MARGIN[2]) / 2.0;
        canvas.time_axis(&times, |t| self.x(t), below + PANEL, middle);
        canvas
    }

    fn end(&self) -> f64 {
        self.period_s * self.twists.len().max(self.periods).max(1) as f64
    }

    fn x(&self, t: f64) -> f64 {
        MARGIN[0] + (WIDTH - MARGIN[0] - MARGIN[2]) * t / self.end()
    }

    fn panel(
        &self,
        canvas: &mut Canvas,
        top: f64,
        first: usize,
        limit: f64,
        unit: &str,
        name: &str,
    ) {
        let range = 1.15 * limit;
        let y = |value: f64| top + PANEL * (0.5 - 0.5 * value.clamp(-range, range) / range);
        let (left, right) = (MARGIN[0], WIDTH - MARGIN[2]);
        for value in ticks(-limit, limit, 4) {
            canvas.line([left, y(value)], [right, y(value)], GRID);
            canvas.text(left - 7.0, y(value) + 3.5, 10.0, "end", &label(value));
        }
        for value in [-limit, limit] {
            canvas.line([left, y(value)], [right, y(value)], LIMIT);
        }
        for (k, axis) in ["x", "y", "z"].iter().enumerate() {
            let colour = FEATURES[k];
            // A command holds for its period: stairs.
            let stairs = |twists: &[[f64; 6]]| {
                let steps = twists.iter().enumerate().flat_map(|(i, twist)| {
                    let value = y(twist[first + k]);
                    let t = self.period_s * i as f64;
                    [[self.x(t), value], [self.x(t + self.period_s), value]]
                });
                steps.collect::<Vec<_>>().into_iter()
            };
            let fine = self.twists.len() > DENSE;
            let width = if fine { 0.8 } else { 1.5 };
            let style = format!("stroke=\"{colour}\" stroke-width=\"{width}\"");
            canvas.polyline(stairs(&self.twists), &style);
            if !self.own.is_empty() {
                let style = format!("stroke=\"{colour}\" stroke-dasharray=\"1.5 2.5\"");
                canvas.polyline(stairs(&self.own), &style);
            }
            // Above the panel, where no curve runs.
            let x = right - 112.0 + 38.0 * k as f64;
            let style = format!("stroke=\"{colour}\" stroke-width=\"2\"");
            canvas.line([x, top - 7.0], [x + 12.0, top - 7.0], &style);
            canvas.text(x + 15.0, top - 3.5, 10.0, "start", &format!("{name}{axis}"));
        }
        canvas.frame([left, top], [right - left, PANEL]);
        canvas.text_upwards(13.0, top + PANEL / 2.0, unit);
    }
}
