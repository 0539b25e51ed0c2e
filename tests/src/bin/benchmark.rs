//! `cargo benchmark`: our strategies beside peers, and beside methods of yours, on five scenes.

use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{ExitCode, Stdio};

use anyhow::{Context, bail};
use clap::Parser;
use system_tests::arguments;
use system_tests::benchmark::{self, Table};
use system_tests::children::{Children, attended};
use system_tests::external::Method;
use system_tests::source::{Product, Source};

/// Runs `cargo table` for each scene with the methods of `tests/peers`, and prints one table.
///
/// Columns: arrivals in each scene; of all, with their 95 % interval; violations; cost and cycles
/// of the runs that arrived, beyond the best run of the table from the same start, median and nine
/// of ten; how deep a point was inside something; time of a cycle, of a program from question to
/// answer; mean change of the command from one period to the next at the goal, as a share of the
/// limit.
#[derive(Parser)]
#[command(name = "benchmark", version)]
struct Cli {
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

fn main() -> ExitCode {
    attended("benchmark", |children| {
        let cli = Cli::parse_from(arguments());
        let programs = children.build(&["table"])?;
        let tables = cli.scenes.iter();
        let tables = tables.map(|scene| table(children, &cli, &programs.join("table"), scene));
        let tables = tables.collect::<anyhow::Result<Vec<_>>>()?;
        let text = benchmark::markdown(&tables);
        writeln!(std::io::stdout(), "{text}")?;
        fs::write(cli.directory.join("benchmark.md"), text)?;
        Ok(ExitCode::SUCCESS)
    })
}

/// The table of one scene.
fn table(children: &Children, cli: &Cli, program: &Path, scene: &Path) -> anyhow::Result<Table> {
    let name = scene.file_stem().context("a scene without a name")?;
    let directory = cli.directory.join(name);
    let memory = Source::Made { count: 50, seed: 1 };
    let memory = memory.file(children, scene, Product::Memory, &directory)?;
    let starts = cli
        .starts
        .file(children, scene, Product::Starts, &directory)?;
    let json = directory.join("table.json");
    let mut command = testkit::command(program);
    command
        .arg("--scene")
        .arg(scene)
        .arg("--starts")
        .arg(starts);
    command
        .arg("--memory")
        .arg(&memory)
        .arg("--json")
        .arg(&json);
    command.args(["--strategies", &cli.strategies, "--repeats", "3", "--wide"]);
    let peers = match cli.alone {
        true => Vec::new(),
        false => benchmark::methods(&memory),
    };
    for Method { name, words } in peers.iter().chain(&cli.external) {
        command.arg("--external").arg(format!("{name}={words}"));
    }
    // More threads are slower with matrices this small.
    command.env("OPENBLAS_NUM_THREADS", "1");
    command.stdout(Stdio::piped());
    let (status, said) = children.start("table", command)?.output()?;
    if !status.success() {
        bail!("{}: table: {status}", scene.display());
    }
    fs::write(directory.join("table.md"), said)?;
    let bytes = fs::read(&json).with_context(|| json.display().to_string())?;
    serde_json::from_slice(&bytes).with_context(|| json.display().to_string())
}
