//! Test fixtures that several crates share: for tests, and for the programs of `system-tests`.
//!
//! - [`Place`]: a temporary directory with a domain in it.
//! - [`command`]: what every process is started by, so that it ends with this one.
//! - [`program`], [`Running`], [`ended`]: programs of this workspace as processes.
//! - [`eventually`]: waits for a condition.
//! - [`c`]: programs in C.
//! - [`python`]: virtual environments for tests in Python; [`node`]: packages of npm.
//! - [`not_run`]: what a test calls if the machine lacks something.
//!
//! Environment variables: `VPC_STRICT=1` turns every "NOT RUN" into a failure, unless
//! `.ci/exceptions` lists it; `VPC_BUILT=1` takes programs as they are built; `VPC_LONG=1` runs
//! tests at full length.

#![forbid(unsafe_code)]

pub mod c;
mod guardian;
pub mod node;
mod place;
mod process;
mod program;
pub mod python;

use std::fmt::Display;
use std::fs::File;
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::process::Stdio;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

pub use guardian::{command, end_children};
pub use place::Place;
pub use process::{Ended, Running, ended};
pub use program::{cargo_build, program, target_directory};

/// After what time a test takes anything for hanging: longer than a machine may be busy with
/// something else. It decides nothing about a program that works.
pub const PATIENCE: Duration = Duration::from_secs(100);

/// Families of markers of every size and kind, for the tests that go through them.
pub const FAMILIES: [&str; 8] = [
    "DICT_4X4_50",
    "DICT_5X5_100",
    "DICT_6X6_250",
    "DICT_7X7_1000",
    "DICT_ARUCO_ORIGINAL",
    "DICT_APRILTAG_16h5",
    "DICT_APRILTAG_25h9",
    "DICT_APRILTAG_36h11",
];

/// Prints a line to standard error, past the test harness, which captures `println!`.
pub fn tell(line: impl Display) {
    let _ = std::io::stderr().write_all(format!("{line}\n").as_bytes());
}

/// Waits for its turn to fill a directory that several processes use: until the file is dropped.
fn locked(directory: &Path) -> Result<File, String> {
    let lock = || {
        std::fs::create_dir_all(directory)?;
        let file = File::create(directory.with_extension("lock"))?;
        file.lock().map(|()| file)
    };
    lock().map_err(|error| format!("{}: {error}", directory.display()))
}

/// Reports that a test, or a part of it, does not run on this machine.
///
/// Returns from the test after calling it: a test that did nothing must not look like one that
/// passed.
///
/// # Panics
/// With `VPC_STRICT=1`, unless `.ci/exceptions` has a phrase of the line.
pub fn not_run(what: &str, why: impl Display) {
    // The harness names the thread of a test after it.
    let thread = std::thread::current();
    let test = thread.name().unwrap_or("main");
    let line = format!("NOT RUN ({test}): {what}: {why}");
    assert!(!is_set("VPC_STRICT") || is_excepted(&line), "{line}");
    tell(line);
}

/// Returns whether a line of `.ci/exceptions`, `PHRASE: reason`, has a phrase of this one.
fn is_excepted(line: &str) -> bool {
    let listed = std::fs::read_to_string(root().join(".ci/exceptions")).unwrap_or_default();
    let lines = listed.lines().filter(|line| !line.starts_with('#'));
    let mut phrases = lines.filter_map(|line| line.split_once(':'));
    phrases.any(|(phrase, _)| line.contains(phrase.trim()))
}

/// A folder of `VPC_REAL`, recordings of real cameras and robots; `None`, after [`not_run`], where
/// it is not here.
pub fn real(what: &str, folder: &str) -> Option<PathBuf> {
    let place = std::env::var_os("VPC_REAL").map(|place| Path::new(&place).join(folder));
    let place = place.filter(|place| place.is_dir());
    if place.is_none() {
        not_run(what, format_args!("VPC_REAL names no folder with {folder}"));
    }
    place
}

/// Returns whether this process is root; calls [`not_run`] if not.
pub fn is_root(what: &str) -> bool {
    let is_root = rustix::process::geteuid().is_root();
    if !is_root {
        not_run(what, "needs root");
    }
    is_root
}

/// Returns whether all programs are installed; calls [`not_run`] with those that are not.
///
/// Each is given as `program` or `program=package`, where the Debian package has another name.
pub fn are_installed(what: &str, programs: &[&str]) -> bool {
    let lacks: Vec<_> = programs
        .iter()
        .map(|program| program.split_once('=').unwrap_or((program, program)))
        .filter(|(program, _)| !is_installed(program))
        .collect();
    if lacks.is_empty() {
        return true;
    }
    let names: Vec<_> = lacks.iter().map(|(program, _)| *program).collect();
    let packages: Vec<_> = lacks.iter().map(|(_, package)| *package).collect();
    let (names, packages) = (names.join(", "), packages.join(" "));
    not_run(
        what,
        format_args!("{names} missing (apt-get install {packages})"),
    );
    false
}

fn is_installed(program: &str) -> bool {
    let found = crate::command("sh")
        .args([
            "-c",
            "PATH=$PATH:/usr/sbin:/sbin command -v \"$0\"",
            program,
        ])
        .stdout(Stdio::null())
        .status();
    found.is_ok_and(|status| status.success())
}

/// Returns whether tests run at full length.
pub fn is_long() -> bool {
    is_set("VPC_LONG")
}

/// The number of repetitions: `long` with `VPC_LONG=1`, else `short`, which it prints.
pub fn repeats(what: &str, short: usize, long: usize) -> usize {
    if is_long() {
        return long;
    }
    tell(format_args!("{what}: {short} times; VPC_LONG=1: {long}"));
    short
}

fn is_set(switch: &str) -> bool {
    std::env::var_os(switch).is_some_and(|value| !value.is_empty() && value != "0")
}

/// Waits until no other test of this executable holds the turn: for tests that measure time.
pub fn turn() -> MutexGuard<'static, ()> {
    static TURN: Mutex<()> = Mutex::new(());
    TURN.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Calls `attempt` every half millisecond until it returns `Some`.
///
/// # Panics
/// After [`PATIENCE`].
pub fn eventually<T>(what: &str, attempt: impl FnMut() -> Option<T>) -> T {
    within(PATIENCE, attempt).unwrap_or_else(|| panic!("{what}: did not happen in {PATIENCE:?}"))
}

/// Calls `attempt` every half millisecond until it returns `Some`; `None` when `patience` is over.
pub fn within<T>(patience: Duration, mut attempt: impl FnMut() -> Option<T>) -> Option<T> {
    let start = Instant::now();
    loop {
        if let Some(value) = attempt() {
            return Some(value);
        }
        if start.elapsed() > patience {
            return None;
        }
        std::thread::sleep(Duration::from_micros(500));
    }
}

/// The root of the repository.
pub fn root() -> &'static Path {
    let here = Path::new(env!("CARGO_MANIFEST_DIR"));
    here.ancestors().nth(2).expect("tests/testkit")
}

/// The scene file of the paper's simulation.
pub fn scene_file() -> PathBuf {
    root().join("ipc/scene/scenes/paper-sim.toml")
}

/// The hundred starts of the paper's simulation.
pub fn starts_file() -> PathBuf {
    root().join("ipc/scene/scenes/paper-sim-starts.csv")
}

/// The default memory of the paper's simulation.
pub fn memory_file() -> PathBuf {
    root().join("memory-blob/default/paper-sim.vpcmem")
}
