//! The recording in the eyes of others: the Python packages of MCAP and Foxglove. Needs python3 and, the first time,
//! the network: without them it says so and does nothing, or fails where `VPC_REQUIRE_PYTHON` is set.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::OnceLock;

fn sources(within: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(within)
}

/// Runs a command to its end; its last line of complaint where it fails.
fn run(command: &mut Command) -> Result<Output, String> {
    let output = command.output().map_err(|error| error.to_string())?;
    if output.status.success() {
        return Ok(output);
    }
    let complaint = String::from_utf8_lossy(&output.stderr);
    let last = complaint.lines().rfind(|line| !line.trim().is_empty());
    Err(last.unwrap_or("no reason given").to_owned())
}

/// A virtual environment with the packages, made the first time; why there is none.
fn environment() -> Result<PathBuf, String> {
    run(Command::new("python3")
        .args(["-c", "import sys, venv; assert sys.version_info >= (3, 10)"]))
    .map_err(|reason| format!("python3 from 3.10 on is missing: {reason}"))?;
    let place = Path::new(env!("CARGO_TARGET_TMPDIR")).join("python-mcap");
    let python = place.join("bin/python");
    let requirements = sources("tests/python/requirements.txt");
    let wanted = std::fs::read_to_string(&requirements).map_err(|error| error.to_string())?;
    let done = place.join("requirements.txt");
    if std::fs::read_to_string(&done).is_ok_and(|done| done == wanted) {
        return Ok(python);
    }
    run(Command::new("python3")
        .args(["-m", "venv", "--clear"])
        .arg(&place))
    .map_err(|reason| format!("no virtual environment: {reason}"))?;
    run(Command::new(&python)
        .args([
            "-m",
            "pip",
            "install",
            "--quiet",
            "--disable-pip-version-check",
        ])
        .args([
            "--only-binary",
            ":all:",
            "--timeout",
            "10",
            "--retries",
            "1",
            "-r",
        ])
        .arg(&requirements))
    .map_err(|reason| format!("pip cannot install the packages: {reason}"))?;
    std::fs::write(done, wanted).map_err(|error| error.to_string())?;
    Ok(python)
}

/// Python with the packages; `None`, loudly, where there is none.
pub fn python(test: &str) -> Option<PathBuf> {
    static ENVIRONMENT: OnceLock<Result<PathBuf, String>> = OnceLock::new();
    match ENVIRONMENT.get_or_init(environment) {
        Ok(python) => Some(python.clone()),
        Err(reason) if std::env::var_os("VPC_REQUIRE_PYTHON").is_some() => panic!("{reason}"),
        Err(reason) => {
            // Past the capture of the test harness: a check that was not made must not look like one that passed.
            let message = format!("{test}: the part in Python was skipped: {reason}\n");
            let _ = std::io::stderr().write_all(message.as_bytes());
            None
        }
    }
}

/// What `check.py` prints about a file.
pub fn check(python: &Path, what: &str, file: &Path) -> Vec<String> {
    let mut command = Command::new(python);
    command
        .arg(sources("tests/python/check.py"))
        .arg(what)
        .arg(file)
        .env("PYTHONDONTWRITEBYTECODE", "1");
    let output = run(&mut command).unwrap_or_else(|reason| panic!("check.py {what}: {reason}"));
    let text = String::from_utf8(output.stdout).unwrap();
    text.lines().map(str::to_owned).collect()
}
