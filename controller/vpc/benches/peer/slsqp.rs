//! The crate `slsqp`: Kraft's method, NLopt's code in Rust.

use slsqp::{StopTols, minimize};
use vpc::{DOF, Twist};

use super::Nlp;
use crate::subproblem::Case;

type Row<'a> = Box<dyn Fn(&[f64], Option<&mut [f64]>, &mut ()) -> f64 + 'a>;

/// Its answer from a start, with at most 100 evaluations of the cost; whatever it ends with.
pub fn slsqp(case: &Case, start: &Twist) -> Twist {
    let nlp = Nlp::new(case);
    let objective = |x: &[f64], gradient: Option<&mut [f64]>, _: &mut ()| {
        let (cost, slope) = nlp.cost(x);
        if let Some(gradient) = gradient {
            gradient.copy_from_slice(&slope);
        }
        cost
    };
    // Its rows must end below zero.
    let rows: Vec<Row<'_>> = (0..nlp.rows())
        .map(|i| {
            let nlp = &nlp;
            let row: Row<'_> = Box::new(move |x, gradient, _| match gradient {
                Some(gradient) => {
                    let value = nlp.row(x, i, Some(gradient));
                    gradient.iter_mut().for_each(|g| *g = -*g);
                    -value
                }
                None => -nlp.row(x, i, None),
            });
            row
        })
        .collect();
    let bounds = case.task.limits.map(|limit| (-limit, limit));
    let stop = StopTols {
        ftol_rel: 1e-6,
        ..StopTols::default()
    };
    let (Ok((_, x, _)) | Err((_, x, _))) =
        minimize(objective, start, &bounds, &rows, (), 100, Some(stop));
    core::array::from_fn::<f64, DOF, _>(|k| x[k].clamp(bounds[k].0, bounds[k].1))
}
