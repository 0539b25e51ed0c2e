//! `cargo table`: every strategy on the same starts, closed loop against an exact camera; the paper's Table I.

use std::fs;
use std::io::{IsTerminal, Write};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::atomic::AtomicBool;

use anyhow::{Context, bail};
use clap::error::ErrorKind;
use clap::parser::ValueSource;
use clap::{Args, CommandFactory, FromArgMatches, Parser, ValueEnum};
use hw_sim::sensor::Flaws;
use indicatif::{ProgressBar, ProgressStyle};
use memory_blob::MemoryFile;
use memory_builder::build::{self, Progress};
use memory_builder::memory;
use memory_builder::settings::BuildSettings;
use scene::{Scene, read_starts};
use serde::Serialize;
use system_tests::robot_table::{self, Common, RobotFlags};
use system_tests::row::{Row, markdown};
use system_tests::run::{Reason, Run, flawed, time};
use system_tests::spec::Spec;
use vpc::{Controller, Model, MotionMemory, Settings, Task};

/// Runs every strategy on the same starts against an emulated camera and prints the paper's Table I.
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
    /// Frames between exposure and delivery (of a Panda's camera: --delay-ms).
    #[arg(long, default_value_t = 0, value_parser = clap::value_parser!(u16).range(..=60))]
    delay: u16,
    /// Leaves the law where it stalls, as the paper's does: no detour over a sample of the memory.
    #[arg(long)]
    no_detour: bool,
    /// Leaves the delay uncompensated: the law takes the features for those of now.
    #[arg(long)]
    no_compensation: bool,
    /// Pixel noise, standard deviation, px.
    #[arg(long, value_name = "PX", default_value_t = 0.0)]
    noise: f64,
    /// Probability that a frame is lost.
    #[arg(long, value_name = "P", default_value_t = 0.0)]
    drop: f64,
    /// What the law believes of depths is wrong by this share: it takes pattern and goal for 1 + E times as large and far.
    #[arg(
        long,
        value_name = "E",
        default_value_t = 0.0,
        allow_negative_numbers = true
    )]
    depth_error: f64,
    /// Seed of noise and losses; each start adds its index.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// How the law predicts features: pose, area-depth, target-depth.
    #[arg(long, value_parser = model, default_value = "pose")]
    model: Model,
    /// What carries the camera: nobody (the paper's hand-held camera), or a Panda with its bridge and a late camera.
    #[arg(long, value_enum, default_value = "free")]
    robot: Body,
    /// Writes rows and runs to this file.
    #[arg(long)]
    json: Option<PathBuf>,
    /// Draws pictures into this directory.
    #[arg(long)]
    plots: Option<PathBuf>,
    #[command(flatten, next_help_heading = "With --robot panda")]
    arm: RobotFlags,
}

/// What carries the camera.
#[derive(Clone, Copy, PartialEq, ValueEnum)]
enum Body {
    /// It flies freely and moves exactly as told.
    Free,
    /// A Franka Emika Panda.
    Panda,
}

/// What `--json` writes.
#[derive(Serialize)]
struct Document {
    scene: String,
    starts: String,
    memory: Option<String>,
    delay_frames: u16,
    delay_compensation: bool,
    noise_px: f64,
    drop: f64,
    depth_error: f64,
    seed: u64,
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

/// A model by its word in configuration files.
fn model(word: &str) -> Result<Model, String> {
    match word {
        "pose" => Ok(Model::Pose),
        "area-depth" => Ok(Model::AreaDepth),
        "target-depth" => Ok(Model::TargetDepth),
        _ => Err("allowed: pose, area-depth, target-depth".to_owned()),
    }
}

/// The command line, unless it holds a flag that the chosen body would not look at: a margin that changes nothing must not
/// pass for one that does nothing.
fn parse(arguments: impl IntoIterator<Item = std::ffi::OsString>) -> Result<Cli, clap::Error> {
    let matches = Cli::command().try_get_matches_from(arguments)?;
    let cli = Cli::from_arg_matches(&matches)?;
    let given = |id: &str| matches.value_source(id) == Some(ValueSource::CommandLine);
    let refused = |id: &str, body: &str| {
        let words = format!("--{} goes with --robot {body}", id.replace('_', "-"));
        Cli::command().error(ErrorKind::ArgumentConflict, words)
    };
    let (of_others, body) = match cli.robot {
        Body::Free => {
            let arm = RobotFlags::augment_args(clap::Command::new("arm"));
            let ids = arm.get_arguments().map(|flag| flag.get_id().to_string());
            (ids.collect(), "panda")
        }
        Body::Panda => (vec!["delay".to_owned(), "repeats".to_owned()], "free"),
    };
    match of_others.iter().find(|id| given(id)) {
        Some(id) => Err(refused(id, body)),
        None => Ok(cli),
    }
}

fn main() -> ExitCode {
    let cli = match parse(system_tests::arguments()) {
        Ok(cli) => cli,
        Err(error) => error.exit(),
    };
    match table(&cli) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("table: {error:#}");
            ExitCode::FAILURE
        }
    }
}

fn table(cli: &Cli) -> anyhow::Result<()> {
    for (flag, value, least, most) in [
        ("--noise", cli.noise, 0.0, 100.0),
        ("--drop", cli.drop, 0.0, 1.0),
        ("--depth-error", cli.depth_error, -0.9, 9.0),
    ] {
        if !(least..=most).contains(&value) {
            bail!("{flag} = {value}; allowed: {least} to {most}");
        }
    }
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
    if cli.robot == Body::Panda {
        let view = view.as_ref().map(|view| view as &(dyn MotionMemory + Sync));
        return on_robot(cli, &scene, &starts, view);
    }

    let believed = with_depth_error(&scene, cli.depth_error);
    let bar = bar((cli.strategies.len() * starts.len()) as u64);
    let (mut rows, mut records, mut all) = (Vec::new(), Vec::new(), Vec::new());
    for &spec in &cli.strategies {
        let settings = Settings {
            detour: !cli.no_detour,
            delay_compensation: !cli.no_compensation,
            model: cli.model,
            ..spec.settings()
        };
        let mut controller = Box::new(Controller::new(&believed, settings)?);
        let mut runs: Vec<Run> = Vec::with_capacity(starts.len());
        for (start, pose) in starts.iter().enumerate() {
            bar.set_message(format!("{spec}, start {start}"));
            let view = view.as_ref().map(|view| view as &dyn MotionMemory);
            let flaws = Flaws {
                noise_px: cli.noise,
                delay_frames: usize::from(cli.delay),
                drop: cli.drop,
                seed: cli.seed + start as u64,
            };
            let mut result = flawed(&scene, &mut controller, view, pose, flaws);
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
        "{}, {} starts, delay {} frames {}, noise {} px, {} % of frames lost, depths wrong by {} %\n\n{}",
        cli.scene.display(),
        starts.len(),
        cli.delay,
        if cli.no_compensation {
            "uncompensated"
        } else {
            "compensated"
        },
        cli.noise,
        100.0 * cli.drop,
        100.0 * cli.depth_error,
        markdown(&rows)
    )?;
    if let Some(path) = &cli.json {
        let document = Document {
            scene: cli.scene.display().to_string(),
            starts: cli.starts.display().to_string(),
            memory: cli.memory.as_ref().map(|path| path.display().to_string()),
            delay_frames: cli.delay,
            delay_compensation: !cli.no_compensation,
            noise_px: cli.noise,
            drop: cli.drop,
            depth_error: cli.depth_error,
            seed: cli.seed,
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

/// The table of the robot.
fn on_robot(
    cli: &Cli,
    scene: &Scene,
    starts: &[scene::Pose],
    memory: Option<&(dyn MotionMemory + Sync)>,
) -> anyhow::Result<()> {
    let bar = bar((cli.strategies.len() * starts.len()) as u64);
    let common = Common {
        strategies: &cli.strategies,
        noise: cli.noise,
        drop: cli.drop,
        depth_error: cli.depth_error,
        seed: cli.seed,
        settings: Settings {
            detour: !cli.no_detour,
            delay_compensation: !cli.no_compensation,
            model: cli.model,
            ..Settings::default()
        },
    };
    let tick = || bar.inc(1);
    let (document, all) = robot_table::table(scene, starts, memory, &cli.arm, &common, &tick)?;
    bar.finish_and_clear();
    let mut out = std::io::stdout().lock();
    writeln!(out, "{}", robot_table::markdown(&document))?;
    if let Some(path) = &cli.json {
        robot_table::write(&document, path, &mut out)?;
    }
    if let Some(directory) = &cli.plots {
        let task = Task::new(scene)?;
        let pictures = system_tests::pictures::of_robot_table(
            directory,
            scene,
            &task,
            &cli.strategies,
            &all,
            cli.arm.only,
        )?;
        for path in pictures {
            writeln!(out, "wrote {}", path.display())?;
        }
    }
    Ok(())
}

/// The scene as a law with wrong depths sees it: the same images, from pattern and goal of another size.
fn with_depth_error(scene: &Scene, error: f64) -> Scene {
    let mut believed = scene.clone();
    let lengths = believed.pattern.iter_mut().flatten();
    for length in lengths.chain(&mut believed.goal.translation) {
        *length *= 1.0 + error;
    }
    believed
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
        Progress::default(),
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

#[cfg(test)]
mod tests {
    use super::*;

    fn refusal(flags: &str) -> Option<String> {
        let line = format!("table --scene s --starts s {flags}");
        let parsed = parse(line.split_whitespace().map(Into::into));
        parsed.err().map(|error| error.to_string())
    }

    #[test]
    fn a_flag_that_would_change_nothing_is_refused() {
        assert_eq!(refusal("--margin 12 --robot panda"), None);
        assert_eq!(refusal("--delay 4 --noise 0.3"), None);
        for (flags, words) in [
            ("--margin 12", "--margin goes with --robot panda"),
            ("--unshaped", "--unshaped goes with --robot panda"),
            (
                "--delay-ms 110 --robot free",
                "--delay-ms goes with --robot panda",
            ),
            ("--delay 4 --robot panda", "--delay goes with --robot free"),
        ] {
            let message = refusal(flags).unwrap();
            assert!(message.contains(words), "{flags}: {message}");
        }
    }
}
