//! `vpc-lab`: what `cargo demo`, `cargo table`, `cargo benchmark` and `cargo laboratory` run.

mod benchmark;
mod demo;
mod laboratory;
mod table;

use std::ffi::OsString;
use std::path::Path;
use std::process::ExitCode;

use anyhow::Context;
use clap::error::ErrorKind;
use clap::{CommandFactory, FromArgMatches, Parser};
use system_tests::children::attended;

/// Runs of controller and emulator: shown, compared, and disturbed.
#[derive(Parser)]
#[command(name = "vpc-lab", version, propagate_version = true)]
enum Lab {
    Demo(demo::Cli),
    Table(Box<table::Cli>),
    Benchmark(benchmark::Cli),
    Laboratory(laboratory::Cli),
}

impl Lab {
    /// Reads a command line.
    fn read(words: impl IntoIterator<Item = OsString>) -> Result<Self, clap::Error> {
        let matches = Self::command().try_get_matches_from(words)?;
        let lab = Self::from_arg_matches(&matches)?;
        if let (Self::Table(cli), Some((_, given))) = (&lab, matches.subcommand()) {
            let conflict = |words| Self::command().error(ErrorKind::ArgumentConflict, words);
            cli.check(given).map_err(conflict)?;
        }
        Ok(lab)
    }
}

/// The command line. The aliases in `.cargo/config.toml` end with the command, so that `cargo demo
/// --help` asks it; who writes `cargo demo -- --help`, as everywhere else, gets the same.
fn arguments() -> impl Iterator<Item = OsString> {
    // No command takes words without a flag, which a separator would be for.
    std::env::args_os().filter(|argument| argument != "--")
}

fn main() -> ExitCode {
    program::begin();
    let lab = Lab::read(arguments()).unwrap_or_else(|error| error.exit());
    attended("vpc-lab", |children| match &lab {
        Lab::Demo(cli) => demo::show(children, cli),
        Lab::Table(cli) => table::table(children, cli),
        Lab::Benchmark(cli) => benchmark::benchmark(children, cli),
        Lab::Laboratory(cli) => laboratory::laboratory(children, cli),
    })
}

/// Writes a file as a whole.
fn write(path: &Path, bytes: &[u8]) -> anyhow::Result<()> {
    program::replace(path, bytes).with_context(|| format!("{}: cannot write", path.display()))
}
