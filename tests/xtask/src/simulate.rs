//! `cargo xtask simulate`: many seeds of the simulation, and what was seen in them.

use std::io::{BufRead as _, BufReader};
use std::process::Stdio;
use std::time::Instant;

use anyhow::{Context as _, ensure};

use crate::root;

/// Between a fault and what a promise saw in its runs, in the lines of the simulation.
const SAW: &str = " saw ";

/// Runs this many seeds, and prints two tables: the runs of each fault, and how often each promise
/// was checked. What breaks one is told with the command that repeats it.
///
/// # Errors
/// If a promise is broken.
pub fn simulate(seeds: u64) -> anyhow::Result<()> {
    let begin = Instant::now();
    let mut cargo = testkit::command(env!("CARGO"));
    cargo.current_dir(root());
    cargo.args([
        "test",
        "--quiet",
        "--test",
        "simulation",
        "--",
        "--nocapture",
    ]);
    cargo.env("SIM_SEEDS", seeds.to_string());
    let mut tests = cargo
        .stdout(Stdio::piped())
        .spawn()
        .context("cargo cannot be run")?;
    let output = tests.stdout.take().context("its output")?;
    let (mut faults, mut promises) = (Vec::new(), Vec::<(String, u64)>::new());
    for line in BufReader::new(output).lines() {
        let line = line?;
        let Some((name, count)) = line.rsplit_once(": ") else {
            continue;
        };
        if let (Some((_, promise)), Ok(count)) = (name.split_once(SAW), count.parse::<u64>()) {
            match promises.iter_mut().find(|(one, _)| one == promise) {
                Some((_, all)) => *all += count,
                None => promises.push((promise.to_owned(), count)),
            }
        } else if let Some((fault, runs)) = line.split_once(": ")
            && runs.contains(" runs, ")
        {
            faults.push((fault.to_owned(), runs.to_owned()));
        }
    }
    let status = tests.wait()?;
    println!("| fault | runs |\n|---|---|");
    for (fault, runs) in &faults {
        println!("| {fault} | {runs} |");
    }
    println!("\n| promise | checked |\n|---|--:|");
    for (promise, count) in &promises {
        println!("| {promise} | {count} |");
    }
    println!("\n{seeds} seeds in {:.0} s", begin.elapsed().as_secs_f64());
    ensure!(status.success(), "a promise is broken: {status}");
    Ok(())
}
