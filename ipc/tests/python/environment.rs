//! Virtual environments with what tests in Python need, made the first time. Tests of other crates share this file: it
//! depends on the standard library alone.

use std::collections::BTreeMap;
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::{Mutex, PoisonError};

/// Runs a command to its end; its last line of complaint where it fails.
///
/// # Errors
/// That line.
pub fn run(command: &mut Command) -> Result<Output, String> {
    let output = command.output().map_err(|error| error.to_string())?;
    if output.status.success() {
        return Ok(output);
    }
    let complaint = String::from_utf8_lossy(&output.stderr);
    let last = complaint.lines().rfind(|line| !line.trim().is_empty());
    Err(last.unwrap_or("no reason given").to_owned())
}

/// An environment.
#[derive(Clone, Debug)]
pub struct Environment {
    /// Its directory.
    pub place: PathBuf,
    /// Files of requirements; those that they name are to be named, too, or a change of them is not noticed.
    pub requirements: Vec<PathBuf>,
    /// More packages, as pip takes them.
    pub packages: &'static [&'static str],
}

impl Environment {
    /// What the client in `ipc/python`, its examples and its installation need; `place` is a directory of the build.
    #[allow(dead_code)] // not every test that shares this file needs the client
    pub fn of_client(client: &Path, place: &Path) -> Self {
        let files = [
            "requirements.txt",
            "requirements-logger.txt",
            "requirements-parquet.txt",
        ];
        Self {
            place: place.join("python-client"),
            requirements: files.map(|file| client.join(file)).to_vec(),
            packages: &["setuptools>=71", "pillow"],
        }
    }

    /// The interpreter, for this test; `None` where there is none, which is said past the capture of the test harness:
    /// a test that did nothing must not look like one that passed. With `VPC_REQUIRE_PYTHON` it fails instead.
    pub fn python(&self, test: &str) -> Option<PathBuf> {
        static MADE: Mutex<BTreeMap<PathBuf, Result<PathBuf, String>>> =
            Mutex::new(BTreeMap::new());
        let mut made = MADE.lock().unwrap_or_else(PoisonError::into_inner);
        let python = made.entry(self.place.clone());
        match python.or_insert_with(|| self.make()) {
            Ok(python) => Some(python.clone()),
            Err(reason) if std::env::var_os("VPC_REQUIRE_PYTHON").is_some() => panic!("{reason}"),
            Err(reason) => {
                let message = format!("{test}: the part in Python was skipped: {reason}\n");
                let _ = std::io::stderr().write_all(message.as_bytes());
                None
            }
        }
    }

    fn make(&self) -> Result<PathBuf, String> {
        run(Command::new("python3").args(["-c", "import tomllib, venv"]))
            .map_err(|reason| format!("python3 from 3.11 on is missing: {reason}"))?;
        let mut wanted = self.packages.join("\n");
        for file in &self.requirements {
            let text = std::fs::read_to_string(file);
            wanted += &text.map_err(|error| format!("{}: {error}", file.display()))?;
        }
        // Written at the end: an environment without this note, or with another one, is not whole.
        let note = self.place.join("wanted.txt");
        let python = self.place.join("bin/python");
        if std::fs::read_to_string(&note).is_ok_and(|done| done == wanted) {
            return Ok(python);
        }
        run(Command::new("python3")
            .args(["-m", "venv", "--clear"])
            .arg(&self.place))
        .map_err(|reason| format!("no virtual environment: {reason}"))?;
        let mut pip = Command::new(&python);
        pip.args(["-m", "pip", "install", "--disable-pip-version-check"]);
        pip.args(["--quiet", "--only-binary", ":all:", "--timeout", "10"]);
        pip.args(["--retries", "1"]).args(self.packages);
        for file in &self.requirements {
            pip.arg("-r").arg(file);
        }
        run(&mut pip).map_err(|reason| format!("pip cannot install the packages: {reason}"))?;
        std::fs::write(note, wanted).map_err(|error| error.to_string())?;
        Ok(python)
    }
}

/// A program in Python, ready to run: it finds the client in the tree and writes nothing there.
#[allow(dead_code)] // as above
pub fn script(python: &Path, client: &Path, program: &Path) -> Command {
    let mut command = Command::new(python);
    command.arg(program).env("PYTHONPATH", client);
    command.env("PYTHONDONTWRITEBYTECODE", "1");
    command
}
