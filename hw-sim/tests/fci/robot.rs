//! A robot of one test, and clients of it in Python.

use std::net::Ipv4Addr;
use std::path::PathBuf;
use std::process::{Command, Stdio};
use std::sync::atomic::{AtomicU32, Ordering};

use serde_json::Value;
use testkit::python::{Environment, script};
use testkit::{Ended, Place, Running};

/// The vendor's library, as PyPI has it.
const LIBFRANKA: Environment = Environment {
    name: "python-panda",
    requirements: &[],
    packages: &["panda-python==1.1.1"],
};
/// The port that clients connect to.
pub const PORT: u16 = 1337;

/// `hw-sim` as a robot at an address of its own; stopped when it is dropped.
pub struct Robot {
    running: Running,
    address: Ipv4Addr,
    python: PathBuf,
    place: Place,
}

impl Robot {
    /// A robot that waits for clients. `None`, after [`testkit::not_run`], where the vendor's
    /// library cannot be had.
    pub fn start(test: &str) -> Option<Self> {
        let python = LIBFRANKA.python(test)?;
        let (address, place) = (own_address(), Place::new());
        let scenes = testkit::root().join("ipc/scene/scenes");
        let mut command = Command::new(env!("CARGO_BIN_EXE_hw-sim"));
        command
            .args(["--robot", "panda", "--fci-version", "5", "--fci"])
            .arg(format!("{address}:{PORT}"))
            .arg("--scene")
            .arg(scenes.join("paper-robot.toml"))
            .arg("--starts")
            .arg(scenes.join("paper-robot-starts.csv"))
            .arg("--domain")
            .arg(place.domain())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped());
        let mut running = Running::start(command);
        running.line("features go out");
        Some(Self {
            running,
            address,
            python,
            place,
        })
    }

    /// Where it listens.
    pub fn address(&self) -> Ipv4Addr {
        self.address
    }

    /// Starts a client with one case of `panda.py`.
    pub fn client(&self, case: &str) -> Running {
        let program = testkit::root().join("hw-sim/tests/fci/panda.py");
        let mut command = script(&self.python, &program);
        command
            .arg(self.address.to_string())
            .arg(case)
            .stdout(Stdio::piped())
            .stderr(Stdio::piped());
        Running::start(command)
    }

    /// What a client saw in one case of `panda.py`.
    pub fn seen(&self, case: &str) -> Value {
        seen(self.client(case))
    }

    /// Waits until it says these words.
    pub fn says(&mut self, words: &str) {
        self.running.line(words);
    }

    /// Stops it; what its own referee counted.
    pub fn stopped(self) -> Value {
        let Ended { stdout, stderr, .. } = self.running.terminated();
        drop(self.place);
        let outcome: Value = serde_json::from_str(&stdout)
            .unwrap_or_else(|error| panic!("{error}: {stdout} {stderr}"));
        assert_eq!(outcome["verdict"], "stopped", "{outcome}");
        outcome["arm"].clone()
    }
}

/// Waits for the end of a client; what it saw.
pub fn seen(client: Running) -> Value {
    let Ended {
        code,
        stdout,
        stderr,
        ..
    } = client.ended();
    assert_eq!(code, Some(0), "{stdout} {stderr}");
    let line = stdout.lines().last().unwrap_or_default();
    serde_json::from_str(line).unwrap_or_else(|error| panic!("{error}: {line} {stderr}"))
}

/// A loopback address that no other test of this machine has, as all clients of the vendor's connect
/// to one port: 127, then twenty bits of the process, then four of the test.
fn own_address() -> Ipv4Addr {
    static TAKEN: AtomicU32 = AtomicU32::new(0);
    let test = 1 + TAKEN.fetch_add(1, Ordering::Relaxed);
    assert!(test < 15, "more robots than addresses");
    Ipv4Addr::from(127 << 24 | (std::process::id() & 0xf_ffff) << 4 | test)
}
