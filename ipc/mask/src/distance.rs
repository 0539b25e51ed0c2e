//! Exact distances from sets of pixels.

use crate::patch::Patch;

/// Squares of pixels, column by column from `left` on: in each, the runs from one v to another.
struct Squares {
    left: i64,
    columns: Vec<Vec<[f64; 2]>>,
}

impl Squares {
    /// Euclidean distance of a point from the nearest square, px: zero inside one.
    fn distance(&self, [u, v]: [f64; 2]) -> f64 {
        let last = self.columns.len() as i64 - 1;
        let here = (u.floor() as i64 - self.left).clamp(0, last) as usize;
        let mut best = f64::INFINITY;
        let mut look = |column: usize| {
            let edge = (self.left + column as i64) as f64;
            let across = (edge - u).max(u - edge - 1.0).max(0.0);
            // Columns further out are further away.
            if across * across >= best {
                return false;
            }
            for [from, to] in &self.columns[column] {
                let along = (from - v).max(v - to).max(0.0);
                best = best.min(across * across + along * along);
            }
            true
        };
        for column in here..self.columns.len() {
            if !look(column) {
                break;
            }
        }
        for column in (0..here).rev() {
            if !look(column) {
                break;
            }
        }
        best.sqrt()
    }
}

/// A set of pixels and what lies round it.
pub struct Shape {
    inside: Squares,
    outside: Squares,
    low: [f64; 2],
    high: [f64; 2],
}

impl Shape {
    /// A set that is not empty, and of what lies round it as much as decides distances of points at
    /// most `beyond` px outside the image.
    pub fn of(patch: &Patch, beyond: i64) -> Self {
        let image = patch.image();
        let (first, last) = patch.window();
        // A window at the image's edge goes on beyond it.
        let reach = |k: usize| {
            let low = if first[k] == 0 { -beyond } else { first[k] };
            let high = if last[k] == image[k] - 1 {
                last[k] + beyond
            } else {
                last[k]
            };
            (low, high)
        };
        let ((left, right), (top, bottom)) = (reach(0), reach(1));
        let runs = |x: i64, wanted: bool, from: i64, to: i64| -> Vec<[f64; 2]> {
            let mut runs: Vec<[f64; 2]> = Vec::new();
            let mut y = from;
            while y <= to {
                let start = y;
                while y <= to && patch.holds([x, y]) == wanted {
                    y += 1;
                }
                if y > start {
                    runs.push([start as f64, y as f64]);
                }
                y += 1;
            }
            runs
        };
        // A frame one pixel wide round the window is all that lies outside of it and matters: where
        // there is any.
        let (above, below) = (
            top - i64::from(first[1] > 0),
            bottom + i64::from(last[1] < image[1] - 1),
        );
        let (before, after) = (
            left - i64::from(first[0] > 0),
            right + i64::from(last[0] < image[0] - 1),
        );
        Self {
            inside: Squares {
                left,
                columns: (left..=right).map(|x| runs(x, true, top, bottom)).collect(),
            },
            outside: Squares {
                left: before,
                columns: (before..=after)
                    .map(|x| runs(x, false, above, below))
                    .collect(),
            },
            low: [left as f64, top as f64],
            high: [(right + 1) as f64, (bottom + 1) as f64],
        }
    }

    /// Signed Euclidean distance of a point from the border, px: negative inside.
    pub fn distance(&self, point: [f64; 2]) -> f64 {
        let distance = self.inside.distance(point);
        if distance > 0.0 {
            distance
        } else {
            -self.outside.distance(point)
        }
    }

    /// Corners of a box round the set, px.
    pub fn bounds(&self) -> ([f64; 2], [f64; 2]) {
        (self.low, self.high)
    }
}
