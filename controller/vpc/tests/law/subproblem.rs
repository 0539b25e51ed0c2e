//! The fixture of sub-problems: read, and handed to the solver as problems of the law.

use scene::Scene;
use serde::Deserialize;
use vpc::prediction::{InitialState, Model, Plan, Preview};
use vpc::problem::{Problem, Solution};
use vpc::solver::{Size, Solver};
use vpc::{DOF, MAX_VARIABLES, Points, SolverOptions, Task, Twist, constraint, cost};

/// The file that `fixtures/subproblems.py` writes.
#[derive(Deserialize)]
pub struct Fixture {
    scenes: Scenes,
    /// In the order of the file: 80 each with windows of 3, 10 and 30 steps.
    pub problems: Vec<Subproblem>,
}

#[derive(Deserialize)]
struct Scenes {
    #[serde(rename = "made-up")]
    made_up: String,
}

/// One cycle's problem near an occlusion and SciPy's answer.
#[derive(Deserialize)]
pub struct Subproblem {
    /// "paper-sim" or "made-up".
    pub scene: String,
    /// Steps previewed.
    pub np: usize,
    features: Vec<[f64; 2]>,
    target: Vec<[f64; 2]>,
    /// SciPy's answer.
    pub v: Twist,
    /// Its cost.
    pub cost: f64,
    /// Its worst violation, px.
    pub violation_px: f64,
    /// Whether SciPy calls it feasible.
    pub feasible: bool,
    /// Where SciPy started; its answer is the best of all.
    pub starts: Vec<Start>,
}

/// Where SciPy started, and what it found from there alone.
#[derive(Deserialize)]
pub struct Start {
    /// "zero", "unconstrained" (the answer where features may be anywhere), "random 0" to "random
    /// 3".
    pub name: String,
    /// The start.
    pub v: Twist,
    /// Cost of the answer; `None` if it is not feasible.
    pub cost: Option<f64>,
}

/// A sub-problem as the law sees it.
pub struct Case {
    pub np: usize,
    pub task: Task,
    pub initial: InitialState,
    pub target: Points,
}

impl Fixture {
    pub fn read() -> Self {
        serde_json::from_str(include_str!("../../fixtures/subproblems.json")).unwrap()
    }

    pub fn case(&self, problem: &Subproblem) -> Case {
        let text = match problem.scene.as_str() {
            "paper-sim" => scene::PAPER_SIM,
            "made-up" => &self.scenes.made_up,
            other => panic!("scene {other} of the fixture is unknown"),
        };
        let task = Task::new(&Scene::parse(text, &problem.scene).unwrap()).unwrap();
        self.case_of(problem, task)
    }

    /// A problem as another task sees it.
    pub fn case_of(&self, problem: &Subproblem, task: Task) -> Case {
        let points: Points = problem.features.iter().copied().collect();
        Case {
            np: problem.np,
            initial: InitialState::new(&task, Model::TargetDepth, &points),
            target: problem.target.iter().copied().collect(),
            task,
        }
    }

    /// Every problem with its case.
    pub fn cases(&self) -> Vec<(&Subproblem, Case)> {
        self.problems.iter().map(|p| (p, self.case(p))).collect()
    }
}

impl Subproblem {
    /// The start of this name.
    pub fn start(&self, name: &str) -> &Start {
        self.starts.iter().find(|s| s.name == name).unwrap()
    }
}

impl Case {
    /// As the fixture defines it: the whole R, no margin.
    pub fn problem(&self) -> Problem<'_> {
        Problem {
            task: &self.task,
            initial: &self.initial,
            target: &self.target,
            r_share: 1.0,
            change_share: 0.0,
            standing: [0.0; 6],
            interval: self.task.ts,
            ts: self.task.ts,
            margin: 0.0,
            dampers: None,
            view: None,
            wanted: None,
            watched: vpc::MAX_NP,
        }
    }

    /// Workspace for [`Case::solver`].
    pub fn workspace(&self) -> Vec<f64> {
        vec![0.0; self.size().workspace()]
    }

    fn size(&self) -> Size {
        Size::of(&self.task, self.np, 1)
    }

    /// A solver for this window: ten iterations, tolerance 1e-6.
    pub fn solver<'w>(&self, workspace: &'w mut [f64]) -> Solver<'w> {
        let options = SolverOptions {
            max_iterations: 10,
            tolerance: 1e-6,
            intersample: false,
        };
        Solver::new(self.size(), options, workspace).unwrap()
    }

    /// The solution from the starts of `Law::step`: the warm start, and standing still.
    pub fn solve(&self, solver: &mut Solver<'_>, warm: &Twist) -> Solution {
        solver.solve_from(&self.problem(), &plan(warm), &[0.0; MAX_VARIABLES])
    }

    /// Cost and worst violation (px) of a twist, by a preview of its own.
    pub fn judge(&self, twist: &Twist) -> (f64, f64) {
        let points = self.initial.points.len();
        let mut workspace = vec![0.0; Preview::<DOF>::room(self.np, points)];
        let mut preview = Preview::<DOF>::new(self.np, points, &mut workspace).unwrap();
        assert!(preview.evaluate(&self.task, &self.initial, twist, self.task.ts));
        let worst = (0..self.np)
            .flat_map(|j| preview.step(j))
            .map(|&pixel| constraint::violation(&self.task, pixel, 0.0))
            .fold(0.0, f64::max);
        (cost::value(&self.problem(), &preview, twist), worst)
    }
}

/// A twist as the plan of one command.
pub fn plan(twist: &Twist) -> Plan {
    core::array::from_fn(|k| twist.get(k).copied().unwrap_or(0.0))
}
