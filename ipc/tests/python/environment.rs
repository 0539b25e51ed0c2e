//! A virtual environment with what the client in Python needs, made the first time. Tests of other crates share this
//! file: it depends on the standard library alone.

use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::OnceLock;

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

/// The interpreter, for this test; `None` where there is none, which is said past the capture of the test harness: a
/// test that did nothing must not look like one that passed. With `VPC_REQUIRE_PYTHON` it fails instead.
///
/// `client` is the directory `ipc/python`, `place` one of the build directory.
pub fn python(test: &str, client: &Path, place: &Path) -> Option<PathBuf> {
    static PYTHON: OnceLock<Result<PathBuf, String>> = OnceLock::new();
    match PYTHON.get_or_init(|| environment(client, &place.join("python-client"))) {
        Ok(python) => Some(python.clone()),
        Err(reason) if std::env::var_os("VPC_REQUIRE_PYTHON").is_some() => panic!("{reason}"),
        Err(reason) => {
            let message = format!("{test}: skipped: {reason}\n");
            let _ = std::io::stderr().write_all(message.as_bytes());
            None
        }
    }
}

fn environment(client: &Path, place: &Path) -> Result<PathBuf, String> {
    run(Command::new("python3").args(["-c", "import tomllib, venv"]))
        .map_err(|reason| format!("python3 from 3.11 on is missing: {reason}"))?;
    let python = place.join("bin/python");
    let complete = "import numpy, pandas, PIL, importlib.metadata as m; \
                    assert m.version('iceoryx2') == '0.9.3'; \
                    assert int(m.version('setuptools').split('.')[0]) >= 71";
    if run(Command::new(&python).args(["-c", complete])).is_ok() {
        return Ok(python);
    }
    run(Command::new("python3")
        .args(["-m", "venv", "--clear"])
        .arg(place))
    .map_err(|reason| format!("no virtual environment: {reason}"))?;
    let mut pip = Command::new(&python);
    pip.args(["-m", "pip", "install", "--disable-pip-version-check"]);
    pip.args(["--quiet", "--only-binary", ":all:", "--timeout", "10"]);
    pip.args(["--retries", "1", "setuptools>=71", "pillow", "-r"]);
    run(pip.arg(client.join("requirements-logger.txt")))
        .map_err(|reason| format!("pip cannot install the client's requirements: {reason}"))?;
    Ok(python)
}

/// A program in Python, ready to run: it finds the client in the tree and writes nothing there.
pub fn script(python: &Path, client: &Path, program: &Path) -> Command {
    let mut command = Command::new(python);
    command.arg(program).env("PYTHONPATH", client);
    command.env("PYTHONDONTWRITEBYTECODE", "1");
    command
}
