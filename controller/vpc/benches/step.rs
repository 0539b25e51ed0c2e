//! What a solution costs, ours and a peer's, on the problems of the fixture: `cargo bench -p
//! vpc-bench`. What their answers are worth is the matter of `peers.py`, for which `-- --write
//! FILE` writes them.
//!
//! Each iteration takes the next problem of its window.

mod export;
mod peer;
#[allow(dead_code)] // the test asks for more
#[path = "../tests/law/subproblem.rs"]
mod subproblem;

use std::hint::black_box;
use std::time::Instant;

use divan::Bencher;
use scene::Scene;
use subproblem::{Case, Fixture, Subproblem};
use vpc::problem::Solution;
use vpc::solver::Solver;
use vpc::{DOF, Task, Twist};

const WINDOWS: [usize; 3] = [3, 10, 30];
const REST: Twist = [0.0; DOF];
const STANDING: [f64; vpc::MAX_VARIABLES] = [0.0; vpc::MAX_VARIABLES];
/// Solutions of one problem in the table; their median counts.
const REPEATS: usize = 5;

fn main() {
    if let [flag, path, ..] = &*std::env::args().skip(1).collect::<Vec<_>>()
        && flag == "--write"
    {
        return export::write(path.as_ref());
    }
    divan::main();
    // Not where the benches only show that they run, or one of them is asked for.
    if std::env::args().skip(1).eq(["--bench".to_owned()]) {
        println!(
            "\nthe paper's scene, us   | shapes p50, p99 | mask p50, p99   | mask / shapes p50, of p99 | once more, shapes p50, p99"
        );
        let mask = painted();
        WINDOWS.into_iter().for_each(|np| paint(np, &mask));
    }
}

#[divan::bench(args = WINDOWS, sample_count = 500)]
fn ours(bencher: Bencher, np: usize) {
    let mut solvers = Solvers::new();
    each(bencher, np, |case| solvers.solve(case));
}

#[divan::bench(args = WINDOWS, sample_count = 500)]
fn ours_without_a_warm_start(bencher: Bencher, np: usize) {
    let mut solvers = Solvers::new();
    each(bencher, np, |case| solvers.solve_cold(case));
}

#[divan::bench(args = WINDOWS, sample_count = 500)]
fn ours_by_mask(bencher: Bencher, np: usize) {
    let (fixture, mask) = (Fixture::read(), painted());
    let problems = of_the_paper(&fixture, np);
    let cases: Vec<Case> = problems.map(|p| fixture.case_of(p, mask.clone())).collect();
    let (mut solvers, mut next) = (Solvers::new(), 0);
    bencher.bench_local(|| {
        next = (next + 1) % cases.len();
        solvers.solve(black_box(&cases[next]))
    });
}

#[divan::bench(args = WINDOWS, sample_count = 40)]
fn slsqp(bencher: Bencher, np: usize) {
    each(bencher, np, |case| peer::slsqp(case, &REST));
}

#[divan::bench(args = WINDOWS, sample_count = 40)]
fn open(bencher: Bencher, np: usize) {
    each(bencher, np, |case| peer::open(case, &REST));
}

fn each<R>(bencher: Bencher, np: usize, mut solve: impl FnMut(&Case) -> R) {
    let fixture = Fixture::read();
    let cases: Vec<Case> = window(&fixture, np).map(|p| fixture.case(p)).collect();
    let mut next = 0;
    bencher.bench_local(|| {
        next = (next + 1) % cases.len();
        solve(black_box(&cases[next]))
    });
}

fn window(fixture: &Fixture, np: usize) -> impl Iterator<Item = &Subproblem> {
    fixture.problems.iter().filter(move |p| p.np == np)
}

/// The paper's scene with its six shapes painted as one mask.
fn painted() -> Task {
    let shapes = Task::new(&Scene::parse(scene::PAPER_SIM, "paper-sim.toml").unwrap()).unwrap();
    let directory = tempfile::tempdir().unwrap();
    let is_white = |i: u32, j: u32| {
        let middle = [f64::from(i) + 0.5, f64::from(j) + 0.5];
        shapes.obstacles().any(|obstacle| obstacle.hides(middle))
    };
    scene::write_mask(&directory.path().join("mask.png"), 1024, 1024, is_white).unwrap();
    let (head, _) = scene::PAPER_SIM.split_once("[[occlusion]]").unwrap();
    let path = directory.path().join("scene.toml");
    let text = format!("{head}[[occlusion]]\nname = \"painted\"\nmask = \"mask.png\"\n");
    std::fs::write(&path, text).unwrap();
    Task::new(&Scene::read(&path).unwrap()).unwrap()
}

/// Shapes, the mask, and the shapes again, in turn, on every problem of a window of the paper's
/// scene.
fn paint(np: usize, mask: &Task) {
    let fixture = Fixture::read();
    let mut solvers = Solvers::new();
    let (mut times, mut ratios) = ([const { Vec::new() }; 3], Vec::new());
    for problem in of_the_paper(&fixture, np) {
        let shapes = fixture.case(problem);
        let mask = fixture.case_of(problem, mask.clone());
        let mut found = [const { Vec::new() }; 3];
        for _ in 0..3 * REPEATS {
            for (found, case) in found.iter_mut().zip([&shapes, &mask, &shapes]) {
                let begin = Instant::now();
                black_box(solvers.solve(black_box(case)));
                found.push(begin.elapsed().as_secs_f64() * 1e6);
            }
        }
        let medians = found.map(|mut found| quantile(&mut found, 0.5));
        times
            .iter_mut()
            .zip(medians)
            .for_each(|(times, one)| times.push(one));
        ratios.push(medians[1] / medians[0]);
    }
    let [shapes, mask, again] = times.map(|mut times| [0.5, 0.99].map(|p| quantile(&mut times, p)));
    println!(
        "Np {np:<2}, {:>3} problems     | {:>6.1}, {:>6.1}  | {:>6.1}, {:>6.1}  | {:>6.2}, {:>6.2}          | {:>6.1}, {:>6.1}",
        ratios.len(),
        shapes[0],
        shapes[1],
        mask[0],
        mask[1],
        quantile(&mut ratios, 0.5),
        mask[1] / shapes[1],
        again[0],
        again[1],
    );
}

/// The problems of a window that are of the paper's scene.
fn of_the_paper(fixture: &Fixture, np: usize) -> impl Iterator<Item = &Subproblem> {
    window(fixture, np).filter(|problem| problem.scene == "paper-sim")
}

/// Our solver, with a workspace for each window as the daemon keeps it.
struct Solvers([Option<Solver<'static>>; 3]);

impl Solvers {
    fn new() -> Self {
        Self([None, None, None])
    }

    /// As a cycle does, from standing still.
    fn solve(&mut self, case: &Case) -> Twist {
        first(&self.of(case).solve(&case.problem(), &STANDING))
    }

    /// By two searches.
    fn solve_cold(&mut self, case: &Case) -> Twist {
        first(&self.of(case).solve_cold(&case.problem(), &STANDING))
    }

    fn of(&mut self, case: &Case) -> &mut Solver<'static> {
        let index = WINDOWS.iter().position(|np| *np == case.np).unwrap();
        // A bench ends before it matters that this is never given back.
        let new = || case.solver(case.workspace().leak());
        self.0[index].get_or_insert_with(new)
    }
}

/// The first command.
fn first(solution: &Solution) -> Twist {
    core::array::from_fn(|k| solution.plan[k])
}

/// The smallest entry that this share of all does not exceed.
fn quantile(values: &mut [f64], share: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    values[((share * values.len() as f64).ceil() as usize).clamp(1, values.len()) - 1]
}
