//! The robot's cell as two processes on the fixed clock, `vpcd` and `hw-sim`, from many starts: several pairs at once,
//! each in a domain of its own.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Stdio;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread;

use anyhow::{Context, bail};
use serde::Serialize;
use serde_json::Value;

use crate::children::{self, Children};
use crate::spec::Spec;

/// What all pairs have in common.
#[derive(Clone, Debug)]
pub struct Cell {
    /// Directory of the programs.
    pub binaries: PathBuf,
    /// The repository's root.
    pub root: PathBuf,
    /// Directory for domains and configurations, made by [`runs`], and removed by it where all went well: logs of what
    /// failed stay.
    pub place: PathBuf,
    /// Flags of `hw-sim`, in words.
    pub camera: Vec<String>,
    /// Clearance that the law keeps, px.
    pub margin_px: f64,
    /// Seed of noise and losses; each start adds its index.
    pub seed: u64,
}

/// A run.
#[derive(Clone, Debug, Serialize)]
pub struct ProcessRun {
    /// Index of the start.
    pub start: usize,
    /// What `hw-sim` printed: its line of JSON.
    pub said: Value,
}

/// Runs a strategy from these starts, `jobs` pairs of processes at a time; `tell` hears of each run that ends.
///
/// # Errors
/// A program that cannot be run, or that ends in another way than with a verdict.
pub fn runs(
    children: &Children,
    cell: &Cell,
    spec: Spec,
    starts: &[usize],
    jobs: usize,
    tell: &(dyn Fn(&ProcessRun) + Sync),
) -> anyhow::Result<Vec<ProcessRun>> {
    let mut place = children.place(cell.place.clone());
    let next = AtomicUsize::new(0);
    let done = Mutex::new(Vec::new());
    let work = || -> anyhow::Result<()> {
        while let Some(&start) = starts.get(next.fetch_add(1, Ordering::Relaxed)) {
            let said = pair(children, cell, spec, start)
                .with_context(|| format!("{spec}, start {start}"))?;
            let run = ProcessRun { start, said };
            tell(&run);
            if let Ok(mut done) = done.lock() {
                done.push(run);
            }
        }
        Ok(())
    };
    let ends = thread::scope(|scope| {
        let workers: Vec<_> = (0..jobs.max(1)).map(|_| scope.spawn(work)).collect();
        let ends = workers.into_iter().map(|worker| match worker.join() {
            Ok(end) => end,
            Err(_) => bail!("a run panicked"),
        });
        ends.collect::<Vec<_>>()
            .into_iter()
            .collect::<anyhow::Result<()>>()
    });
    if ends.is_err() {
        place.keep();
    }
    ends?;
    let mut done = done.into_inner().unwrap_or_default();
    done.sort_by_key(|run| run.start);
    Ok(done)
}

/// One run of both processes.
fn pair(children: &Children, cell: &Cell, spec: Spec, start: usize) -> anyhow::Result<Value> {
    let here = cell.place.join(format!("{spec}-{start}").replace(':', "-"));
    fs::create_dir_all(&here).with_context(|| here.display().to_string())?;
    let config = here.join("vpcd.toml");
    fs::write(&config, configuration(cell, spec)?).with_context(|| config.display().to_string())?;
    let domain = here.join("domain");
    let log = fs::File::create(here.join("vpcd.log"))?;
    let mut daemon = children::command(cell.binaries.join("vpcd"));
    daemon.arg("--config").arg(&config).arg("--arm");
    daemon.arg("--domain").arg(&domain).stderr(log);
    let daemon = children.start("vpcd", daemon)?;
    let mut emulator = children::command(cell.binaries.join("hw-sim"));
    emulator
        .arg("--config")
        .arg(cell.root.join("hw-sim/hw-sim-robot.toml"));
    emulator.args(["--clock", "fixed", "--start", &start.to_string()]);
    emulator.args(["--seed", &cell.seed.wrapping_add(start as u64).to_string()]);
    emulator.args(&cell.camera).arg("--domain").arg(&domain);
    emulator
        .stdout(Stdio::piped())
        .stderr(fs::File::create(here.join("hw-sim.log"))?);
    let (_, said) = children.start("hw-sim", emulator)?.output()?;
    let logs = || format!("the logs are in {}", here.display());
    daemon.stop().with_context(logs)?;
    serde_json::from_str(&said)
        .context("hw-sim gave no verdict")
        .with_context(logs)
}

/// `vpcd-robot.toml` with another strategy, window and margin; its paths are absolute here.
fn configuration(cell: &Cell, spec: Spec) -> anyhow::Result<String> {
    let path = cell.root.join("controller/vpcd-robot.toml");
    let text = fs::read_to_string(&path).with_context(|| path.display().to_string())?;
    let mut table: toml::Table = text.parse().with_context(|| path.display().to_string())?;
    let beside = path.parent().unwrap_or(Path::new("."));
    for key in ["scene", "memory"] {
        if let Some(toml::Value::String(file)) = table.get_mut(key) {
            *file = beside.join(&*file).display().to_string();
        }
    }
    let Some(toml::Value::Table(law)) = table.get_mut("law") else {
        bail!("{}: no table [law]", path.display());
    };
    law.insert("strategy".into(), spec.strategy.to_string().into());
    law.insert("np".into(), i64::try_from(spec.np)?.into());
    law.insert("margin_px".into(), cell.margin_px.into());
    Ok(toml::to_string(&table)?)
}

/// A row of the table of runs.
pub fn row(spec: Spec, runs: &[ProcessRun]) -> String {
    let is_good = |run: &ProcessRun| run.said["verdict"] == "arrived";
    // By JSON pointers.
    let number = |run: &ProcessRun, of: &str| run.said.pointer(of).and_then(Value::as_f64);
    let numbers = |of| runs.iter().filter_map(move |run| number(run, of));
    let sum = |of| numbers(of).sum::<f64>();
    let most = |of| numbers(of).fold(0.0, f64::max);
    let arrivals = runs.iter().filter(|run| is_good(run));
    let arrivals: Vec<f64> = arrivals
        .filter_map(|run| number(run, "/arrived_s"))
        .collect();
    let failed = runs.iter().filter(|run| !is_good(run));
    let failed: Vec<String> = failed
        .map(|run| {
            format!(
                "{} ({})",
                run.start,
                run.said["verdict"].as_str().unwrap_or("")
            )
        })
        .collect();
    format!(
        "| {spec} | {} of {} | {} | {} | {} | {} | {:.1} | {:.0} | {:.1} | {} |",
        arrivals.len(),
        runs.len(),
        sum("/arm/reflexes"),
        sum("/arm/limit_violations"),
        sum("/arm/discontinuities"),
        sum("/stale"),
        arrivals.iter().sum::<f64>() / arrivals.len().max(1) as f64,
        most("/lateness/p99_us"),
        most("/lateness/max_us") * 1e-3,
        failed.join(", "),
    )
}

/// The head of that table.
pub const HEAD: &str = "| strategy | success | reflexes | limit violations | discontinuities | stale frames | \
arrival (s) | lateness p99 (us) | worst (ms) | failed |\n|---|--:|--:|--:|--:|--:|--:|--:|--:|---|";

/// Builds these programs beside the program that runs, with the cargo that runs it; gives their directory.
///
/// # Errors
/// Cargo cannot be run, or fails.
pub fn build(children: &Children, root: &Path, programs: &[&str]) -> anyhow::Result<PathBuf> {
    let cargo = std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into());
    let mut command = children::command(cargo);
    // No package is named, so that features are those of `cargo build`, and nothing is built twice.
    command.current_dir(root).arg("build");
    command.args(programs.iter().flat_map(|program| ["--bin", program]));
    if !cfg!(debug_assertions) {
        command.arg("--release");
    }
    let (status, _) = children.start("cargo", command)?.output()?;
    if !status.success() {
        bail!("cargo build of {} failed", programs.join(", "));
    }
    let program = std::env::current_exe()?;
    let directory = program.parent().context("no directory of binaries")?;
    Ok(directory.to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cell() -> Cell {
        Cell {
            binaries: PathBuf::new(),
            root: Path::new(env!("CARGO_MANIFEST_DIR")).join(".."),
            place: PathBuf::new(),
            camera: Vec::new(),
            margin_px: 7.0,
            seed: 1,
        }
    }

    #[test]
    fn the_daemons_configuration_is_the_robots_with_another_law() {
        let text = configuration(&cell(), "previous:4".parse().unwrap()).unwrap();
        let table: toml::Table = text.parse().unwrap();
        assert!(Path::new(table["scene"].as_str().unwrap()).exists());
        assert!(Path::new(table["memory"].as_str().unwrap()).exists());
        let law = &table["law"];
        assert_eq!(law["strategy"].as_str(), Some("previous"));
        assert_eq!(law["np"].as_integer(), Some(4));
        assert_eq!(law["margin_px"].as_float(), Some(7.0));
        assert_eq!(law["trigger_px"].as_float(), Some(30.0));
    }

    #[test]
    fn a_row_counts_arrivals_and_names_what_failed() {
        let line = |verdict: &str| {
            format!(
                "{{\"verdict\":\"{verdict}\",\"time_s\":20.0,\"frames\":600,\"stale\":1,\"limited\":0,\"error_px\":1.0,\
                 \"least_clearance_px\":12.0,\"violation\":null,\"step\":\"done\",\"arrived_s\":14.0,\"arm\":{{\
                 \"reflexes\":0,\"limit_violations\":2,\"discontinuities\":0,\"errors\":[]}},\"lateness\":{{\"count\":1,\
                 \"p50_us\":10.0,\"p99_us\":50.0,\"max_us\":900.0}}}}"
            )
        };
        let runs: Vec<ProcessRun> = ["arrived", "time_out"]
            .into_iter()
            .enumerate()
            .map(|(start, verdict)| ProcessRun {
                start,
                said: serde_json::from_str(&line(verdict)).unwrap(),
            })
            .collect();
        let row = row("gpr:3".parse().unwrap(), &runs);
        assert_eq!(
            row,
            "| gpr:3 | 1 of 2 | 0 | 4 | 0 | 2 | 14.0 | 50 | 0.9 | 1 (time_out) |"
        );
    }
}
