//! Virtual environments for tests in Python, made at the first use.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::{Mutex, PoisonError};

use crate::{Ended, locked, not_run, root, target_directory};

/// Runs a command to its end; its standard output.
///
/// # Errors
/// Standard error, where it fails; how it ended, where that is all.
pub fn run(command: &mut Command) -> Result<String, String> {
    let output = command.output().map_err(|error| error.to_string())?;
    let status = output.status;
    let Ended { stdout, stderr, .. } = output.into();
    if status.success() {
        return Ok(stdout);
    }
    match stderr.trim() {
        said if status.code().is_some() && !said.is_empty() => Err(said.to_owned()),
        said => Err(format!("{status}: {said}")),
    }
}

/// A virtual environment in the target directory.
#[derive(Clone, Debug)]
pub struct Environment {
    /// The name of its directory.
    pub name: &'static str,
    /// Requirement files, from the root of the repository. Name those that they include, too: a
    /// change of any file makes the environment again.
    pub requirements: &'static [&'static str],
    /// More packages, as pip takes them.
    pub packages: &'static [&'static str],
}

impl Environment {
    /// What the judges need, pinned by hash: what does not conflict with it is in it.
    pub const JUDGES: Self = Self {
        name: "python-judges",
        requirements: &["tests/tests/judges/requirements.txt"],
        packages: &[],
    };

    /// The interpreter. `None`, after [`not_run`], where the machine has no Python 3.11 or no
    /// network.
    pub fn python(&self, test: &str) -> Option<PathBuf> {
        static MADE: Mutex<BTreeMap<&str, Result<PathBuf, String>>> = Mutex::new(BTreeMap::new());
        let mut made = MADE.lock().unwrap_or_else(PoisonError::into_inner);
        match made.entry(self.name).or_insert_with(|| self.make()) {
            Ok(python) => Some(python.clone()),
            Err(reason) => {
                not_run(test, format_args!("Python: {reason}"));
                None
            }
        }
    }

    fn make(&self) -> Result<PathBuf, String> {
        run(crate::command("python3").args(["-c", "import tomllib, venv"]))
            .map_err(|reason| format!("python3 3.11 or later is missing: {reason}"))?;
        let mut wanted = self.packages.join("\n");
        for file in self.requirements {
            let text = std::fs::read_to_string(root().join(file));
            wanted += &text.map_err(|error| format!("{file}: {error}"))?;
        }
        let directory = target_directory().join("tmp").join(self.name);
        let _turn = locked(&directory)?;
        // Written at the end: without it, or with other contents, the environment is made again.
        let note = directory.join("wanted.txt");
        let python = directory.join("bin/python");
        if std::fs::read_to_string(&note).is_ok_and(|done| done == wanted) {
            return Ok(python);
        }
        run(crate::command("python3")
            .args(["-m", "venv", "--clear"])
            .arg(&directory))
        .map_err(|reason| format!("no virtual environment: {reason}"))?;
        let mut pip = crate::command(&python);
        pip.args([
            "-m",
            "pip",
            "install",
            "--quiet",
            "--disable-pip-version-check",
        ]);
        pip.args([
            "--only-binary",
            ":all:",
            "--timeout",
            "10",
            "--retries",
            "1",
        ]);
        pip.args(self.packages);
        for file in self.requirements {
            pip.arg("-r").arg(root().join(file));
        }
        run(&mut pip).map_err(|reason| format!("pip cannot install the packages: {reason}"))?;
        std::fs::write(note, wanted).map_err(|error| error.to_string())?;
        Ok(python)
    }
}

/// A program in Python, ready to run: it finds the client in the tree and writes no byte code
/// there.
pub fn script(python: &Path, program: &Path) -> Command {
    let mut command = crate::command(python);
    command
        .arg(program)
        .env("PYTHONPATH", root().join("ipc/clients/python"));
    command.env("PYTHONDONTWRITEBYTECODE", "1");
    command
}
