//! `cargo table`: every strategy on the same starts, closed loop against an exact camera; the paper's Table I.

use std::fs;
use std::io::{IsTerminal, Write};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::atomic::AtomicBool;

use anyhow::{Context, bail};
use clap::Parser;
use indicatif::{ProgressBar, ProgressStyle};
use memory_blob::MemoryFile;
use memory_builder::build::{self, Progress};
use memory_builder::memory;
use memory_builder::settings::BuildSettings;
use scene::{Scene, read_starts};
use serde::Serialize;
use system_tests::row::{Row, markdown};
use system_tests::run::{Reason, Run, run, time};
use system_tests::spec::Spec;
use vpc::{Controller, MotionMemory, Task};

/// Runs every strategy on the same starts against an exact camera and prints the paper's Table I.
///
/// Runs are made one after another on one core, so that the times of cycles are honest. Every run lasts the scene's
/// time: the cost is the mean over all its cycles.
#[derive(Parser)]
#[command(name = "table", version)]
struct Cli {
    /// Scene file (TOML).
    #[arg(long)]
    scene: PathBuf,
    /// Start poses (CSV: tx,ty,tz,rx,ry,rz).
    #[arg(long)]
    starts: PathBuf,
    /// Memory of motion; built first (paper-size) where none is given.
    #[arg(long)]
    memory: Option<PathBuf>,
    /// Strategies with their preview windows: previous, knn, knn2 to knn64, gpr, ibvs.
    #[arg(
        long,
        value_delimiter = ',',
        default_value = "previous:3,previous:30,knn:3,gpr:3"
    )]
    strategies: Vec<Spec>,
    /// Times each cycle as the median of this many replays.
    #[arg(long, default_value_t = 5, value_parser = clap::value_parser!(u16).range(1..))]
    repeats: u16,
    /// Writes rows and runs to this file.
    #[arg(long)]
    json: Option<PathBuf>,
    /// Draws pictures into this directory.
    #[arg(long)]
    plots: Option<PathBuf>,
}

/// What `--json` writes.
#[derive(Serialize)]
struct Document {
    scene: String,
    starts: String,
    memory: Option<String>,
    rows: Vec<Row>,
    runs: Vec<Record>,
}

/// One run in the document.
#[derive(Serialize)]
struct Record {
    start: usize,
    strategy: String,
    np: usize,
    success: bool,
    reason: Option<Reason>,
    steps: usize,
    cost: f64,
}

fn main() -> ExitCode {
    match table(&Cli::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("table: {error:#}");
            ExitCode::FAILURE
        }
    }
}

fn table(cli: &Cli) -> anyhow::Result<()> {
    let scene = Scene::read(&cli.scene)?;
    let task = Task::new(&scene).with_context(|| cli.scene.display().to_string())?;
    let starts = read_starts(&cli.starts)?;
    let needs_memory = cli
        .strategies
        .iter()
        .any(|spec| spec.strategy.needs_memory());
    let memory = match &cli.memory {
        Some(path) => Some(MemoryFile::open(path, Some(scene.fingerprint().bytes()))?),
        None if needs_memory => Some(built(&scene, &task)?),
        None => None,
    };
    let view = memory.as_ref().map(MemoryFile::view);

    let bar = bar((cli.strategies.len() * starts.len()) as u64);
    let (mut rows, mut records, mut all) = (Vec::new(), Vec::new(), Vec::new());
    for &spec in &cli.strategies {
        let mut controller = Box::new(Controller::new(&scene, spec.settings())?);
        let mut runs: Vec<Run> = Vec::with_capacity(starts.len());
        for (start, pose) in starts.iter().enumerate() {
            bar.set_message(format!("{spec}, start {start}"));
            let view = view.as_ref().map(|view| view as &dyn MotionMemory);
            let mut result = run(&scene, &mut controller, view, pose);
            time(&mut result, &mut controller, view, usize::from(cli.repeats))?;
            records.push(Record {
                start,
                strategy: spec.strategy.to_string(),
                np: spec.np,
                success: result.success,
                reason: result.reason,
                steps: result.steps,
                cost: result.cost,
            });
            runs.push(result);
            bar.inc(1);
        }
        rows.push(Row::of(spec, &runs));
        all.push((spec, runs));
    }
    bar.finish_and_clear();

    let mut out = std::io::stdout().lock();
    writeln!(
        out,
        "{}, {} starts\n\n{}",
        cli.scene.display(),
        starts.len(),
        markdown(&rows)
    )?;
    if let Some(path) = &cli.json {
        let document = Document {
            scene: cli.scene.display().to_string(),
            starts: cli.starts.display().to_string(),
            memory: cli.memory.as_ref().map(|path| path.display().to_string()),
            rows,
            runs: records,
        };
        write(path, &serde_json::to_vec_pretty(&document)?)?;
        writeln!(out, "wrote {}", path.display())?;
    }
    if let Some(directory) = &cli.plots {
        for path in
            system_tests::pictures::of_table(directory, &scene, &task, memory.as_ref(), &all)?
        {
            writeln!(out, "wrote {}", path.display())?;
        }
    }
    Ok(())
}

fn write(path: &Path, bytes: &[u8]) -> anyhow::Result<()> {
    if let Some(directory) = path.parent().filter(|d| !d.as_os_str().is_empty()) {
        fs::create_dir_all(directory).with_context(|| directory.display().to_string())?;
    }
    fs::write(path, bytes).with_context(|| format!("{}: cannot write", path.display()))
}

/// Builds a paper-size memory for the scene in a temporary file, which is gone once it is mapped.
fn built(scene: &Scene, task: &Task) -> anyhow::Result<MemoryFile> {
    let settings = BuildSettings::default();
    let bar = bar(settings.trajectories as u64);
    bar.set_message("building a memory");
    let progress = build::collect(
        scene,
        &settings,
        Progress::new(),
        &AtomicBool::new(false),
        |p| {
            bar.set_position(p.trajectories.len() as u64);
        },
    )?;
    bar.finish_and_clear();
    if progress.trajectories.is_empty() {
        bail!("no trajectory found");
    }
    let path = std::env::temp_dir().join(format!("vpc-table-{}.vpcmem", std::process::id()));
    memory::contents(scene, task, &settings, &progress)?.write(&path)?;
    let file = MemoryFile::open(&path, Some(scene.fingerprint().bytes()));
    fs::remove_file(&path).with_context(|| path.display().to_string())?;
    Ok(file?)
}

fn bar(total: u64) -> ProgressBar {
    let bar = if std::io::stderr().is_terminal() {
        ProgressBar::new(total)
    } else {
        ProgressBar::hidden()
    };
    let style = ProgressStyle::with_template("{bar:40.cyan/blue} {pos}/{len} {msg}, ETA {eta}");
    bar.set_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()));
    bar
}
