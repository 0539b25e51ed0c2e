//! `check.py`, with the packages of MCAP and Foxglove.

use std::path::{Path, PathBuf};

use testkit::python::{Environment, run, script};

/// Python with these packages.
pub fn python(test: &str) -> Option<PathBuf> {
    Environment::JUDGES.python(test)
}

/// What `check.py` prints about these files.
pub fn check(python: &Path, what: &str, files: &[&Path]) -> Vec<String> {
    let program = testkit::root().join("controller/recorder/tests/python/check.py");
    let mut command = script(python, &program);
    let output = run(command.arg(what).args(files));
    let text = output.unwrap_or_else(|reason| panic!("check.py {what}: {reason}"));
    text.lines().map(str::to_owned).collect()
}
