//! The recording in the eyes of others: the Python packages of MCAP and Foxglove. Needs python3 and, the first time,
//! the network: without them it says so and does nothing, or fails where `VPC_REQUIRE_PYTHON` is set.

use std::path::{Path, PathBuf};
use std::process::Command;

use environment::{Environment, run};

#[path = "../../../tests/python/environment.rs"]
mod environment;

/// Files of this directory, wherever the test that shares it lies.
fn sources(within: &str) -> PathBuf {
    let here = Path::new(env!("CARGO_MANIFEST_DIR"));
    here.join("../recording/tests/python").join(within)
}

/// Python with the packages; `None`, loudly, where there is none.
pub fn python(test: &str) -> Option<PathBuf> {
    let environment = Environment {
        place: Path::new(env!("CARGO_TARGET_TMPDIR")).join("python-mcap"),
        requirements: vec![sources("requirements.txt")],
        packages: &[],
    };
    environment.python(test)
}

/// What `check.py` prints about these files.
pub fn check(python: &Path, what: &str, files: &[&Path]) -> Vec<String> {
    let mut command = Command::new(python);
    command
        .arg(sources("check.py"))
        .arg(what)
        .args(files)
        .env("PYTHONDONTWRITEBYTECODE", "1");
    let output = run(&mut command).unwrap_or_else(|reason| panic!("check.py {what}: {reason}"));
    let text = String::from_utf8(output.stdout).unwrap();
    text.lines().map(str::to_owned).collect()
}
