//! A simulation of `vpcd`'s decision in virtual time.

mod camera;
mod daemon;
mod fault;
mod operator;
mod plan;
mod policy;
mod property;
mod queue;
mod recorder;
mod robot;
mod stop_file;
mod trial;
mod world;

use std::sync::LazyLock;

use rayon::prelude::*;

use fault::{ALL, Fault};
use plan::{Plan, Stock};
use trial::Figures;
use world::{Found, World};

/// One sampling period of the paper's scene, ns.
pub const PERIOD_NS: u64 = 33_333_333;
/// Runs of each fault.
const ROUNDS: u64 = 20;
const LONG_ROUNDS: u64 = 2_000;

static STOCK: LazyLock<Stock> = LazyLock::new(Stock::read);

/// A number of the environment.
fn number(name: &str) -> Option<u64> {
    let text = std::env::var(name).ok()?;
    let number = text.parse();
    Some(number.unwrap_or_else(|_| panic!("{name} = {text}; allowed: a whole number")))
}

/// The seeds of these faults: that of `SIM_SEED` alone, if it is one of theirs, or a share of
/// `SIM_SEEDS`.
fn seeds(faults: &[Fault]) -> Vec<u64> {
    let all = ALL.len() as u64;
    let is_theirs = |seed: &u64| faults.contains(&ALL[(seed % all) as usize]);
    if let Some(seed) = number("SIM_SEED") {
        return Some(seed).into_iter().filter(is_theirs).collect();
    }
    let rounds = if testkit::is_long() {
        LONG_ROUNDS
    } else {
        ROUNDS
    };
    let most = number("SIM_SEEDS").unwrap_or(all * rounds);
    (0..most).filter(is_theirs).collect()
}

/// Runs the seeds of these faults, and prints the greatest figures of each fault.
fn show(faults: &[Fault]) {
    let (seeds, is_told) = (seeds(faults), number("SIM_SEED").is_some());
    let run = |seed: &u64| (*seed, World::run(&STOCK, *seed, is_told));
    let runs: Vec<(u64, Found)> = seeds.par_iter().map(run).collect();
    for fault in faults {
        let same = runs.iter().filter(|(_, found)| found.fault == *fault);
        let found: Vec<&Found> = same.map(|(_, found)| found).collect();
        let figures = found.iter().map(|found| found.figures);
        let most = figures.fold(Figures::default(), Figures::max);
        let cycles: u64 = found.iter().map(|found| found.cycles).sum();
        let seconds = found.iter().map(|found| found.took_ns).sum::<u64>() / 1_000_000_000;
        let runs = found.len();
        println!("{fault:?}: {runs} runs, {seconds} s, {cycles} cycles; at most {most}");
    }
    let broken = runs.iter().find_map(|(seed, found)| {
        let what = found.broken.as_ref()?;
        Some(format!("SIM_SEED={seed} ({:?}) {what}", found.fault))
    });
    assert!(broken.is_none(), "{}", broken.unwrap_or_default());
}

#[test]
fn silence() {
    let faults: Vec<_> = ALL
        .into_iter()
        .filter(|fault| *fault < Fault::NoAnswer)
        .collect();
    show(&faults);
}

#[test]
fn failures() {
    show(&[
        Fault::NoAnswer,
        Fault::LateOnce,
        Fault::LateLoop,
        Fault::Unsent,
    ]);
}

#[test]
fn robot() {
    show(&[
        Fault::RobotSilent,
        Fault::RobotDead,
        Fault::RobotFault,
        Fault::RobotStrays,
        Fault::RobotBlocked,
        Fault::RobotUnheard,
    ]);
}

#[test]
fn hang() {
    show(&[Fault::Hang, Fault::Suspend, Fault::ClockBack]);
}

#[test]
fn consent() {
    show(&[
        Fault::Crash,
        Fault::CrashDisarmed,
        Fault::Reload,
        Fault::ArmedStart,
        Fault::ArmedAlone,
        Fault::StopAgainstArm,
        Fault::StopTwice,
        Fault::Disarm,
    ]);
}

#[test]
fn stop() {
    show(&[
        Fault::Stop,
        Fault::StopInFlood,
        Fault::StopInBrake,
        Fault::StopFile,
        Fault::Flood,
        Fault::Strategy,
    ]);
}

#[test]
fn shutdown() {
    show(&[Fault::Terminate]);
}

#[test]
fn guardian() {
    show(&[Fault::Guardian]);
}

#[test]
fn storm() {
    show(&[Fault::Storm]);
}

#[test]
fn the_same_seed_gives_the_same_bits_and_a_rehearsal_changes_none() {
    let all = ALL.len() as u64;
    (0..all).into_par_iter().for_each(|seed| {
        let run = |rehearses| {
            let (mut plan, random) = Plan::new(&STOCK, seed);
            (plan.is_recorded, plan.rehearses) = (false, rehearses);
            let found = World::of(plan, random, false).to_the_end();
            (found.hash, found.cycles)
        };
        let first = run(false);
        assert_eq!(first, run(false), "SIM_SEED={seed}: not the same again");
        assert_eq!(first, run(true), "SIM_SEED={seed}: a rehearsal changes it");
    });
    let hashes = [0, all].map(|seed| World::run(&STOCK, seed, false).hash);
    assert_ne!(hashes[0], hashes[1], "other seeds, other runs");
}
