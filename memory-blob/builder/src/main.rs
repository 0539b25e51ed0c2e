//! `vpc-memory`: builds, inspects, verifies and refits memories of motion.

mod command;

use std::fs;
use std::io::{IsTerminal, Write};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use anyhow::{Context, bail};
use clap::{Args, Parser, Subcommand};
use indicatif::{ProgressBar, ProgressStyle};
use memory_blob::{MemoryFile, Report};
use memory_builder::build::{self, Progress};
use memory_builder::settings::BuildSettings;
use memory_builder::{memory, start};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use scene::Scene;
use serde::{Deserialize, Serialize};
use toml_schema::Document;
use vpc::Task;

/// Builds, inspects, verifies and refits memories of motion for vpcd.
#[derive(Parser)]
#[command(name = "vpc-memory", version, about, long_about = None)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Build a memory for a scene: solve it from many random starts and fit the regression.
    ///
    /// Ctrl-C writes what has been collected to FILE.partial; the same command then goes on from
    /// there and ends with the same file. The same seed gives the same file whatever the number of
    /// threads.
    Build(Build),
    /// Say what is in a memory.
    Inspect {
        /// The memory.
        file: PathBuf,
    },
    /// Verify every part of a memory, and that it was built for a scene where one is given.
    Verify {
        /// The memory.
        file: PathBuf,
        /// Scene file that the memory must belong to.
        #[arg(long)]
        scene: Option<PathBuf>,
    },
    /// Draw valid start poses from the scene's region, for `cargo table`; another seed than the
    /// build's gives starts that the memory has not seen.
    Starts {
        /// Scene file (TOML).
        scene: PathBuf,
        /// The file to write (CSV: tx,ty,tz,rx,ry,rz).
        #[arg(short, long)]
        output: PathBuf,
        /// How many.
        #[arg(long, default_value_t = 100)]
        count: usize,
        /// Seed.
        #[arg(long, default_value_t = 1000)]
        seed: u64,
    },
    /// Write the scene file of a task of your own; on a terminal, what no flag tells is asked for.
    New(command::new::New),
    /// Draw a scene: occlusions, the zone in which the memory is asked, goal, starts; and describe
    /// it.
    Preview(command::preview::Preview),
    /// Paint the occlusions of a scene into an image of the camera's size, to go on from in any
    /// editor.
    Mask(command::mask::Mask),
    /// Fit the regression again from the samples stored in a memory.
    Fit {
        /// The memory to read.
        file: PathBuf,
        /// Its scene.
        #[arg(long)]
        scene: PathBuf,
        /// The memory to write.
        #[arg(short, long)]
        output: PathBuf,
        #[command(flatten)]
        overrides: Overrides,
    },
}

#[derive(Args)]
struct Build {
    /// Scene file (TOML).
    scene: PathBuf,
    /// The memory to write.
    #[arg(short, long)]
    output: PathBuf,
    /// Threads; all cores by default.
    #[arg(long)]
    threads: Option<usize>,
    #[command(flatten)]
    overrides: Overrides,
}

/// Settings: the paper's values, then those of the file, then those of the flags.
#[derive(Args)]
struct Overrides {
    /// Settings file (TOML); `vpc-memory inspect` shows every key under provenance.
    #[arg(long)]
    settings: Option<PathBuf>,
    /// Successful trajectories to collect [default: 900].
    #[arg(long)]
    trajectories: Option<u32>,
    /// Steps previewed by the solver [default: 10].
    #[arg(long)]
    np: Option<u32>,
    /// Most iterations of the solver [default: 100].
    #[arg(long)]
    iterations: Option<u32>,
    /// Optimality precision of the solver [default: 1e-9].
    #[arg(long)]
    tolerance: Option<f64>,
    /// Way points this many control periods ahead, as in the paper, instead of the last features in
    /// sight.
    #[arg(long)]
    way_point_samples: Option<u32>,
    /// Features closer than this to an occlusion are guided by the memory, px [default: 20].
    #[arg(long)]
    trigger_px: Option<f64>,
    /// Draws an occlusion larger while trajectories are made, by its name: --grow "spot on the
    /// lens=1.2". The memory is one for the scene as it is; its provenance tells what was grown.
    #[arg(long, value_name = "NAME=FACTOR", value_parser = growth)]
    grow: Vec<(String, f64)>,
    /// Do without the planner in pose space: the paper's two algorithms only.
    #[arg(long)]
    no_planner: bool,
    /// Samples kept for regression [default: 800].
    #[arg(long)]
    gpr_samples: Option<u32>,
    /// Store the factor for predictive variances.
    #[arg(long)]
    variance: bool,
    /// Seed of every random choice [default: 1].
    #[arg(long)]
    seed: Option<i64>,
}

impl Overrides {
    fn settings(&self) -> anyhow::Result<BuildSettings> {
        let mut document = Document::read(self.settings.as_deref())?;
        document.set("trajectories", "--trajectories", self.trajectories);
        document.set("np", "--np", self.np);
        document.set("iterations", "--iterations", self.iterations);
        document.set("tolerance", "--tolerance", self.tolerance);
        let ahead = self
            .way_point_samples
            .map(|n| toml::Table::from_iter([("samples".to_owned(), n.into())]));
        document.set("way_point", "--way-point-samples", ahead);
        document.set("trigger_px", "--trigger-px", self.trigger_px);
        document.set("planner", "--no-planner", self.no_planner.then_some(false));
        document.set("regression.samples", "--gpr-samples", self.gpr_samples);
        document.set(
            "regression.variance",
            "--variance",
            self.variance.then_some(true),
        );
        document.set("seed", "--seed", self.seed);
        let mut settings: BuildSettings = document.check()?;
        settings.grow.extend(self.grow.iter().cloned());
        Ok(settings)
    }
}

/// An occlusion and its factor.
fn growth(text: &str) -> Result<(String, f64), String> {
    let allowed = || format!("`{text}`; allowed: NAME=FACTOR");
    let (name, factor) = text.rsplit_once('=').ok_or_else(allowed)?;
    Ok((name.to_owned(), factor.parse().map_err(|_| allowed())?))
}

/// What a Ctrl-C leaves behind.
#[derive(Serialize, Deserialize)]
struct Partial {
    task: String,
    settings: BuildSettings,
    progress: Progress,
}

/// Stack of each thread that solves, bytes: the law's workspace is large.
const STACK: usize = 16 << 20;

fn main() -> ExitCode {
    let result = match Cli::parse().command {
        Command::Build(build) => run_build(&build),
        Command::Inspect { file } => {
            open(&file, None).map(|file| print(&Report::of(&file).to_string()))
        }
        Command::Verify { file, scene } => run_verify(&file, scene.as_deref()),
        Command::Starts {
            scene,
            output,
            count,
            seed,
        } => run_starts(&scene, &output, count, seed),
        Command::New(new) => new.run().map(|said| print(&said)),
        Command::Preview(preview) => preview.run().map(|said| print(&said)),
        Command::Mask(mask) => mask.run().map(|said| print(&said)),
        Command::Fit {
            file,
            scene,
            output,
            overrides,
        } => run_fit(&file, &scene, &output, &overrides),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("vpc-memory: {error:#}");
            ExitCode::FAILURE
        }
    }
}

/// Prints, and does not mind a reader that went away.
fn print(text: &str) {
    let _ = std::io::stdout().write_all(text.as_bytes());
}

fn open(path: &Path, scene: Option<&Scene>) -> anyhow::Result<MemoryFile> {
    let task = scene.map(Scene::fingerprint);
    Ok(MemoryFile::open(
        path,
        task.as_ref().map(scene::Fingerprint::bytes),
    )?)
}

fn run_verify(path: &Path, scene: Option<&Path>) -> anyhow::Result<()> {
    let scene = scene.map(Scene::read).transpose()?;
    let file = open(path, scene.as_ref())?;
    let fits = if scene.is_some() {
        ", built for this scene"
    } else {
        ""
    };
    print(&format!(
        "{}: intact, {} bytes{fits}\n",
        path.display(),
        file.size()
    ));
    Ok(())
}

fn run_starts(path: &Path, output: &Path, count: usize, seed: u64) -> anyhow::Result<()> {
    let scene = Scene::read(path)?;
    let task = Task::new(&scene)?;
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let starts = (0..count).map(|_| start::valid(&scene, &task, None, &mut rng));
    let starts = starts.collect::<Result<Vec<_>, _>>()?;
    let (scene, file) = (path.display(), output.display());
    fs::write(output, scene::starts_csv(&starts))
        .with_context(|| format!("{file}: cannot write"))?;
    print(&format!(
        "wrote {file}: {count} valid starts of {scene}, seed {seed}; next: cargo table -- --scene {scene} --starts {file}\n"
    ));
    Ok(())
}

fn run_fit(input: &Path, scene: &Path, output: &Path, overrides: &Overrides) -> anyhow::Result<()> {
    let scene = Scene::read(scene)?;
    let settings = overrides.settings()?;
    let task = Task::new(&settings.grown(&scene)?)?;
    let contents = open(input, Some(&scene))?.contents();
    memory::refit(&scene, &task, &settings, &contents)?.write(output)?;
    print(&Report::of(&open(output, Some(&scene))?).to_string());
    Ok(())
}

fn run_build(build: &Build) -> anyhow::Result<()> {
    let settings = build.overrides.settings()?;
    let scene = Scene::read(&build.scene)?;
    let grown = settings.grown(&scene)?;
    let task = Task::new(&grown).with_context(|| build.scene.display().to_string())?;
    let threads = build.threads;
    if let Some(threads) = threads.filter(|threads| !(1..=1024).contains(threads)) {
        bail!("--threads = {threads}; allowed: 1 to 1024");
    }
    rayon::ThreadPoolBuilder::new()
        .num_threads(threads.unwrap_or(0)) // 0: as many as there are processors
        .stack_size(STACK)
        .build_global()?;
    let mut partial_path = build.output.as_os_str().to_owned();
    partial_path.push(".partial");
    let partial_path = PathBuf::from(partial_path);
    let begun = resume(&partial_path, &scene, &settings)?;

    let stop = Arc::new(AtomicBool::new(false));
    for signal in [signal_hook::consts::SIGINT, signal_hook::consts::SIGTERM] {
        signal_hook::flag::register_conditional_shutdown(signal, 130, Arc::clone(&stop))?;
        signal_hook::flag::register(signal, Arc::clone(&stop))?;
    }
    let bar = progress_bar(settings.trajectories, begun.trajectories.len());
    let clock = Instant::now();
    let progress = build::collect(&grown, &settings, begun, &stop, &mut |progress| {
        bar.set_position(progress.trajectories.len() as u64);
        let found = progress.trajectories.len() as f64;
        bar.set_message(format!(
            "{:.0} % of {} starts",
            100.0 * found / progress.tried as f64,
            progress.tried
        ));
    })?;
    bar.finish_and_clear();
    if stop.load(Ordering::Relaxed) && progress.trajectories.len() < settings.trajectories {
        let found = progress.trajectories.len();
        let task = scene.fingerprint().to_string();
        let text = serde_json::to_vec(&Partial {
            task,
            settings,
            progress,
        })?;
        fs::write(&partial_path, text).with_context(|| partial_path.display().to_string())?;
        eprintln!(
            "vpc-memory: stopped at {found} trajectories; the same command goes on from {}",
            partial_path.display()
        );
        std::process::exit(130);
    }
    let collected = clock.elapsed();
    let contents = memory::contents(&scene, &task, &settings, &progress)?;
    contents.write(&build.output)?;
    if partial_path.exists() {
        fs::remove_file(&partial_path).with_context(|| partial_path.display().to_string())?;
    }
    let file = open(&build.output, Some(&scene))?;
    print(&format!(
        "{}: {} bytes; {} trajectories of {} starts in {:.1} s, regression in {:.1} s\n{}",
        build.output.display(),
        file.size(),
        progress.trajectories.len(),
        progress.tried,
        collected.as_secs_f64(),
        (clock.elapsed() - collected).as_secs_f64(),
        Report::of(&file),
    ));
    Ok(())
}

/// The progress that an interrupted build left, where it was of the same scene and settings.
fn resume(path: &Path, scene: &Scene, settings: &BuildSettings) -> anyhow::Result<Progress> {
    if !path.exists() {
        return Ok(Progress::default());
    }
    let text = fs::read(path).with_context(|| path.display().to_string())?;
    let partial: Partial = serde_json::from_slice(&text).with_context(|| {
        format!(
            "{}: not the state of a build; remove it to begin anew",
            path.display()
        )
    })?;
    if partial.task != scene.fingerprint().to_string() || partial.settings != *settings {
        bail!(
            "{}: the state of a build with another scene or other settings; allowed: the same ones; remove it to begin anew",
            path.display()
        );
    }
    Ok(partial.progress)
}

fn progress_bar(total: usize, begun: usize) -> ProgressBar {
    let bar = if std::io::stderr().is_terminal() {
        ProgressBar::new(total as u64)
    } else {
        ProgressBar::hidden()
    };
    let style = "{bar:40.cyan/blue} {pos}/{len} trajectories, {per_sec}, ETA {eta}, {msg}";
    bar.set_style(
        ProgressStyle::with_template(style).unwrap_or_else(|_| ProgressStyle::default_bar()),
    );
    bar.set_position(begun as u64);
    bar
}
