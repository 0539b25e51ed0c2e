//! `cargo benchmark`: our strategies beside peers, and beside methods of yours, on five scenes.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::Context;
use clap::Args;
use system_tests::benchmark::{self, Runs};
use system_tests::children::Children;
use system_tests::external::Method;
use system_tests::source::{Product, Source};

use crate::table;

/// Runs `cargo table` for each scene with the methods of `tests/peers`, and prints one table.
///
/// Columns: arrivals in each scene; of all, with their 95 % interval; violations; cost and cycles
/// of the runs that arrived, beyond the best run of the table from the same start, median and nine
/// of ten; how deep a point was inside something; time of a cycle, of a program from question to
/// answer; mean change of the command from one period to the next at the goal, as a share of the
/// limit.
#[derive(Args)]
pub(crate) struct Cli {
    /// Scene files (TOML).
    #[arg(
        long,
        value_delimiter = ',',
        default_value = "ipc/scene/scenes/paper-sim.toml,tests/scenes/cup-disc-bars.toml,tests/scenes/u-spot-bar.toml,tests/scenes/crescent.toml,tests/scenes/gap.toml"
    )]
    scenes: Vec<PathBuf>,
    /// Starts in each: COUNT@SEED, so many that `vpc-memory starts` draws by this seed.
    #[arg(long, default_value = "10@8001")]
    starts: Source,
    /// Our strategies.
    #[arg(long, default_value = "ibvs,previous:3,knn:3,gpr:3,foresight:3")]
    strategies: String,
    /// A method of yours: its row's name, the program and its arguments. May be given several
    /// times.
    #[arg(long, value_name = "NAME=PROGRAM ARGS")]
    external: Vec<Method>,
    /// Run your methods and our strategies only, and no peer.
    #[arg(long)]
    alone: bool,
    /// Memories and tables are written to this directory.
    #[arg(long, default_value = "out/benchmark")]
    directory: PathBuf,
}

/// Prints and writes the table of all scenes.
pub(crate) fn benchmark(children: &Children, cli: &Cli) -> anyhow::Result<ExitCode> {
    let tables = cli.scenes.iter().map(|scene| runs(children, cli, scene));
    let text = benchmark::markdown(&tables.collect::<anyhow::Result<Vec<_>>>()?);
    println!("{text}");
    fs::write(cli.directory.join("benchmark.md"), text)?;
    Ok(ExitCode::SUCCESS)
}

/// The runs in one scene.
fn runs(children: &Children, cli: &Cli, scene: &Path) -> anyhow::Result<Runs> {
    let name = scene.file_stem().context("a scene without a name")?;
    let directory = cli.directory.join(name);
    let file = |source: &Source, product| {
        let file = source.file(children, scene, product, &directory)?;
        anyhow::Ok(file.display().to_string())
    };
    let memory = file(&Source::Made { count: 50, seed: 1 }, Product::Memory)?;
    let starts = file(&cli.starts, Product::Starts)?;
    let peers = match cli.alone {
        true => Vec::new(),
        false => benchmark::methods(Path::new(&memory)),
    };
    // More threads are slower with matrices this small.
    let methods = peers.iter().chain(&cli.external);
    let methods = methods.map(|Method { name, words }| {
        format!("--external={name}=env OPENBLAS_NUM_THREADS=1 {words}")
    });
    let methods: Vec<String> = methods.collect();
    let scene = scene.display().to_string();
    let mut words = vec!["--scene", &scene, "--starts", &starts, "--memory", &memory];
    words.extend(["--strategies", &cli.strategies, "--repeats", "3", "--wide"]);
    words.extend(methods.iter().map(String::as_str));
    let cli = table::Cli::of(&words)?;
    let (scene, starts) = table::scene_and_starts(children, &cli)?;
    let memory = table::memory(children, &cli, &Source::File(memory.into()))?;
    let mut done = table::free(&cli, &scene, &starts, Some(&memory))?;
    fs::write(directory.join("table.md"), done.told(&cli))?;
    for run in done.all.iter_mut().flat_map(|(_, runs)| runs) {
        run.history = Vec::new();
    }
    Ok(done.all)
}
