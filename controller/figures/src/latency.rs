//! Distributions of times, one below the other.

use crate::canvas::{Canvas, FEATURES, GRID, label};

const WIDTH: f64 = 560.0;
const PANEL: f64 = 84.0;
const MARGIN: [f64; 4] = [52.0, 30.0, 22.0, 52.0];
const GAP: f64 = 26.0;
/// Bars for each tenfold of time.
const BARS: usize = 20;

/// Times of one kind.
#[derive(Clone, Debug)]
pub struct Times {
    /// Title on the left.
    pub name: String,
    /// us, in any order.
    pub values_us: Vec<f64>,
    /// Text on the right.
    pub note: String,
}

/// Histograms of times on one logarithmic axis.
#[derive(Clone, Debug)]
pub struct Latency {
    /// From above.
    pub panels: Vec<Times>,
    /// The period, us, drawn as the longest time allowed.
    pub limit_us: Option<f64>,
    /// Title.
    pub title: String,
}

impl Latency {
    /// Draws the figure; sizes are in px.
    pub fn canvas(&self) -> Canvas {
        let count = self.panels.len().max(1) as f64;
        let height = MARGIN[1] + count * (PANEL + GAP) - GAP + MARGIN[3];
        let mut canvas = Canvas::new(WIDTH, height);
        canvas.text(WIDTH / 2.0, 18.0, 12.0, "middle", &self.title);
        let axis = self.axis();
        for (i, times) in self.panels.iter().enumerate() {
            let top = MARGIN[1] + GAP / 2.0 + i as f64 * (PANEL + GAP);
            let colour = FEATURES[i % FEATURES.len()];
            self.panel(&mut canvas, axis, top, times, colour);
        }
        let bottom = height - MARGIN[3] + GAP / 2.0;
        for decade in axis.0..=axis.1 {
            let x = position(axis, 10f64.powi(decade));
            canvas.text(x, bottom + 14.0, 10.0, "middle", &time(decade));
        }
        let words = match self.limit_us {
            Some(_) => "time; red: the period",
            None => "time",
        };
        canvas.text(WIDTH / 2.0, bottom + 31.0, 11.0, "middle", words);
        canvas
    }

    /// The tenfolds that hold all times and the limit.
    fn axis(&self) -> (i32, i32) {
        let times = self.panels.iter().flat_map(|times| &times.values_us);
        let seen = times.chain(&self.limit_us).copied();
        let (low, high) = seen
            .filter(|us| us.is_finite() && *us > 0.0)
            .fold((f64::INFINITY, 0.0_f64), |(low, high), us| {
                (low.min(us), high.max(us))
            });
        if low > high {
            return (0, 3);
        }
        let low = low.log10().floor() as i32;
        (low, (high.log10().ceil() as i32).max(low + 1))
    }

    fn panel(&self, canvas: &mut Canvas, axis: (i32, i32), top: f64, times: &Times, colour: &str) {
        let (left, right) = (MARGIN[0], WIDTH - MARGIN[2]);
        let bottom = top + PANEL;
        for decade in axis.0..=axis.1 {
            let x = position(axis, 10f64.powi(decade));
            canvas.line([x, top], [x, bottom], GRID);
        }
        let counts = bars(axis, &times.values_us);
        let most = counts.iter().copied().max().unwrap_or(0).max(1) as f64;
        let wide = (right - left) / counts.len() as f64;
        for (i, count) in counts.iter().enumerate().filter(|(_, count)| **count > 0) {
            // A single outlier must be seen beside thousands.
            let tall = (PANEL - 8.0) * (*count as f64).ln_1p() / most.ln_1p();
            let corner = [left + wide * i as f64, bottom - tall];
            canvas.rect(corner, [wide - 0.6, tall], &format!("fill=\"{colour}\""));
        }
        for value in [1.0, most] {
            let y = bottom - (PANEL - 8.0) * value.ln_1p() / most.ln_1p();
            canvas.text(left - 7.0, y + 3.5, 9.0, "end", &label(value));
        }
        if let Some(limit) = self.limit_us {
            let x = position(axis, limit);
            let style = "stroke=\"#d81f1f\" stroke-dasharray=\"5 4\"";
            canvas.line([x, top], [x, bottom], style);
        }
        canvas.frame([left, top], [right - left, PANEL]);
        canvas.text(left, top - 5.0, 11.0, "start", &times.name);
        canvas.text(right, top - 5.0, 10.0, "end", &times.note);
    }
}

fn position(axis: (i32, i32), us: f64) -> f64 {
    let share = (us.log10() - f64::from(axis.0)) / f64::from(axis.1 - axis.0);
    MARGIN[0] + (WIDTH - MARGIN[0] - MARGIN[2]) * share.clamp(0.0, 1.0)
}

/// How many times fall into each bar; zeros fall into the first.
fn bars(axis: (i32, i32), values_us: &[f64]) -> Vec<usize> {
    let mut counts = vec![0; (axis.1 - axis.0) as usize * BARS];
    let last = counts.len() - 1;
    for us in values_us {
        // The cast saturates: zero and less are the first bar.
        let bar = ((us.log10() - f64::from(axis.0)) * BARS as f64).floor() as usize;
        counts[bar.min(last)] += 1;
    }
    counts
}

/// A power of ten of us, in words.
fn time(decade: i32) -> String {
    let us = 10f64.powi(decade);
    match decade {
        6.. => format!("{} s", label(us / 1e6)),
        3..=5 => format!("{} ms", label(us / 1e3)),
        0..=2 => format!("{} us", label(us)),
        _ => format!("{} ns", label(us * 1e3)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_time_is_counted_once_and_zero_comes_first() {
        let counts = bars((0, 2), &[0.0, 1.0, 9.99, 10.0, 99.9, 1e9]);
        assert_eq!(counts.iter().sum::<usize>(), 6);
        assert_eq!(
            (counts[0], counts[19], counts[20], counts[39]),
            (2, 1, 1, 2)
        );
    }

    #[test]
    fn the_axis_holds_the_limit_and_survives_without_times() {
        let figure = |values_us: Vec<f64>, limit_us| Latency {
            panels: vec![Times {
                name: "step".to_owned(),
                values_us,
                note: String::new(),
            }],
            limit_us,
            title: String::new(),
        };
        assert_eq!(figure(vec![3.0, 40.0], Some(33_333.0)).axis(), (0, 5));
        assert_eq!(figure(vec![0.0], None).axis(), (0, 3));
        let told = |limit_us| {
            let svg = figure(vec![3.0], limit_us).canvas().svg();
            svg.contains("red: the period")
        };
        assert!(told(Some(33_333.0)) && !told(None));
        assert!(figure(Vec::new(), None).canvas().svg().contains("1 ms"));
        assert_eq!(
            (time(-1), time(4), time(6)),
            ("100 ns".into(), "10 ms".into(), "1 s".into())
        );
    }
}
