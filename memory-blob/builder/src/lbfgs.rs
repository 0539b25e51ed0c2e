//! Limited-memory BFGS in a box, for smooth functions of a few variables that are dear to evaluate.
//!
//! Each iteration takes the two-loop quasi-Newton direction over the variables that are free (not
//! held at a bound by their gradient), walks along it with every point clipped to the box, and
//! looks for a step that satisfies the Armijo condition and, while the box allows, the weak
//! curvature condition (doubling, then bisection). A point where the function has no value counts
//! as infinitely high. Iterations and evaluations are bounded.
//!
//! Source: Nocedal and Wright, Numerical Optimization, 2nd ed., Alg. 7.4 and Sect. 16.7
//! (projection).

use std::collections::VecDeque;

/// Share of the predicted decrease that a step must reach.
const ARMIJO: f64 = 1e-4;
/// Share of the slope that may be left after a step.
const CURVATURE: f64 = 0.9;
/// Evaluations in one line search.
const LINE_SEARCH_STEPS: usize = 20;

/// Pairs of steps and gradient changes that are remembered.
const MEMORY: usize = 10;
/// Most iterations.
const MAX_ITERATIONS: usize = 100;
/// Largest change of one variable in the first trial of an iteration.
const LARGEST_STEP: f64 = 2.0;

/// When to stop.
#[derive(Clone, Debug, PartialEq)]
pub struct Settings {
    /// Most evaluations of the function, at least 1.
    pub max_evaluations: usize,
    /// Converged when no component of the projected gradient is larger than this.
    pub gradient_tolerance: f64,
    /// Converged when an iteration gains less than this times max(1, |value|).
    pub value_tolerance: f64,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            max_evaluations: 150,
            gradient_tolerance: 1e-6,
            value_tolerance: 1e-9,
        }
    }
}

/// Where the search ended.
#[derive(Clone, Debug)]
pub struct Minimum {
    /// The lowest point, inside the box.
    pub point: Vec<f64>,
    /// The function there.
    pub value: f64,
    /// Evaluations used.
    pub evaluations: usize,
}

/// A function with its gradient; `None` where it has no value.
type Evaluation = Option<(f64, Vec<f64>)>;

#[derive(Clone)]
struct Iterate {
    point: Vec<f64>,
    value: f64,
    gradient: Vec<f64>,
}

struct Search<'a, F> {
    function: F,
    lower: &'a [f64],
    upper: &'a [f64],
    settings: &'a Settings,
    evaluations: usize,
    pairs: VecDeque<(Vec<f64>, Vec<f64>)>,
}

/// Minimises `function` (value and gradient, `None` where it has none) over the box `lower <= x <=
/// upper`, from `start` clipped to the box. All slices have one length. Returns `None` when the
/// function has no value at the start.
pub fn minimise(
    function: impl FnMut(&[f64]) -> Evaluation,
    start: &[f64],
    lower: &[f64],
    upper: &[f64],
    settings: &Settings,
) -> Option<Minimum> {
    let mut search = Search {
        function,
        lower,
        upper,
        settings,
        evaluations: 0,
        pairs: VecDeque::new(),
    };
    let mut current = search.evaluate(clip(start.iter().copied(), lower, upper))?;
    for _ in 0..MAX_ITERATIONS {
        if search.projected_gradient(&current) <= settings.gradient_tolerance {
            break;
        }
        let mut next = search.descend(&current);
        if next.is_none() && !search.pairs.is_empty() {
            // The remembered curvature may be the culprit: once more, along the gradient.
            search.pairs.clear();
            next = search.descend(&current);
        }
        let Some(next) = next else { break };
        let gain = current.value - next.value;
        search.remember(&current, &next);
        current = next;
        if gain <= settings.value_tolerance * current.value.abs().max(1.0) {
            break;
        }
    }
    Some(Minimum {
        point: current.point,
        value: current.value,
        evaluations: search.evaluations,
    })
}

impl<F: FnMut(&[f64]) -> Evaluation> Search<'_, F> {
    fn evaluate(&mut self, point: Vec<f64>) -> Option<Iterate> {
        self.evaluations += 1;
        let (value, gradient) = (self.function)(&point)?;
        let finite = value.is_finite() && gradient.iter().all(|g| g.is_finite());
        finite.then_some(Iterate {
            point,
            value,
            gradient,
        })
    }

    /// Largest move of one variable under a unit step down the gradient inside the box.
    fn projected_gradient(&self, at: &Iterate) -> f64 {
        let stepped = at.point.iter().zip(&at.gradient).map(|(x, g)| x - g);
        let stepped = clip(stepped, self.lower, self.upper);
        stepped
            .iter()
            .zip(&at.point)
            .map(|(a, b)| (a - b).abs())
            .fold(0.0, f64::max)
    }

    /// One iteration: a direction and a line search. `None` when no lower point was found.
    fn descend(&mut self, from: &Iterate) -> Option<Iterate> {
        let direction = self.direction(from);
        let (mut short, mut long) = (0.0, f64::INFINITY);
        let mut step = 1.0;
        let mut accepted: Option<Iterate> = None;
        for _ in 0..LINE_SEARCH_STEPS {
            if self.evaluations >= self.settings.max_evaluations {
                break;
            }
            let moved = from.point.iter().zip(&direction).map(|(x, d)| x + step * d);
            let point = clip(moved, self.lower, self.upper);
            if accepted.as_ref().is_some_and(|a| a.point == point) || point == from.point {
                break; // the box stops any further step, or the step is below rounding
            }
            let trial = self.evaluate(point);
            let slope = |at: &Iterate, gradient: &[f64]| -> f64 {
                let moved = at.point.iter().zip(&from.point).map(|(a, b)| a - b);
                moved.zip(gradient).map(|(m, g)| m * g).sum()
            };
            match trial {
                Some(t) if t.value <= from.value + ARMIJO * slope(&t, &from.gradient) => {
                    let flat = slope(&t, &t.gradient) >= CURVATURE * slope(&t, &from.gradient);
                    if accepted.as_ref().is_none_or(|a| t.value < a.value) {
                        accepted = Some(t);
                    }
                    if flat {
                        break;
                    }
                    short = step;
                }
                _ => long = step,
            }
            step = if long.is_finite() {
                0.5 * (short + long)
            } else {
                2.0 * step
            };
        }
        accepted.filter(|a| a.value < from.value)
    }

    /// Quasi-Newton direction over the free variables, never longer than the largest step; zero for
    /// the others.
    fn direction(&self, at: &Iterate) -> Vec<f64> {
        let free: Vec<bool> = (0..at.point.len())
            .map(|i| {
                let (x, g) = (at.point[i], at.gradient[i]);
                !(x <= self.lower[i] && g > 0.0 || x >= self.upper[i] && g < 0.0)
            })
            .collect();
        let gradient: Vec<f64> = at
            .gradient
            .iter()
            .zip(&free)
            .map(|(&g, &free)| if free { g } else { 0.0 })
            .collect();
        let mut direction = self.newton(&gradient, &free);
        let descent = dot(&direction, &gradient);
        if self.pairs.is_empty() || descent >= -1e-12 * dot(&gradient, &gradient) {
            // without curvature: move the steepest variable by at most 1
            let size = largest(&gradient).max(1.0);
            direction = gradient.iter().map(|g| -g / size).collect();
        }
        let excess = largest(&direction) / LARGEST_STEP;
        if excess > 1.0 {
            direction.iter_mut().for_each(|d| *d /= excess);
        }
        direction
    }

    /// Two-loop recursion with all pairs restricted to the free variables.
    fn newton(&self, gradient: &[f64], free: &[bool]) -> Vec<f64> {
        let inner = |a: &[f64], b: &[f64]| -> f64 {
            a.iter()
                .zip(b)
                .zip(free)
                .filter(|(_, free)| **free)
                .map(|((a, b), _)| a * b)
                .sum()
        };
        let mut q: Vec<f64> = gradient.iter().map(|g| -g).collect();
        let mut used = Vec::with_capacity(self.pairs.len());
        for (s, y) in self.pairs.iter().rev() {
            let sy = inner(s, y);
            if sy > 1e-10 * inner(y, y).max(inner(s, s)) {
                let alpha = inner(s, &q) / sy;
                add(&mut q, -alpha, y, free);
                used.push((s, y, sy, alpha));
            }
        }
        if let Some((_, y, sy, _)) = used.first() {
            let scale = sy / inner(y, y);
            q.iter_mut().for_each(|q| *q *= scale);
        }
        for (s, y, sy, alpha) in used.into_iter().rev() {
            let beta = inner(y, &q) / sy;
            add(&mut q, alpha - beta, s, free);
        }
        q
    }

    fn remember(&mut self, from: &Iterate, to: &Iterate) {
        let difference =
            |a: &[f64], b: &[f64]| -> Vec<f64> { a.iter().zip(b).map(|(a, b)| a - b).collect() };
        let (s, y) = (
            difference(&to.point, &from.point),
            difference(&to.gradient, &from.gradient),
        );
        if dot(&s, &y) > 1e-10 * dot(&y, &y).max(dot(&s, &s)) {
            if self.pairs.len() == MEMORY {
                self.pairs.pop_front();
            }
            self.pairs.push_back((s, y));
        }
    }
}

fn clip(point: impl Iterator<Item = f64>, lower: &[f64], upper: &[f64]) -> Vec<f64> {
    point
        .zip(lower.iter().zip(upper))
        .map(|(x, (&low, &high))| x.max(low).min(high))
        .collect()
}

fn add(to: &mut [f64], factor: f64, what: &[f64], free: &[bool]) {
    for ((to, what), _) in to.iter_mut().zip(what).zip(free).filter(|(_, free)| **free) {
        *to += factor * what;
    }
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

fn largest(a: &[f64]) -> f64 {
    a.iter().fold(0.0, |size, a| size.max(a.abs()))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rosenbrock(x: &[f64]) -> Evaluation {
        let (a, b) = (1.0 - x[0], x[1] - x[0] * x[0]);
        Some((
            a * a + 100.0 * b * b,
            vec![-2.0 * a - 400.0 * x[0] * b, 200.0 * b],
        ))
    }

    #[test]
    fn curved_valley_is_followed_to_its_end() {
        let settings = Settings {
            value_tolerance: 0.0,
            ..Settings::default()
        };
        let found = minimise(rosenbrock, &[-1.2, 1.0], &[-5.0; 2], &[5.0; 2], &settings).unwrap();
        assert!((found.point[0] - 1.0).abs() < 1e-5 && (found.point[1] - 1.0).abs() < 1e-5);
        assert!(found.evaluations < 80, "{} evaluations", found.evaluations);
    }

    #[test]
    fn minimum_on_a_face_of_the_box_is_found() {
        // With x0 <= 0.5 the lowest point is (0.5, 0.25).
        let settings = Settings {
            value_tolerance: 0.0,
            ..Settings::default()
        };
        let found = minimise(rosenbrock, &[-1.2, 3.0], &[-5.0; 2], &[0.5, 5.0], &settings).unwrap();
        assert!((found.point[0] - 0.5).abs() < 1e-9, "{:?}", found.point);
        assert!((found.point[1] - 0.25).abs() < 1e-6, "{:?}", found.point);
    }

    #[test]
    fn minimum_in_a_corner_is_found_from_outside_of_the_box() {
        let plane = |x: &[f64]| Some((x[0] - 2.0 * x[1], vec![1.0, -2.0]));
        let found = minimise(
            plane,
            &[9.0, -9.0],
            &[-1.0; 2],
            &[3.0; 2],
            &Settings::default(),
        )
        .unwrap();
        assert_eq!(found.point, [-1.0, 3.0]);
    }

    #[test]
    fn badly_scaled_bowl_takes_few_evaluations() {
        let weights: Vec<f64> = (0..12).map(|i| 10f64.powf(f64::from(i) / 4.0)).collect();
        let bowl = |x: &[f64]| {
            let gradient: Vec<f64> = x.iter().zip(&weights).map(|(x, w)| w * (x - 0.3)).collect();
            let value = x
                .iter()
                .zip(&gradient)
                .map(|(x, g)| 0.5 * g * (x - 0.3))
                .sum();
            Some((value, gradient))
        };
        let settings = Settings {
            value_tolerance: 0.0,
            ..Settings::default()
        };
        let found = minimise(bowl, &[-1.0; 12], &[-9.0; 12], &[9.0; 12], &settings).unwrap();
        assert!(
            found.point.iter().all(|x| (x - 0.3).abs() < 1e-5),
            "{:?}",
            found.point
        );
        // SciPy's L-BFGS-B takes 99 to the same tolerance of the gradient
        assert!(found.evaluations < 99, "{} evaluations", found.evaluations);
    }

    #[test]
    fn leaning_bowls_meet_the_optimality_conditions() {
        // A = B^T B + 0.1 I with B from a fixed sequence; the bowl's own lowest point is outside.
        const SIZE: usize = 8;
        let mut state = 1_u64;
        let mut draw = || {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1);
            (state >> 33) as f64 / f64::from(1_u32 << 31) * 2.0 - 1.0
        };
        let (mut held, mut evaluations) = (0, 0);
        for _ in 0..40 {
            let b: Vec<[f64; SIZE]> = (0..SIZE).map(|_| std::array::from_fn(|_| draw())).collect();
            let target: [f64; SIZE] = std::array::from_fn(|_| 3.0 * draw());
            let bowl = |x: &[f64]| {
                let e: Vec<f64> = x.iter().zip(&target).map(|(x, t)| x - t).collect();
                let be: Vec<f64> = b.iter().map(|row| dot(row, &e)).collect();
                let column = |i: usize| b.iter().zip(&be).map(|(row, be)| row[i] * be).sum::<f64>();
                let gradient: Vec<f64> = (0..SIZE).map(|i| column(i) + 0.1 * e[i]).collect();
                Some((0.5 * dot(&e, &gradient), gradient))
            };
            let settings = Settings {
                value_tolerance: 0.0,
                ..Settings::default()
            };
            let found = minimise(bowl, &[0.0; SIZE], &[-1.0; SIZE], &[1.0; SIZE], &settings);
            let found = found.unwrap();
            let (_, gradient) = bowl(&found.point).unwrap();
            for (x, g) in found.point.iter().zip(gradient) {
                held += usize::from(x.abs() == 1.0);
                let optimal = g.abs() < 1e-5 || (*x == 1.0 && g < 0.0) || (*x == -1.0 && g > 0.0);
                assert!(optimal, "slope {g} at {x}");
            }
            evaluations += found.evaluations;
        }
        assert!(held > 40, "only {held} variables ended on a face");
        assert!(evaluations < 40 * 15, "{evaluations} evaluations");
    }

    #[test]
    fn long_even_slope_is_crossed_by_doubling_the_step() {
        let cone = |x: &[f64]| {
            let height = (1.0 + x[0] * x[0]).sqrt();
            Some((height, vec![x[0] / height]))
        };
        let found = minimise(cone, &[1000.0], &[-1e4], &[1e4], &Settings::default()).unwrap();
        assert!(found.point[0].abs() < 1e-3, "{:?}", found.point);
        assert!(found.evaluations < 50, "{} evaluations", found.evaluations);
    }

    #[test]
    fn holes_in_the_function_are_walked_around() {
        // ln x exists only above 0; the first steps jump below.
        let barrier = |x: &[f64]| (x[0] > 0.0).then(|| (x[0] - x[0].ln(), vec![1.0 - 1.0 / x[0]]));
        let found = minimise(barrier, &[3.0], &[-10.0], &[10.0], &Settings::default()).unwrap();
        assert!((found.point[0] - 1.0).abs() < 1e-4, "{:?}", found.point);
        assert!(minimise(barrier, &[-1.0], &[-10.0], &[10.0], &Settings::default()).is_none());
    }

    #[test]
    fn budget_of_evaluations_is_kept_and_named() {
        let mut count = 0;
        let counted = |x: &[f64]| {
            count += 1;
            rosenbrock(x)
        };
        let settings = Settings {
            max_evaluations: 7,
            ..Settings::default()
        };
        let found = minimise(counted, &[-1.2, 1.0], &[-5.0; 2], &[5.0; 2], &settings).unwrap();
        assert_eq!((count, found.evaluations), (7, 7));
        assert!(found.value < rosenbrock(&[-1.2, 1.0]).unwrap().0);
    }
}
