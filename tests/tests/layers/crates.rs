//! Which crate may depend on which, read from `cargo metadata`.

use std::collections::{BTreeMap, BTreeSet};

use serde::Deserialize;
use testkit::root;

/// Programs and libraries that open ports, the transport itself, and two that open none but are
/// built from such: `xtask`, which reads the programs' settings, and `vpc-python`, which runs the
/// emulator and the table. Every other crate does without the transport `ipc`.
const OPEN_PORTS: [&str; 14] = [
    "controller",
    "hw-sim",
    "ipc",
    "recorder",
    "system-tests",
    "testkit",
    "vpc-calib",
    "vpc-camera",
    "vpc-client-c",
    "vpc-panda",
    "vpc-python",
    "vpc-ros2",
    "vpcctl",
    "xtask",
];
/// What the control law and what it is judged by must never share.
const LAW: [&str; 4] = ["vpc", "decision", "controller", "memory-blob"];
const EMULATOR: [&str; 4] = ["hw-sim", "fci", "panda", "vision"];
/// What reads a clock, a file or a socket, or lets others do so.
const EFFECTS: [&str; 9] = [
    "iceoryx2",
    "ipc",
    "libc",
    "memmap2",
    "program",
    "rustix",
    "signal-hook",
    "tokio",
    "tracing",
];

#[derive(Deserialize)]
struct Metadata {
    packages: Vec<Package>,
}

#[derive(Deserialize)]
struct Package {
    name: String,
    manifest_path: String,
    dependencies: Vec<Dependency>,
}

#[derive(Deserialize)]
struct Dependency {
    name: String,
    /// `None` for an ordinary one, or `dev` or `build`.
    kind: Option<String>,
    /// Of a crate of this workspace.
    path: Option<String>,
}

/// What cargo prints, of what is locked. On a new machine it downloads what no test is built from.
fn cargo(arguments: &[&str]) -> Vec<u8> {
    let mut cargo = testkit::command(env!("CARGO"));
    cargo.args(arguments).arg("--locked");
    let output = cargo.current_dir(root()).output().unwrap();
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "cargo {arguments:?}: {errors}");
    output.stdout
}

/// Everything that `name` is built from, at any depth, also packages of others.
fn below(name: &str) -> BTreeSet<String> {
    let tree = cargo(&[
        "tree",
        "-p",
        name,
        "-e",
        "normal,build",
        "--prefix=none",
        "--format={p}",
    ]);
    let tree = String::from_utf8(tree).unwrap();
    let first = |line: &str| line.split(' ').next().unwrap().to_owned();
    let below: BTreeSet<String> = tree.lines().map(first).collect();
    assert!(below.contains(name), "{name}: {tree}");
    below
}

impl Package {
    /// The folder of the crate, from the repository's root.
    fn folder(&self) -> &str {
        let within = self.manifest_path.strip_prefix(root().to_str().unwrap());
        within
            .unwrap()
            .trim_matches('/')
            .trim_end_matches("/Cargo.toml")
    }

    /// The room: the first folder of the path.
    fn room(&self) -> &str {
        self.folder().split('/').next().unwrap()
    }

    /// What the crate is built from: everything but the dependencies of its tests.
    fn production(&self) -> impl Iterator<Item = &Dependency> {
        let dependencies = self.dependencies.iter();
        dependencies.filter(|dependency| dependency.kind.as_deref() != Some("dev"))
    }
}

struct Workspace(BTreeMap<String, Package>);

impl Workspace {
    fn read() -> Self {
        let metadata = cargo(&["metadata", "--no-deps", "--format-version", "1"]);
        let metadata: Metadata = serde_json::from_slice(&metadata).unwrap();
        let packages = metadata.packages.into_iter();
        Self(packages.map(|it| (it.name.clone(), it)).collect())
    }

    /// Pairs of crates (user, used), of what is built, that `is_wrong` objects to.
    fn faults(&self, is_wrong: impl Fn(&Package, &Package) -> bool) -> Vec<String> {
        let mut faults = Vec::new();
        for user in self.0.values() {
            for dependency in user.production().filter(|it| it.path.is_some()) {
                let used = &self.0[&dependency.name];
                if is_wrong(user, used) {
                    faults.push(format!("{} uses {}", user.folder(), used.folder()));
                }
            }
        }
        faults
    }
}

#[test]
fn the_ground_imports_nothing_above_it() {
    let faults =
        Workspace::read().faults(|user, used| user.room() == "ipc" && used.room() != "ipc");
    assert!(faults.is_empty(), "{}", faults.join("\n"));
}

#[test]
fn the_contract_knows_no_client() {
    let clients = "ipc/clients/";
    let faults = Workspace::read().faults(|user, used| {
        let is_ground = user.room() == "ipc" && !user.folder().starts_with(clients);
        is_ground && used.folder().starts_with(clients)
    });
    assert!(faults.is_empty(), "{}", faults.join("\n"));
}

/// What may use the emulator and the table beside `tests`: the module for Python offers both.
const ABOVE_ALL: &str = "vpc-python";

#[test]
fn nothing_but_tests_builds_on_the_daemon_the_emulator_or_tests() {
    let faults = Workspace::read().faults(|user, used| {
        let is_top = used.name == "controller" || ["hw-sim", "tests"].contains(&used.room());
        let is_within = user.room() == "hw-sim" && used.room() == "hw-sim";
        let may_use = user.room() == "tests" || user.name == ABOVE_ALL;
        is_top && !is_within && !may_use
    });
    assert!(faults.is_empty(), "{}", faults.join("\n"));
}

#[test]
fn the_emulator_shares_nothing_with_the_law() {
    for emulator in EMULATOR {
        let below = below(emulator);
        let shared: Vec<_> = LAW.iter().filter(|name| below.contains(**name)).collect();
        assert!(shared.is_empty(), "{emulator} is built from {shared:?}");
        // The emulator's own bridge is driven by the arm of the bridges; what moves and judges is
        // not.
        let is_truth = emulator != "hw-sim";
        assert!(
            !is_truth || !below.contains("arm"),
            "{emulator} is built from arm"
        );
    }
}

#[test]
fn only_programs_that_open_ports_know_the_transport() {
    let workspace = Workspace::read();
    let users = workspace
        .0
        .keys()
        .filter(|name| below(name).contains("ipc"));
    let others: Vec<_> = users
        .filter(|name| !OPEN_PORTS.contains(&name.as_str()))
        .collect();
    assert!(others.is_empty(), "{others:?} are built from ipc");
    let transports = workspace.0.values().filter(|package| {
        package
            .production()
            .any(|dependency| dependency.name == "iceoryx2")
    });
    let names: Vec<_> = transports.map(|package| package.name.as_str()).collect();
    assert_eq!(names, ["ipc"], "iceoryx2");
}

#[test]
fn the_decision_has_no_port_file_or_clock() {
    for pure in ["decision", "messages", "vpc"] {
        let below = below(pure);
        let effects: Vec<_> = EFFECTS
            .iter()
            .filter(|name| below.contains(**name))
            .collect();
        assert!(effects.is_empty(), "{pure} is built from {effects:?}");
    }
}

#[test]
fn architecture_md_maps_every_crate() {
    let page = std::fs::read_to_string(root().join("ARCHITECTURE.md")).unwrap();
    let packages = Workspace::read().0;
    let folders = packages.values().map(Package::folder);
    let lacking: Vec<_> = folders
        .filter(|it| !page.contains(&format!("`{it}/`")))
        .collect();
    assert!(
        lacking.is_empty(),
        "ARCHITECTURE.md does not name {lacking:?}"
    );
}
