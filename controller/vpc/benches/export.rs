//! What `peers.py` compares with solvers that are not Rust crates: answers to the problems of the
//! fixture, and the quadratic programs behind ours.

use std::fs;
use std::hint::black_box;
use std::path::Path;
use std::time::Instant;

use serde_json::json;
use vpc::qp::{ActiveSet, QpStatus, Rows};
use vpc::{DOF, Twist};

use super::subproblem::{Case, Fixture, plan};
use super::{REPEATS, REST, Solvers, peer, quantile};

/// As many changes of the active set as the law allows.
const CHANGES: u32 = 6 * DOF as u32;

/// Solves everything without a warm start and writes it to a JSON file: the answers, those of one
/// problem a row, and two programs for each problem, about standing still and about our answer.
pub fn write(path: &Path) {
    let (fixture, mut solvers) = (Fixture::read(), Solvers::new());
    let (mut answers, mut programs) = (Vec::new(), Vec::new());
    for (_, case) in fixture.cases() {
        let found = in_turn(&mut solvers, &case);
        answers.push(found.map(|(us, v)| json!({"us": us, "v": v})));
        for about in [REST, found[0].1] {
            let mut workspace = case.workspace();
            let mut solver = case.solver(&mut workspace);
            let program = solver.program_about(&case.problem(), &plan(&about));
            let (quadratic, rows, rho) = program.unwrap();
            let rows: Vec<_> = rows
                .iter()
                .map(|(gradient, clearance)| (*gradient, clearance))
                .collect();
            programs.push((case.judge(&about).0, (quadratic, rows, rho)));
        }
    }
    // In passes over all programs, each copied just before, as an iteration has just written it.
    let mut workspace = [0.0; ActiveSet::<DOF>::ROOM];
    let mut workspace = ActiveSet::new(&mut workspace).unwrap();
    let (mut times, mut steps) = (vec![Vec::new(); programs.len()], Vec::new());
    let most = programs.iter().map(|(_, (_, rows, _))| rows.len()).max();
    let mut room = vec![0.0; Rows::<DOF>::room(most.unwrap())];
    for _ in 0..REPEATS {
        steps.clear();
        for ((_, (quadratic, rows, rho)), times) in programs.iter().zip(&mut times) {
            let mut copy = Rows::new(rows.len(), &mut room).unwrap();
            for (gradient, clearance) in rows {
                copy.push(*gradient, *clearance);
            }
            let begin = Instant::now();
            let answer = workspace.solve(black_box(quadratic), &mut copy, *rho, CHANGES);
            times.push(begin.elapsed().as_secs_f64() * 1e6);
            // A row that yields would make it another program than the peers solve.
            assert_eq!((answer.status, answer.yielded), (QpStatus::Solved, 0));
            steps.push(answer.step);
        }
    }
    let found = programs.iter().zip(steps.iter().zip(&mut times));
    let programs = found.map(|((value, (quadratic, rows, rho)), (step, times))| {
        json!({
            "value": value,
            "hessian": quadratic.hessian,
            "gradient": quadratic.gradient,
            "lower": quadratic.lower,
            "upper": quadratic.upper,
            "rows": rows.iter().map(|(gradient, _)| gradient).collect::<Vec<_>>(),
            "clearances": rows.iter().map(|(_, clearance)| clearance).collect::<Vec<_>>(),
            "rho": rho,
            "us": quantile(times, 0.0),
            "step": step,
        })
    });
    let written = json!({"answers": answers, "programs": programs.collect::<Vec<_>>()});
    fs::write(path, serde_json::to_vec(&written).unwrap()).unwrap();
}

/// Ours, `slsqp` and `optimization_engine` in turn: least time in us, and answer.
fn in_turn(solvers: &mut Solvers, case: &Case) -> [(f64, Twist); 3] {
    let (mut times, mut answers) = ([const { Vec::new() }; 3], [REST; 3]);
    for _ in 0..REPEATS {
        for (i, (times, answer)) in times.iter_mut().zip(&mut answers).enumerate() {
            let begin = Instant::now();
            *answer = match i {
                0 => solvers.solve_cold(black_box(case)),
                1 => peer::slsqp(black_box(case), &REST),
                _ => peer::open(black_box(case), &REST),
            };
            times.push(begin.elapsed().as_secs_f64() * 1e6);
        }
    }
    core::array::from_fn(|i| (quantile(&mut times[i], 0.0), answers[i]))
}
