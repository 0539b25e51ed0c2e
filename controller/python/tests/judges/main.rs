//! The module for Python (`controller/python`): pip builds it as a user does, and its own tests run
//! against the programs of this build.

use std::path::Path;

use messages::{CycleRecord, DesiredTwist};
use recording::{RecordingFile, Sink};
use testkit::python::{Environment, run};
use testkit::{Place, command, root, target_directory};

const WHEEL: Environment = Environment {
    name: "python-wheel",
    requirements: &[],
    packages: &[
        "ipykernel>=7,<8",
        "matplotlib>=3.8",
        "maturin>=1.9.4,<2",
        "mypy>=2,<3",
        "nbclient>=0.10.4,<0.12",
        "numpy>=2,<3",
        "pandas>=2.2,<4",
        "proxsuite==0.8.0",
        "scipy==1.17.1",
    ],
};

/// Installs the module where this interpreter finds it.
fn install(python: &Path) {
    let mut pip = command(python);
    pip.args([
        "-m",
        "pip",
        "install",
        "--quiet",
        "--disable-pip-version-check",
    ]);
    // Its tools are there, and what others built in this target directory is not built again: so in
    // their profile. The law gives the same bits in each.
    pip.args(["--no-build-isolation", "--no-deps", "--force-reinstall"]);
    pip.args(["--config-settings", "build-args=--profile dev"]);
    let bin = python.parent().unwrap();
    let path = std::env::var("PATH").unwrap_or_default();
    pip.env("PATH", format!("{}:{path}", bin.display()));
    pip.env("CARGO_TARGET_DIR", target_directory());
    run(pip.arg(root().join("controller/python"))).unwrap();
}

/// Writes a recording of three cycles that commanded 0, 1 and 2 m/s along x, where 3 was wanted.
fn record(path: &Path) {
    let mut file = RecordingFile::create(path, false).unwrap();
    for cycle in 0..3 {
        let mut record = CycleRecord::default();
        (record.cycle, record.twist[0]) = (cycle, cycle as f64);
        file.write(&record).unwrap();
    }
    let wish = DesiredTwist::until([3.0, 0.0, 0.0, 0.0, 0.0, 0.0], 0);
    file.write(&wish).unwrap();
    file.finish().unwrap();
}

#[test]
#[ignore = "long: builds the module for Python and runs its notebooks"]
fn the_wheel_keeps_its_promises() {
    let Some(python) = WHEEL.python("the module for Python") else {
        return;
    };
    install(&python);
    let place = Place::new();
    let recorded = place.path("three.mcap");
    record(&recorded);
    let mut tests = command(&python);
    tests.arg(root().join("controller/python/tests/test_vpc.py"));
    tests.arg(testkit::program("vpc-lab"));
    tests.arg(testkit::program("vpc-memory")).arg(recorded);
    let said = run(&mut tests).unwrap_or_else(|fault| panic!("{fault}"));
    assert!(said.matches("test_").count() >= 15, "{said}");
    print!("{said}");
}
