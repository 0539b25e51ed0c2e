//! The crate `optimization_engine` (OpEn): PANOC inside an augmented Lagrangian.

use optimization_engine::SolverError;
use optimization_engine::alm::*;
use optimization_engine::constraints::Rectangle;
use optimization_engine::core::panoc::PANOCCache;
use vpc::{DOF, Twist};

use super::Nlp;
use crate::subproblem::Case;

/// Its answer from a start; whatever it ends with.
pub fn open(case: &Case, start: &Twist) -> Twist {
    let nlp = Nlp::new(case);
    let rows = nlp.rows();
    let f = |x: &[f64], cost: &mut f64| -> Result<(), SolverError> {
        *cost = nlp.cost(x).0;
        Ok(())
    };
    let df = |x: &[f64], gradient: &mut [f64]| -> Result<(), SolverError> {
        gradient.copy_from_slice(&nlp.cost(x).1);
        Ok(())
    };
    let f1 = |x: &[f64], values: &mut [f64]| -> Result<(), SolverError> {
        for (i, value) in values.iter_mut().enumerate() {
            *value = nlp.row(x, i, None);
        }
        Ok(())
    };
    let f1_product = |x: &[f64], d: &[f64], product: &mut [f64]| -> Result<(), SolverError> {
        product.fill(0.0);
        let mut slope = [0.0; DOF];
        for (i, d) in d.iter().enumerate().filter(|(_, d)| **d != 0.0) {
            nlp.row(x, i, Some(&mut slope));
            product
                .iter_mut()
                .zip(&slope)
                .for_each(|(p, s)| *p += d * s);
        }
        Ok(())
    };
    let (lower, upper) = (case.task.limits.map(|l| -l), case.task.limits);
    let (zero, least, most) = (vec![0.0; rows], vec![-1e12; rows], vec![1e12; rows]);
    let allowed = Rectangle::new(Some(&zero), None);
    let factory = AlmFactory::new(
        f,
        df,
        Some(f1),
        Some(f1_product),
        NO_MAPPING,
        NO_JACOBIAN_MAPPING,
        Some(allowed),
        0,
    );
    let problem = AlmProblem::new(
        Rectangle::new(Some(&lower), Some(&upper)),
        Some(allowed),
        Some(Rectangle::new(Some(&least), Some(&most))),
        |u: &[f64], xi: &[f64], cost: &mut f64| factory.psi(u, xi, cost),
        |u: &[f64], xi: &[f64], gradient: &mut [f64]| factory.d_psi(u, xi, gradient),
        Some(f1),
        NO_MAPPING,
        rows,
        0,
    );
    let mut cache = AlmCache::new(PANOCCache::new(DOF, 1e-4, 5), rows, 0);
    let mut optimizer = AlmOptimizer::new(&mut cache, problem)
        .with_epsilon_tolerance(1e-4)
        .with_delta_tolerance(0.01)
        .with_initial_penalty(1e-3)
        .with_max_outer_iterations(20)
        .with_max_inner_iterations(500);
    let mut x = *start;
    // It ends with its last iterate where it gives up, too.
    let _ = optimizer.solve(&mut x);
    core::array::from_fn(|k| x[k].clamp(lower[k], upper[k]))
}
