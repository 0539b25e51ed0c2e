//! Solvers that a Rust user would otherwise take, on the same cost and constraints with exact
//! gradients.
//!
//! Both ask for cost, constraints and their gradients one by one; [`Nlp`] previews a command once
//! for all of them.

mod open;
mod slsqp;

use std::cell::{Ref, RefCell};

use scene::Part;
use vpc::prediction::Preview;
use vpc::{DOF, Twist, cost};

use crate::subproblem::Case;

pub use open::open;
pub use slsqp::slsqp;

/// The problem of a case as a nonlinear program: the cost over its value at rest, and rows that
/// must not be negative.
pub struct Nlp<'a> {
    case: &'a Case,
    unit: f64,
    seen: RefCell<Seen>,
}

struct Seen {
    twist: Option<Twist>,
    preview: Preview<'static, DOF>,
    cost: f64,
    gradient: Twist,
}

impl<'a> Nlp<'a> {
    fn new(case: &'a Case) -> Self {
        let points = case.initial.points.len();
        // A bench ends before this matters.
        let workspace = vec![0.0; Preview::<DOF>::room(case.np, points)].leak();
        let preview = Preview::new(case.np, points, workspace).unwrap();
        let seen = Seen {
            twist: None,
            preview,
            cost: 0.0,
            gradient: [0.0; DOF],
        };
        Self {
            case,
            unit: case.judge(&[0.0; DOF]).0.max(1.0),
            seen: RefCell::new(seen),
        }
    }

    /// Rows: the four sides and every part, for every point of every step.
    fn rows(&self) -> usize {
        self.case.np * self.case.initial.points.len() * self.sides()
    }

    fn sides(&self) -> usize {
        4 + self.case.task.parts.len()
    }

    fn at(&self, x: &[f64]) -> Ref<'_, Seen> {
        let twist: Twist = core::array::from_fn(|k| x[k]);
        if self.seen.borrow().twist != Some(twist) {
            self.seen.borrow_mut().look(self.case, self.unit, twist);
        }
        self.seen.borrow()
    }

    fn cost(&self, x: &[f64]) -> (f64, Twist) {
        let seen = self.at(x);
        (seen.cost, seen.gradient)
    }

    /// Row `i` and, where asked for, its gradient.
    fn row(&self, x: &[f64], i: usize, gradient: Option<&mut [f64]>) -> f64 {
        let seen = self.at(x);
        let (sides, count) = (self.sides(), self.case.initial.points.len());
        let (point, side) = (i / sides, i % sides);
        let pixel = seen.preview.step(point / count)[point % count];
        let camera = &self.case.task.camera;
        let (value, slope) = match side {
            0 => (pixel[0], [1.0, 0.0]),
            1 => (pixel[1], [0.0, 1.0]),
            2 => (camera.width - pixel[0], [-1.0, 0.0]),
            3 => (camera.height - pixel[1], [0.0, -1.0]),
            _ => outside(&self.case.task.parts[side - 4], pixel),
        };
        if let Some(gradient) = gradient {
            let mut step = seen.preview.steps().nth(point / count).unwrap();
            let [du, dv] = step.nth(point % count).unwrap().gradient;
            for k in 0..DOF {
                gradient[k] = slope[0] * du[k] + slope[1] * dv[k];
            }
        }
        value
    }
}

impl Seen {
    fn look(&mut self, case: &Case, unit: f64, twist: Twist) {
        assert!(
            self.preview
                .linearize(&case.task, &case.initial, &twist, case.task.ts)
        );
        let weights = &case.task.cost;
        let commands = (case.np - 1) as f64;
        self.cost = cost::value(&case.problem(), &self.preview, &twist) / unit;
        self.gradient = core::array::from_fn(|k| 2.0 * commands * weights.r[k] * twist[k] / unit);
        let two_q = 2.0 * weights.k_q / unit;
        for step in self.preview.steps() {
            for (point, target) in step.zip(&case.target) {
                for c in 0..2 {
                    let pull = two_q * (point.place.pixel[c] - target[c]);
                    for k in 0..DOF {
                        self.gradient[k] += pull * point.gradient[c][k];
                    }
                }
            }
        }
        self.twist = Some(twist);
    }
}

/// (||d||_p - 1) scaled to px by the smaller half size, and its gradient.
fn outside(part: &Part, pixel: [f64; 2]) -> (f64, [f64; 2]) {
    let offset: [f64; 2] = core::array::from_fn(|c| (pixel[c] - part.center[c]) / part.half[c]);
    let power = |x: f64| {
        if part.p.fract() == 0.0 {
            x.powi(part.p as i32)
        } else {
            x.powf(part.p)
        }
    };
    let size = offset.map(f64::abs);
    let norm = (power(size[0]) + power(size[1])).powf(1.0 / part.p);
    let scale = part.half[0].min(part.half[1]);
    let slope = core::array::from_fn(|c| {
        let share = size[c] / norm;
        let steep = if share > 0.0 {
            power(share) / share
        } else {
            0.0
        };
        scale * offset[c].signum() * steep / part.half[c]
    });
    (scale * (norm - 1.0), slope)
}
