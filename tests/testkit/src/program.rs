use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::{Mutex, PoisonError};

use crate::{is_set, root};

/// A program of this workspace, `examples/NAME` or `libvpcclient.so`, in the profile of the running
/// test.
///
/// Asks cargo to build it, which has nothing to do after `cargo test`. With `VPC_BUILT=1` cargo is
/// not asked: another user may not write there.
///
/// # Panics
/// If it does not build or is not there.
pub fn program(name: &str) -> PathBuf {
    static BUILT: Mutex<BTreeSet<String>> = Mutex::new(BTreeSet::new());
    let mut built = BUILT.lock().unwrap_or_else(PoisonError::into_inner);
    if built.insert(name.to_owned()) && !is_set("VPC_BUILT") {
        build(name);
    }
    let path = profile_directory().join(name);
    assert!(
        path.exists(),
        "{} is not built: cargo build",
        path.display()
    );
    path
}

/// Programs of the clients' workspace, `ipc/clients`, and the library for C, with their packages.
const CLIENTS: [(&str, &str); 6] = [
    ("examples/judge", "vpc-camera"),
    ("libvpcclient.so", "vpc-client-c"),
    ("vpc-calib", "vpc-calib"),
    ("vpc-camera", "vpc-camera"),
    ("vpc-panda", "vpc-panda"),
    ("vpc-ros2", "vpc-ros2"),
];

/// The cargo commands that build these programs, one for each workspace, in the profile of this
/// program.
pub fn cargo_build(programs: &[&str]) -> Vec<Command> {
    let package = |name: &str| {
        let client = CLIENTS.iter().find(|(program, _)| *program == name);
        client.map(|(_, package)| *package)
    };
    // No package of the root is named, so that features are those of `cargo test`, and nothing is
    // built twice.
    let own = programs.iter().filter(|name| package(name).is_none());
    let own = own.flat_map(|name| match name.strip_prefix("examples/") {
        Some(example) => ["--example", example],
        None => ["--bin", name],
    });
    let clients = programs
        .iter()
        .filter_map(|name| Some((name, package(name)?)));
    let clients = clients.flat_map(|(name, package)| match name.strip_prefix("examples/") {
        Some(example) => vec!["--package", package, "--example", example],
        None => vec!["--package", package],
    });
    let workspaces: [(_, Vec<&str>); 2] = [
        (root().to_owned(), own.collect()),
        (root().join("ipc/clients"), clients.collect()),
    ];
    let needed = workspaces.into_iter().filter(|(_, what)| !what.is_empty());
    let commands = needed.map(|(workspace, what)| {
        let mut cargo = crate::command(std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into()));
        cargo.current_dir(workspace).arg("build").args(what);
        cargo.arg("--target-dir").arg(target_directory());
        if profile_directory().ends_with("release") {
            cargo.arg("--release");
        }
        cargo
    });
    commands.collect()
}

fn build(name: &str) {
    for mut cargo in cargo_build(&[name]) {
        let status = cargo.arg("--quiet").status();
        assert!(
            status.is_ok_and(|status| status.success()),
            "{name} does not build"
        );
    }
}

/// Where this build's programs are: `target/debug` or `target/release`.
fn profile_directory() -> PathBuf {
    let program = std::env::current_exe().expect("the path of this program");
    let directory = program.parent().unwrap_or(Path::new("/"));
    // target/debug/deps/TEST, target/debug/examples/PROGRAM, or target/debug/PROGRAM
    let is_below = ["deps", "examples"]
        .iter()
        .any(|name| directory.ends_with(name));
    let above = directory.parent().filter(|_| is_below);
    above.unwrap_or(directory).to_owned()
}

/// The target directory of this build.
pub fn target_directory() -> PathBuf {
    let mut directory = profile_directory();
    directory.pop();
    directory
}
