//! `vpc-memory`: builds, inspects, verifies and refits memories of motion.

mod command;

use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::Context;
use clap::{Args, Parser, Subcommand};
use memory_blob::{MemoryFile, Report};
use memory_builder::settings::BuildSettings;
use memory_builder::{memory, start};
use program::Exit;
use scene::Scene;
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
    /// there and ends with the same file; with --foresight an unfinished batch is done again. The
    /// same seed gives the same file whatever the number of threads.
    Build(command::build::Build),
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

/// Settings: the paper's values, then those of the file, then those of the flags.
#[derive(Args)]
pub(crate) struct Overrides {
    /// Settings file (TOML); `vpc-memory inspect` shows every key under provenance.
    #[arg(long)]
    settings: Option<PathBuf>,
    /// Successful trajectories to collect; the paper has 900 [default: 50].
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
    /// Collect foresight's trajectories, where it needs them, instead of the paper's: from so many
    /// starts.
    #[arg(long, value_name = "STARTS")]
    foresight: Option<u32>,
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
    pub(crate) fn settings(&self) -> anyhow::Result<BuildSettings> {
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
        document.set("foresight.starts", "--foresight", self.foresight);
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

fn main() -> ExitCode {
    program::begin();
    let result = match Cli::parse().command {
        Command::Build(build) => build.run().map(|said| print(&said)),
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
        Ok(()) => Exit::Ok.into(),
        Err(error) => Exit::Attention.say("vpc-memory", format_args!("{error:#}")),
    }
}

/// Prints, and does not mind a reader that went away.
pub(crate) fn print(text: &str) {
    let _ = std::io::stdout().write_all(text.as_bytes());
}

pub(crate) fn open(path: &Path, scene: Option<&Scene>) -> anyhow::Result<MemoryFile> {
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
    let starts = start::drawn(&scene, &task, count, seed)?;
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
