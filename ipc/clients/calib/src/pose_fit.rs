//! Least squares on poses: mounting X and target B with R X C = B, where R is the robot in each
//! pose and C the target as the camera has it there, and further parameters that change R or C.
//!
//! A pose misses by B^-1 R X C: a shift and a turn, in the target's frame. How large they are is
//! estimated with the parameters, so that a robot that turns exactly and moves badly is weighed as
//! such. Source: K.-R. Koch, "Parameter Estimation and Hypothesis Testing in Linear Models" (1999),
//! section 3.6, variance components.

use nalgebra::{DMatrix, DVector, SVector};
use vision_calibration_core::{Iso3, Vec3};

/// Parameters of X and B, places before turns.
pub const COUNT: usize = 12;
/// Steps at most, and the change of a parameter (m, rad) or of a deviation that is none.
const STEPS: usize = 60;
const SMALL: f64 = 1e-9;
const SETTLED: f64 = 1e-4;
/// Step of the numeric derivative: m, rad, s, or a share.
const DELTA: f64 = 1e-5;
/// Smallest deviations, m and rad: they keep weights of exact poses finite.
const LEAST: [f64; 2] = [1e-7, 1e-7];
/// A robust fit counts a pose less that misses by more than this, of the expected.
const OUTLIER: f64 = 2.5;

/// R and C of a pose, given the further parameters; `None` where they are not known.
pub type At<'a> = dyn Fn(usize, &[f64]) -> Option<[Iso3; 2]> + 'a;

/// What is fitted.
pub struct Problem<'a> {
    /// Poses.
    pub count: usize,
    /// Parameters beside X and B; they start at 0.
    pub extra: usize,
    /// R and C of each pose.
    pub at: &'a At<'a>,
    /// Whether a pose that misses by much counts less (Huber's weights).
    pub is_robust: bool,
}

/// X, B and the further parameters.
#[derive(Clone, Debug)]
pub struct State {
    /// X: the camera on what carries it.
    pub mount: Iso3,
    /// B: the target where it is fixed.
    pub target: Iso3,
    /// The further parameters.
    pub extra: Vec<f64>,
}

/// A result.
#[derive(Clone, Debug)]
pub struct Fit {
    /// The parameters.
    pub state: State,
    /// Their covariance: X, B, then the others. X and B are moved and turned in their own frames.
    pub covariance: DMatrix<f64>,
    /// Standard deviations of a pose's shift along and turn about each axis, m and rad.
    pub sigma: [f64; 2],
    /// Sum of the squares of what poses miss by, in units of `sigma`, of so many numbers.
    pub squares: f64,
    /// See `squares`.
    pub numbers: usize,
    /// What each pose misses by, m and rad, in the target's frame.
    pub misses: Vec<Option<[Vec3; 2]>>,
}

impl State {
    fn moved(&self, by: &DVector<f64>) -> Self {
        let part = |first: usize| {
            let vector = |k: usize| Vec3::new(by[k], by[k + 1], by[k + 2]);
            Iso3::new(vector(first), vector(first + 3))
        };
        let extra = self.extra.iter().zip(by.iter().skip(COUNT));
        Self {
            mount: self.mount * part(0),
            target: self.target * part(6),
            extra: extra.map(|(old, by)| old + by).collect(),
        }
    }
}

impl Problem<'_> {
    fn miss(&self, state: &State, pose: usize) -> Option<[Vec3; 2]> {
        let [robot, seen] = (self.at)(pose, &state.extra)?;
        let off = state.target.inverse() * robot * state.mount * seen;
        Some([off.translation.vector, off.rotation.scaled_axis()])
    }

    /// Fits from a start. `sigma`, where given, stays; else it is estimated. `None` where the poses
    /// do not determine the parameters.
    pub fn solve(&self, mount: Iso3, target: Iso3, sigma: Option<[f64; 2]>) -> Option<Fit> {
        let mut state = State {
            mount,
            target,
            extra: vec![0.0; self.extra],
        };
        let mut deviation = sigma.unwrap_or([1e-3, 2e-3]);
        for _ in 0..STEPS {
            let system = self.system(&state, deviation)?;
            let step = &system.inverse * &system.right;
            let is_small = step.amax() < SMALL;
            if !step.amax().is_finite() {
                return None;
            }
            let factors = system.factors(deviation);
            let is_settled = factors.iter().all(|factor| (factor - 1.0).abs() < SETTLED);
            if is_small && (is_settled || sigma.is_some()) {
                let misses = (0..self.count).map(|pose| self.miss(&state, pose));
                return Some(Fit {
                    misses: misses.collect(),
                    covariance: system.inverse,
                    sigma: deviation,
                    squares: system.squares[0] + system.squares[1],
                    numbers: system.numbers,
                    state,
                });
            }
            state = state.moved(&step);
            if sigma.is_none() {
                for (k, factor) in factors.into_iter().enumerate() {
                    deviation[k] = (deviation[k] * factor).max(LEAST[k]);
                }
            }
        }
        None
    }

    fn system(&self, state: &State, sigma: [f64; 2]) -> Option<System> {
        let size = COUNT + self.extra;
        let mut normal = DMatrix::zeros(size, size);
        let mut system = System {
            inverse: DMatrix::zeros(0, 0),
            right: DVector::zeros(size),
            squares: [0.0; 2],
            rows: Vec::new(),
            numbers: 0,
        };
        let scaled = |[moved, turned]: [Vec3; 2]| {
            let (a, b) = (moved / sigma[0], turned / sigma[1]);
            SVector::<f64, 6>::from([a.x, a.y, a.z, b.x, b.y, b.z])
        };
        for pose in 0..self.count {
            let Some(now) = self.miss(state, pose).map(scaled) else {
                continue;
            };
            let length = (now.norm_squared() / 6.0).sqrt();
            let weight = match self.is_robust && length > OUTLIER {
                true => OUTLIER / length,
                false => 1.0,
            };
            let mut by = DMatrix::zeros(6, size);
            for k in 0..size {
                let mut step = DVector::zeros(size);
                step[k] = DELTA;
                let sides = [1.0, -1.0].map(|sign| self.miss(&state.moved(&(&step * sign)), pose));
                let [Some(above), Some(below)] = sides else {
                    continue;
                };
                by.set_column(k, &((scaled(above) - scaled(below)) / (2.0 * DELTA)));
            }
            normal += by.transpose() * &by * weight;
            system.right -= by.transpose() * now * weight;
            for (group, first) in [0, 3].into_iter().enumerate() {
                system.squares[group] += weight * now.fixed_rows::<3>(first).norm_squared();
            }
            system.numbers += 6;
            system.rows.push(by * weight.sqrt());
        }
        system.inverse = normal.cholesky()?.inverse();
        Some(system)
    }
}

/// The linearized problem, in units of the deviations.
struct System {
    inverse: DMatrix<f64>,
    right: DVector<f64>,
    /// Of shifts and of turns.
    squares: [f64; 2],
    rows: Vec<DMatrix<f64>>,
    numbers: usize,
}

impl System {
    /// By how much the deviations of shifts and turns are off, as the misses have it.
    fn factors(&self, sigma: [f64; 2]) -> [f64; 2] {
        let mut redundancy = [0.0; 2];
        for rows in &self.rows {
            let known = rows * &self.inverse * rows.transpose();
            for k in 0..6 {
                redundancy[k / 3] += 1.0 - known[(k, k)];
            }
        }
        let mut factors = [1.0; 2];
        for k in 0..2 {
            let factor = (self.squares[k] / redundancy[k].max(1.0)).sqrt();
            let is_least = sigma[k] <= LEAST[k] && factor < 1.0;
            factors[k] = if is_least { 1.0 } else { factor };
        }
        factors
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A robot's poses, and what a camera sees of a target that is larger than its file says.
    fn poses(mount: &Iso3, target: &Iso3, size: f64) -> Vec<[Iso3; 2]> {
        let turns = (0..9).map(|k| f64::from(k) * 0.7);
        let robots = turns.map(|k| {
            let turn = Vec3::new(0.5 * k.sin(), 0.4 * (1.7 * k).cos(), 0.6 * (2.3 * k).sin());
            Iso3::new(Vec3::new(0.4, 0.2 * k.sin(), 0.5 + 0.1 * k.cos()), turn)
        });
        let pair = |robot: Iso3| {
            let mut seen = (robot * mount).inverse() * target;
            seen.translation.vector /= size;
            [robot, seen]
        };
        robots.map(pair).collect()
    }

    #[test]
    fn mounting_target_and_a_further_parameter_are_found() {
        let mount = Iso3::new(Vec3::new(0.05, -0.04, 0.03), Vec3::new(0.1, 0.0, 0.8));
        let target = Iso3::new(Vec3::new(0.5, 0.0, 0.0), Vec3::new(3.0, 0.1, 0.0));
        let poses = poses(&mount, &target, 1.02);
        let at = |pose: usize, extra: &[f64]| {
            let [robot, mut seen] = poses[pose];
            seen.translation.vector *= 1.0 + extra.first().copied().unwrap_or(0.0);
            Some([robot, seen])
        };
        let problem = |extra| Problem {
            count: poses.len(),
            extra,
            at: &at,
            is_robust: false,
        };
        let off = Iso3::new(Vec3::new(0.01, 0.0, -0.02), Vec3::new(0.05, -0.04, 0.03));
        let fit = problem(1).solve(mount * off, target * off, None).unwrap();
        let apart = mount.inverse() * fit.state.mount;
        assert!(apart.translation.vector.norm() < 1e-6, "{apart}");
        assert!((fit.state.extra[0] - 0.02).abs() < 1e-6);
        let without = problem(0).solve(mount, target, None).unwrap();
        assert!(without.sigma[0] > 1e-4 && without.misses.len() == 9);
        // Without a turn, the place of the camera is anywhere.
        let still = |_: usize, _: &[f64]| Some(poses[0]);
        let problem = Problem {
            at: &still,
            ..problem(0)
        };
        assert!(problem.solve(mount, target, None).is_none());
    }
}
