//! One step of a trajectory: the paper's FIND SOLUTION.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use vpc::prediction::{InitialState, Plan};
use vpc::problem::Problem;
use vpc::recall::{self, Recall};
use vpc::solver::{Size, Solver};
use vpc::{MAX_VARIABLES, Points, Strategy, Task, Twist, cost};

use crate::settings::BuildSettings;
use crate::store::Store;

/// Random directions tried after the predefined ones.
const RANDOM_DIRECTIONS: usize = 10;
/// Predefined directions: each component of the camera velocity, both ways.
const PREDEFINED_DIRECTIONS: usize = 12;
/// Components below this share of their limits are standing still.
const STILL: f64 = 0.02;

/// Finds commands.
pub struct Finder<'a> {
    /// The task.
    pub task: &'a Task,
    /// The settings of the builder.
    pub settings: &'a BuildSettings,
    /// How large its problems are, and the solver's workspace for them.
    size: Size,
    workspace: Vec<f64>,
}

impl<'a> Finder<'a> {
    /// A finder with a solver of its own.
    pub fn new(task: &'a Task, settings: &'a BuildSettings) -> Self {
        let size = Size::of(task, settings.np, 1);
        Self {
            task,
            settings,
            size,
            workspace: vec![0.0; size.workspace()],
        }
    }

    /// The next command from the features `points`: guided by the memory where features are close
    /// to an occlusion (`store` is given once it holds enough trajectories), else from the
    /// `previous` command; and where that gives no success, or the features do not move any more,
    /// from 12 predefined and 10 random directions. `None` where every start fails.
    ///
    /// Source: paper, the second algorithm.
    pub fn find(
        &mut self,
        points: &Points,
        previous: &Twist,
        is_stalled: bool,
        store: Option<&Store>,
        rng: &mut ChaCha8Rng,
    ) -> Option<Twist> {
        let initial = InitialState::new(self.task, BuildSettings::MODEL, points);
        let close = recall::clearance(self.task, &initial) < self.settings.trigger_px;
        let recalled = store
            .filter(|_| close)
            .and_then(|store| recall::query(self.task, Strategy::Knn { k: 1 }, store, points));
        let first = match recalled {
            Some(Recall { twist, way_point }) => self.solve(points, &way_point, &twist),
            None => self.solve(points, &self.task.goal.clone(), previous),
        };
        let mut random = ChaCha8Rng::from_rng(rng);
        let limits = self.task.limits;
        let may_do = |twist: &Twist| !is_stalled || moves(twist, &limits);
        first.filter(may_do).or_else(|| {
            let goal = self.task.goal.clone();
            let predefined = (0..PREDEFINED_DIRECTIONS)
                .map(|k| self.direction(k))
                .collect::<Vec<_>>();
            let random = (0..RANDOM_DIRECTIONS)
                .map(|_| self.random_direction(&mut random))
                .collect::<Vec<_>>();
            predefined
                .iter()
                .chain(&random)
                .filter_map(|start| self.solve(points, &goal, start))
                .find(may_do)
                .or(first)
        })
    }

    /// Solves one problem from `warm` towards `target`; `None` where the solution violates a
    /// constraint or did not converge.
    pub fn solve(&mut self, points: &Points, target: &Points, warm: &Twist) -> Option<Twist> {
        let initial = InitialState::new(self.task, BuildSettings::MODEL, points);
        let problem = Problem {
            task: self.task,
            initial: &initial,
            target,
            r_share: cost::r_share(self.task, points, target),
            change_share: 0.0,
            standing: [0.0; 6],
            interval: f64::INFINITY,
            ts: self.task.ts,
            margin: 0.0,
            dampers: None,
            view: None,
            wanted: None,
            watched: vpc::MAX_NP,
        };
        let plan: Plan = std::array::from_fn(|k| if k < 6 { warm[k] } else { 0.0 });
        let mut solver = Solver::new(self.size, self.settings.solver(), &mut self.workspace)?;
        let solution = solver.solve_from(&problem, &plan, &[0.0; MAX_VARIABLES]);
        solution
            .status
            .is_feasible()
            .then(|| std::array::from_fn(|k| solution.plan[k]))
    }

    fn direction(&self, k: usize) -> Twist {
        let sign = if k.is_multiple_of(2) { 1.0 } else { -1.0 };
        std::array::from_fn(|i| {
            if i == k / 2 {
                sign * self.task.limits[i]
            } else {
                0.0
            }
        })
    }

    fn random_direction(&self, rng: &mut ChaCha8Rng) -> Twist {
        std::array::from_fn(|i| self.task.limits[i] * (2.0 * rng.random::<f64>() - 1.0))
    }
}

/// Whether a command is more than standing still.
fn moves(twist: &Twist, limits: &Twist) -> bool {
    let mut shares = twist.iter().zip(limits);
    shares.any(|(v, limit)| v.abs() > STILL * limit)
}
