//! Commands for developers. `cargo xtask release` makes a release, `cargo xtask book` the book, and
//! `cargo xtask gallery` its pictures.
//!
//! `cargo xtask codegen` writes every file that is made from the code,
//! `cargo xtask codegen --check` fails if one of them is stale. Each kind of file has a module
//! here; [`ARTEFACTS`] lists them.

mod book;
mod c_header;
mod configuration;
mod contract;
mod doc;
mod gallery;
mod python;
mod release;
mod units;

use std::path::{Path, PathBuf};

use anyhow::{Context, ensure};
use clap::Parser;
use toml_schema::schema_file;

/// A file that is made from the code.
struct Artefact {
    /// Below the root of the repository.
    path: &'static str,
    /// Its new text, given the present one (empty if there is none).
    make: fn(present: &str) -> anyhow::Result<String>,
}

const ARTEFACTS: &[Artefact] = &[
    Artefact {
        path: "ipc/clients/c/include/vpc.h",
        make: |_| c_header::make(),
    },
    Artefact {
        path: "ipc/clients/python/vpc_client/messages.py",
        make: |_| Ok(python::messages()),
    },
    Artefact {
        path: "ipc/clients/python/vpc_client/opening.py",
        make: |_| Ok(python::opening()),
    },
    Artefact {
        path: "ipc/CONTRACT.md",
        make: contract::make,
    },
    Artefact {
        path: "controller/CONFIGURATION.md",
        make: |_| configuration::make(),
    },
    Artefact {
        path: "controller/vpcd.schema.json",
        make: |_| Ok(schema_file(controller::config::schema())),
    },
    Artefact {
        path: "ipc/scene/scene.schema.json",
        make: |_| Ok(schema_file(scene::schema())),
    },
    Artefact {
        path: "ipc/scene/arm.schema.json",
        make: |_| Ok(schema_file(scene::arm_schema())),
    },
    Artefact {
        path: "hw-sim/hw-sim.schema.json",
        make: |_| Ok(schema_file(hw_sim::config::schema())),
    },
    Artefact {
        path: "ipc/clients/camera/vpc-camera.schema.json",
        make: |_| Ok(schema_file(vpc_camera::config::schema())),
    },
    Artefact {
        path: "ipc/clients/calib/board/board.schema.json",
        make: |_| Ok(schema_file(tag_board::schema())),
    },
    Artefact {
        path: "ipc/clients/panda/vpc-panda.schema.json",
        make: |_| Ok(schema_file(vpc_panda::config::schema())),
    },
    Artefact {
        path: "ipc/clients/ros2/vpc-ros2.schema.json",
        make: |_| Ok(schema_file(vpc_ros2::config::schema())),
    },
    Artefact {
        path: "memory-blob/builder/memory.schema.json",
        make: |_| Ok(schema_file(memory_builder::settings::schema())),
    },
    Artefact {
        path: "controller/systemd/vpcd@.service",
        make: |_| units::template("vpcd"),
    },
    Artefact {
        path: "controller/systemd/hw-sim@.service",
        make: |_| units::template("hw-sim"),
    },
    Artefact {
        path: "controller/systemd/vpc-camera@.service",
        make: |_| units::template("vpc-camera"),
    },
    Artefact {
        path: "controller/systemd/vpc-panda@.service",
        make: |_| units::template("vpc-panda"),
    },
    Artefact {
        path: "controller/systemd/vpc-ros2@.service",
        make: |_| units::template("vpc-ros2"),
    },
];

/// Commands for developers.
#[derive(Parser)]
enum Command {
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
    let mut stale = Vec::new();
    for Artefact { path, make } in ARTEFACTS {
        let file = root().join(path);
        let present = std::fs::read_to_string(&file).unwrap_or_default();
        let text = make(&present).with_context(|| format!("{path}: cannot be made"))?;
        if text == present {
            continue;
        }
        if check {
            let lines = || present.lines().zip(text.lines());
            let same = lines().take_while(|(old, new)| old == new).count();
            stale.push(format!("{path} (line {})", same + 1));
        } else {
            std::fs::write(&file, text).with_context(|| format!("{path}: cannot be written"))?;
            println!("{path}: written");
        }
    }
    let stale = stale.join(", ");
    ensure!(stale.is_empty(), "stale: {stale}; run cargo xtask codegen");
    Ok(())
}

fn main() -> anyhow::Result<()> {
    match Command::parse() {
        Command::Codegen { check } => codegen(check),
        Command::Book { directory, api } => book::book(&directory, api),
        Command::Gallery { names } => gallery::gallery(&names),
        Command::Release { directory } => release::release(&directory),
    }
}
