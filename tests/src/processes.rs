//! What `cargo laboratory` and `cargo table -- --robot fci` share: many runs of processes at a
//! time, and what they came to.

use std::fs::{self, File};
use std::path::Path;
use std::process::{Command, Stdio};

use anyhow::Context;
use hw_sim::following::FollowingReport;
use hw_sim::outcome::Verdict;
use hw_sim::robot::inspector::ArmReport;
use rayon::ThreadPoolBuilder;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use toml::{Table, Value};

use crate::children::{Children, Running};
use crate::statistics::mean;

/// Lines of a process's standard error that an error message quotes.
const QUOTED: usize = 8;

/// What a run came to: of `hw-sim`'s line what stands in the tables.
#[derive(Clone, Debug, Deserialize)]
pub struct Run {
    /// `arrived`, or why not.
    pub verdict: Verdict,
    /// Seconds until the features were at the goal.
    pub arrived_s: Option<f64>,
    /// Least signed distance of a point from an occlusion or the border, px.
    pub least_clearance_px: f64,
    /// What the robot's referee reports.
    pub arm: ArmReport,
    /// How well the camera followed, where that was measured.
    pub following: Option<FollowingReport>,
    /// What the other processes said about it.
    #[serde(skip)]
    pub notes: Vec<String>,
}

impl Run {
    /// Whether it arrived without a reflex.
    pub fn is_good(&self) -> bool {
        self.verdict == Verdict::Arrived && self.arm.reflexes == 0
    }

    /// The verdict, the robot's errors and the notes.
    fn why(&self) -> String {
        let errors = self.arm.errors.iter().map(AsRef::as_ref);
        let notes = self.notes.iter().map(String::as_str);
        let reasons: Vec<&str> = errors.chain(notes).collect();
        match reasons.is_empty() {
            true => self.verdict.to_string(),
            false => format!("{}: {}", self.verdict, reasons.join("; ")),
        }
    }
}

/// What all runs of a row came to.
#[derive(Clone, Debug, Serialize)]
pub struct Summary {
    /// Number of runs.
    pub runs: usize,
    /// Runs that arrived without a reflex.
    pub arrived: usize,
    /// Starts of the other runs, with their verdicts, the robot's errors, and what the other
    /// processes said.
    pub failed: Vec<(usize, String)>,
    /// Reflexes, milliseconds beyond a limit, and with a discontinuity; of all runs.
    pub trouble: [u64; 3],
}

impl Summary {
    /// The summary of runs, each with the number of its start.
    pub fn of(runs: &[(usize, Run)]) -> Self {
        let sum = |what: fn(&ArmReport) -> u64| runs.iter().map(|(_, run)| what(&run.arm)).sum();
        let bad = runs.iter().filter(|(_, run)| !run.is_good());
        let failed: Vec<_> = bad.map(|(start, run)| (*start, run.why())).collect();
        Self {
            runs: runs.len(),
            arrived: runs.len() - failed.len(),
            failed,
            trouble: [
                sum(|arm| arm.reflexes),
                sum(|arm| arm.limit_violations),
                sum(|arm| arm.discontinuities),
            ],
        }
    }

    /// Starts of a row with this name that failed, as a line; nothing if none did.
    pub fn failures(&self, name: &str) -> String {
        let failed = self.failed.iter();
        let failed: Vec<_> = failed
            .map(|(start, why)| format!("{start} ({why})"))
            .collect();
        match failed.is_empty() {
            true => String::new(),
            false => format!("\n{name}: failed from {}\n", failed.join(", ")),
        }
    }
}

/// Largest share of a limit in any run.
pub fn largest(runs: &[(usize, Run)], share: fn(&ArmReport) -> f64) -> f64 {
    let shares = runs.iter().map(|(_, run)| share(&run.arm));
    shares.fold(0.0, f64::max)
}

/// The share of the controller's time in which bridges slowed the camera down.
pub fn slowed<'a>(reports: impl Iterator<Item = &'a ArmReport> + Clone) -> f64 {
    let sum = |ms: fn(&ArmReport) -> u64| reports.clone().map(ms).sum::<u64>() as f64;
    sum(|arm| arm.slowed_ms) / sum(|arm| arm.steered_ms).max(1.0)
}

/// Mean time to arrival, s.
pub fn arrival_s<'a>(runs: impl Iterator<Item = &'a Run>) -> Option<f64> {
    mean(runs.filter_map(|run| run.arrived_s))
}

/// Does the work of every number below `count`, so many at a time; the results in the order of the
/// numbers.
///
/// # Errors
/// That of a work, or no thread can be started.
pub fn each<T: Send>(
    jobs: usize,
    count: usize,
    work: impl Fn(usize) -> anyhow::Result<T> + Send + Sync,
) -> anyhow::Result<Vec<T>> {
    let pool = ThreadPoolBuilder::new().num_threads(jobs.max(1)).build()?;
    pool.install(|| (0..count).into_par_iter().map(work).collect())
}

/// Starts a process with its output in files of `place`: `NAME.out` and `NAME.err`.
///
/// # Errors
/// The files cannot be written, or the process cannot be started.
pub fn begin<'a>(
    children: &'a Children,
    place: &Path,
    name: &'static str,
    mut command: Command,
) -> anyhow::Result<Running<'a>> {
    command.stdout(File::create(place.join(format!("{name}.out")))?);
    command.stderr(File::create(place.join(format!("{name}.err")))?);
    command.stdin(Stdio::null());
    children.start(name, command)
}

/// The last lines that processes in `place` wrote to standard error.
pub fn words(place: &Path, names: &[&str]) -> String {
    let tail = |name: &&str| {
        let text = fs::read_to_string(place.join(format!("{name}.err"))).unwrap_or_default();
        let lines: Vec<&str> = text.lines().collect();
        let last = lines[lines.len().saturating_sub(QUOTED)..].join("\n");
        format!("{name}: {last}\n")
    };
    names.iter().map(tail).collect()
}

/// The table of a TOML file.
///
/// # Errors
/// The file cannot be read, or is no TOML.
pub fn read_table(path: &Path) -> anyhow::Result<Table> {
    let read = || anyhow::Ok(toml::from_str(&fs::read_to_string(path)?)?);
    read().with_context(|| path.display().to_string())
}

/// A daemon's configuration that ships, with another scene and memory and other keys of `[law]`.
///
/// # Errors
/// A file cannot be read.
pub fn daemon(
    shipped: &str,
    scene: &Path,
    memory: Option<&Path>,
    keys: Table,
) -> anyhow::Result<Table> {
    let mut table = read_table(&crate::root().join(shipped))?;
    table.insert("scene".to_owned(), absolute(scene)?.into());
    match memory {
        Some(memory) => table.insert("memory".to_owned(), absolute(memory)?.into()),
        None => table.remove("memory"),
    };
    let law = table.get_mut("law").and_then(Value::as_table_mut);
    let law = law.with_context(|| format!("{shipped} without [law]"))?;
    law.extend(keys);
    Ok(table)
}

/// The absolute path of a file that exists, as text.
///
/// # Errors
/// The file does not exist.
pub fn absolute(path: &Path) -> std::io::Result<String> {
    Ok(fs::canonicalize(path)?.display().to_string())
}
