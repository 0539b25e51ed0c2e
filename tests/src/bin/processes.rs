//! `cargo run --release --bin processes`: the robot's cell as two processes in real time, from many
//! starts.

use std::fs;
use std::io::Write;
use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::{Context, bail};
use clap::Parser;
use system_tests::children::{Children, attended};
use system_tests::processes::{Cell, HEAD, build, row, runs};
use system_tests::root;
use system_tests::spec::Spec;

/// Runs vpcd and hw-sim with the emulated Panda as two processes over shared memory at 30 Hz, from many starts, and
/// prints a table: success, what the robot's referee found, how late its milliseconds began.
///
/// In real time: a run takes 15 to 30 s, one that fails a minute. A few pairs run side by side, each in a domain of its
/// own; more of them than the machine bears show as late milliseconds and stale frames.
#[derive(Parser)]
#[command(name = "processes", version)]
struct Cli {
    /// Strategies with their preview windows.
    #[arg(long, value_delimiter = ',', default_value = "previous:3,gpr:3")]
    strategies: Vec<Spec>,
    /// First start.
    #[arg(long, default_value_t = 0)]
    from: usize,
    /// Start after the last one, at most 100.
    #[arg(long, default_value_t = 100)]
    to: usize,
    /// Run only every N-th start.
    #[arg(long, default_value_t = 1, value_name = "N")]
    every: usize,
    /// Pairs of processes at a time.
    #[arg(long, default_value_t = 4)]
    jobs: usize,
    /// Where features come from: ideal or rendered.
    #[arg(long, default_value = "ideal")]
    camera: String,
    /// From the middle of an exposure to the delivery, ms.
    #[arg(long, default_value_t = 110.0)]
    latency_ms: f64,
    /// Pixel noise of ideal features, px.
    #[arg(long, default_value_t = 0.3)]
    noise: f64,
    /// Share of lost frames.
    #[arg(long, default_value_t = 0.01)]
    drop: f64,
    /// Extra clearance that the law keeps from every border, px.
    #[arg(long, default_value_t = 0.0)]
    margin: f64,
    /// Seed of noise and losses; each start adds its index.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Writes every run to this file.
    #[arg(long)]
    json: Option<PathBuf>,
}

fn main() -> ExitCode {
    attended("processes", |children| {
        processes(children, &Cli::parse_from(system_tests::arguments()))?;
        Ok(ExitCode::SUCCESS)
    })
}

fn processes(children: &Children, cli: &Cli) -> anyhow::Result<()> {
    if cli.from >= cli.to || cli.to > 100 || cli.every == 0 {
        let (from, to, every) = (cli.from, cli.to, cli.every);
        bail!(
            "--from {from} --to {to} --every {every}; allowed: from below to, to at most 100, every at least 1"
        );
    }
    let starts: Vec<usize> = (cli.from..cli.to).step_by(cli.every).collect();
    let flag = |name: &str, value: f64| [name.to_owned(), value.to_string()];
    let cell = Cell {
        binaries: build(children, root(), &["vpcd", "hw-sim"])?,
        root: root().to_owned(),
        place: std::env::temp_dir().join(format!("vpc-processes-{}", std::process::id())),
        camera: [["--camera".to_owned(), cli.camera.clone()]]
            .into_iter()
            .chain([
                flag("--latency-ms", cli.latency_ms),
                flag("--noise", cli.noise),
                flag("--drop", cli.drop),
            ])
            .flatten()
            .collect(),
        margin_px: cli.margin,
        seed: cli.seed,
    };
    let mut out = std::io::stdout().lock();
    let mut all = Vec::new();
    writeln!(out, "{HEAD}")?;
    for &spec in &cli.strategies {
        let runs = runs(children, &cell, spec, &starts, cli.jobs, &|run| {
            let said = &run.said;
            eprintln!(
                "{spec}, start {}: {} after {:.1} s",
                run.start,
                said["verdict"].as_str().unwrap_or("no verdict"),
                said["time_s"].as_f64().unwrap_or(f64::NAN)
            );
        })?;
        writeln!(out, "{}", row(spec, &runs))?;
        out.flush()?;
        all.push((spec.to_string(), runs));
    }
    if let Some(path) = &cli.json {
        fs::write(path, serde_json::to_vec_pretty(&all)?)
            .with_context(|| format!("{}: cannot write", path.display()))?;
    }
    Ok(())
}
