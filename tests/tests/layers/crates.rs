//! Which crate may depend on which, in both workspaces, read from `cargo metadata` and the lock files.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;

use serde::Deserialize;
use testkit::root;
use toml::{Table, Value};

/// The two workspaces, from the root of the repository.
pub const WORKSPACES: [&str; 2] = [".", "ipc/clients"];

/// Programs and libraries that open ports, the transport itself, and three that open none but are
/// built from such: `xtask` and `codegen`, which read the programs' settings, and `vpc-python`,
/// which runs the emulator and the table. Every other crate does without the transport `ipc`.
const OPEN_PORTS: [&str; 15] = [
    "codegen",
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
pub struct Package {
    name: String,
    manifest_path: String,
    dependencies: Vec<Dependency>,
    /// One of [`WORKSPACES`].
    #[serde(default)]
    workspace: String,
}

#[derive(Deserialize)]
struct Dependency {
    name: String,
    /// `None` for an ordinary one, or `dev` or `build`.
    kind: Option<String>,
    /// Of a crate of ours.
    path: Option<String>,
}

/// What cargo prints in a workspace, of what is there: nothing is downloaded.
fn cargo(workspace: &str, arguments: &[&str]) -> Vec<u8> {
    let mut cargo = testkit::command(env!("CARGO"));
    cargo.args(arguments).args(["--locked", "--offline"]);
    let output = cargo.current_dir(root().join(workspace)).output().unwrap();
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "cargo {arguments:?}: {errors}");
    output.stdout
}

/// Everything that a crate of the root is built from, at any depth, also packages of others.
fn below(name: &str) -> BTreeSet<String> {
    let kinds = ["-e", "normal,build", "--prefix=none", "--format={p}"];
    let tree = cargo(".", &[&["tree", "-p", name], &kinds[..]].concat());
    let tree = String::from_utf8(tree).unwrap();
    let first = |line: &str| line.split(' ').next().unwrap().to_owned();
    let below: BTreeSet<String> = tree.lines().map(first).collect();
    assert!(below.contains(name), "{name}: {tree}");
    below
}

impl Package {
    /// The folder of the crate, from the repository's root.
    pub fn folder(&self) -> &str {
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

/// The crates of both workspaces, by name.
pub struct Crates(BTreeMap<String, Package>);

impl Crates {
    pub fn read() -> Self {
        let packages = WORKSPACES.iter().flat_map(|workspace| {
            let said = cargo(
                workspace,
                &["metadata", "--no-deps", "--format-version", "1"],
            );
            let metadata: Metadata = serde_json::from_slice(&said).unwrap();
            metadata.packages.into_iter().map(|package| Package {
                workspace: (*workspace).to_owned(),
                ..package
            })
        });
        Self(packages.map(|it| (it.name.clone(), it)).collect())
    }

    /// The crate of this name.
    pub fn get(&self, name: &str) -> Option<&Package> {
        self.0.get(name)
    }

    /// Pairs of crates (user, used), of what is built, that `is_wrong` objects to.
    fn faults(&self, is_wrong: impl Fn(&Package, &Package) -> bool) -> Vec<String> {
        self.pairs(Package::production, is_wrong)
    }

    /// The same, of these dependencies.
    fn pairs<'a, D: Iterator<Item = &'a Dependency>>(
        &'a self,
        dependencies: impl Fn(&'a Package) -> D,
        is_wrong: impl Fn(&Package, &Package) -> bool,
    ) -> Vec<String> {
        let mut faults = Vec::new();
        for user in self.0.values() {
            for dependency in dependencies(user).filter(|it| it.path.is_some()) {
                let used = &self.0[&dependency.name];
                if is_wrong(user, used) {
                    faults.push(format!("{} uses {}", user.folder(), used.folder()));
                }
            }
        }
        faults
    }

    /// The crates of ours that `name` is built from, at any depth, with itself.
    fn below<'a>(&'a self, name: &'a str) -> BTreeSet<&'a str> {
        let (mut below, mut new) = (BTreeSet::from([name]), vec![name]);
        while let Some(one) = new.pop() {
            let used = self.0[one].production().filter(|it| it.path.is_some());
            let used = used.map(|it| it.name.as_str());
            new.extend(used.filter(|used| below.insert(*used)));
        }
        below
    }
}

#[test]
fn the_ground_imports_nothing_above_it() {
    let faults = Crates::read().faults(|user, used| user.room() == "ipc" && used.room() != "ipc");
    assert!(faults.is_empty(), "{}", faults.join("\n"));
}

#[test]
fn the_contract_knows_no_client() {
    let clients = "ipc/clients/";
    let faults = Crates::read().faults(|user, used| {
        let is_ground = user.room() == "ipc" && !user.folder().starts_with(clients);
        is_ground && used.folder().starts_with(clients)
    });
    assert!(faults.is_empty(), "{}", faults.join("\n"));
}

/// What may use the emulator and the table beside `tests`: the module for Python offers both.
const ABOVE_ALL: &str = "vpc-python";

#[test]
fn nothing_but_tests_builds_on_the_daemon_the_emulator_or_tests() {
    let faults = Crates::read().faults(|user, used| {
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
    let crates = Crates::read();
    let users = crates.0.keys();
    let users = users.filter(|name| crates.below(name).contains("ipc"));
    let others: Vec<_> = users
        .filter(|name| !OPEN_PORTS.contains(&name.as_str()))
        .collect();
    assert!(others.is_empty(), "{others:?} are built from ipc");
    let transports = crates.0.values().filter(|package| {
        package
            .production()
            .any(|dependency| dependency.name == "iceoryx2")
    });
    let names: Vec<_> = transports.map(|package| package.name.as_str()).collect();
    assert_eq!(names, ["ipc"], "iceoryx2");
}

#[test]
fn the_root_needs_no_client() {
    let crates = Crates::read();
    let all = |package: &'_ Package| package.workspace == WORKSPACES[0];
    let faults = crates.pairs(
        |package| package.dependencies.iter(),
        |user, used| all(user) && !all(used),
    );
    assert!(faults.is_empty(), "{}", faults.join("\n"));
    let root = crates.0.values().filter(|package| all(package)).count();
    assert!(root > 20 && crates.0.len() - root >= 8, "{root}");
}

fn table(path: &str) -> Table {
    let text = fs::read_to_string(root().join(path)).unwrap();
    text.parse()
        .unwrap_or_else(|error| panic!("{path}: {error}"))
}

/// What both workspaces depend on is built once.
#[test]
fn both_workspaces_ask_for_the_same_versions() {
    let asked = WORKSPACES.map(|workspace| {
        let manifest = table(&format!("{workspace}/Cargo.toml"));
        let asked = manifest["workspace"]["dependencies"].as_table().unwrap();
        let version = |value: &Value| match value {
            Value::String(version) => Some(version.clone()),
            other => Some(other.get("version")?.as_str()?.to_owned()),
        };
        let asked = asked.iter();
        let asked = asked.filter_map(|(name, value)| Some((name.clone(), version(value)?)));
        asked.collect::<BTreeMap<_, _>>()
    });
    let both = asked[0].keys().filter(|name| asked[1].contains_key(*name));
    let both: Vec<_> = both.collect();
    assert!(both.len() > 20, "{both:?}");
    for name in both {
        assert_eq!(asked[0][name], asked[1][name], "{name} in both Cargo.toml");
    }
}

#[test]
fn both_workspaces_lock_the_same_versions() {
    // Only one of those that are compatible with each other is built.
    let kind = |version: &str| {
        let numbers: Vec<_> = version.split('.').collect();
        match numbers[..] {
            ["0", "0", patch] => format!("0.0.{patch}"),
            ["0", minor, ..] => format!("0.{minor}"),
            [major, ..] => major.to_owned(),
            [] => String::new(),
        }
    };
    let locked = WORKSPACES.map(|workspace| {
        let lock = table(&format!("{workspace}/Cargo.lock"));
        let packages = lock["package"].as_array().unwrap().iter();
        let packages = packages.filter(|package| package.get("source").is_some());
        let packages = packages.map(|package| {
            let [name, version] = ["name", "version"].map(|key| package[key].as_str().unwrap());
            ((name.to_owned(), kind(version)), version.to_owned())
        });
        packages.collect::<BTreeMap<_, _>>()
    });
    let mut faults = Vec::new();
    for ((name, kind), version) in &locked[0] {
        let other = locked[1].get(&(name.clone(), kind.clone()));
        if let Some(other) = other.filter(|other| *other != version) {
            faults.push(format!(
                "cargo update -p {name}@{other} --precise {version}"
            ));
        }
    }
    assert!(locked[0].len() > 200, "{}", locked[0].len());
    assert!(faults.is_empty(), "in ipc/clients:\n{}", faults.join("\n"));
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
    let page = fs::read_to_string(root().join("ARCHITECTURE.md")).unwrap();
    let packages = Crates::read().0;
    let folders = packages.values().map(Package::folder);
    let lacking: Vec<_> = folders
        .filter(|it| !page.contains(&format!("`{it}/`")))
        .collect();
    assert!(
        lacking.is_empty(),
        "ARCHITECTURE.md does not name {lacking:?}"
    );
}
