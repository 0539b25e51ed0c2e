//! Commands for developers. `cargo xtask release` makes a release, `cargo xtask book` the book, and
//! `cargo xtask gallery` its pictures.
//!
//! `cargo xtask codegen` writes every file that is made from the code,
//! `cargo xtask codegen --check` fails if one of them is stale. Each kind of file has a module
//! here; [`GENERATED`] lists them.

mod book;
mod c_header;
mod configuration;
mod contract;
mod doc;
mod gallery;
mod measure;
mod python;
mod release;
mod simulate;
mod stage;
mod units;

use std::path::{Path, PathBuf};

use anyhow::{Context, ensure};
use clap::Parser;
use toml_schema::{Generated, schema_file};

/// Files that are generated from the crates of this workspace; `ipc/clients/codegen` has those of
/// the clients.
const GENERATED: &[Generated<anyhow::Error>] = &[
    Generated {
        path: "ipc/clients/c/include/vpc.h",
        make: |_| c_header::make(),
    },
    Generated {
        path: "ipc/clients/python/vpc_client/messages.py",
        make: |_| Ok(python::messages()),
    },
    Generated {
        path: "ipc/clients/python/vpc_client/opening.py",
        make: |_| Ok(python::opening()),
    },
    Generated {
        path: "ipc/CONTRACT.md",
        make: contract::make,
    },
    Generated {
        path: "README.md",
        make: |page| system_tests::results::Results::read()?.quoted(page),
    },
    Generated {
        path: "controller/CONFIGURATION.md",
        make: |_| configuration::make(),
    },
    Generated {
        path: "controller/vpcd.schema.json",
        make: |_| Ok(schema_file(controller::config::schema())),
    },
    Generated {
        path: "ipc/scene/scene.schema.json",
        make: |_| Ok(schema_file(scene::schema())),
    },
    Generated {
        path: "ipc/scene/arm.schema.json",
        make: |_| Ok(schema_file(scene::arm_schema())),
    },
    Generated {
        path: "hw-sim/hw-sim.schema.json",
        make: |_| Ok(schema_file(hw_sim::config::schema())),
    },
    Generated {
        path: "memory-blob/builder/memory.schema.json",
        make: |_| Ok(schema_file(memory_builder::settings::schema())),
    },
    Generated {
        path: "controller/systemd/vpcd@.service",
        make: |_| units::template("vpcd"),
    },
    Generated {
        path: "controller/systemd/hw-sim@.service",
        make: |_| units::template("hw-sim"),
    },
    Generated {
        path: "controller/systemd/vpc-camera@.service",
        make: |_| units::template("vpc-camera"),
    },
    Generated {
        path: "controller/systemd/vpc-panda@.service",
        make: |_| units::template("vpc-panda"),
    },
    Generated {
        path: "controller/systemd/vpc-ros2@.service",
        make: |_| units::template("vpc-ros2"),
    },
];

/// Commands for developers.
#[derive(Parser)]
enum Command {
    /// Check format, lints, documentation, generated files, licences of packages
    Strict,
    /// Run the tests as a user without any right (as root)
    Unprivileged,
    /// Build and test the clients' workspace
    Clients,
    /// Let programs and data of others judge ours
    Judges,
    /// Measure what needs the wall clock, on this machine
    Measure {
        /// Those whose name has one of these words [default: all]
        names: Vec<String>,
        /// At full length, with those that take an hour
        #[arg(long)]
        long: bool,
    },
    /// Run many seeds of the simulation, and tell what each promise saw
    Simulate {
        /// How many
        #[arg(long, default_value_t = 100_000)]
        seeds: u64,
    },
    /// Run what takes long: installations, every test at full length
    Long,
    /// Write the files that are made from the code
    Codegen {
        /// Only check: fail if a file is stale
        #[arg(long)]
        check: bool,
    },
    /// Make the book, one site of all Markdown
    Book {
        /// A directory that is empty, not there, or has a book
        #[arg(default_value = "out/book")]
        directory: PathBuf,
        /// With the documentation of the libraries, which cargo makes
        #[arg(long)]
        api: bool,
    },
    /// Make the pictures of the pages again (takes minutes)
    Gallery {
        /// Their names, such as stop.gif [default: all]
        names: Vec<String>,
    },
    /// Make a release: source, Debian package, wheel, notes and checksums
    Release {
        /// A directory that is empty or not there
        directory: PathBuf,
    },
}

/// The root of the repository.
fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}

fn codegen(check: bool) -> anyhow::Result<()> {
    toml_schema::update(&root(), GENERATED, check)?;
    let mut clients = release::tool(env!("CARGO"));
    clients.current_dir(root().join("ipc/clients"));
    clients.args(["run", "--quiet", "--package", "codegen", "--"]);
    if check {
        clients.arg("--check");
    }
    let status = clients.status().context("cargo cannot be run")?;
    ensure!(status.success(), "the clients' files");
    Ok(())
}

fn main() -> anyhow::Result<()> {
    match Command::parse() {
        Command::Strict => stage::strict(),
        Command::Unprivileged => stage::unprivileged(),
        Command::Clients => stage::clients(),
        Command::Judges => stage::judges(),
        Command::Measure { names, long } => measure::measure(&names, long),
        Command::Simulate { seeds } => simulate::simulate(seeds),
        Command::Long => stage::long(),
        Command::Codegen { check } => codegen(check),
        Command::Book { directory, api } => book::book(&directory, api),
        Command::Gallery { names } => gallery::gallery(&names),
        Command::Release { directory } => release::release(&directory),
    }
}
