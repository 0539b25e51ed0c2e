//! A robot of one test, and clients of it in Python.

use std::net::Ipv4Addr;
use std::path::PathBuf;
use std::process::Stdio;

use serde_json::Value;
use testkit::python::{Environment, script};
use testkit::{Ended, Place, Running};

use crate::robot::own_address;

/// The program here that uses a library of the vendor's in Python.
#[derive(Debug)]
pub struct Library(pub &'static str);

/// libfranka 0.9.2, which speaks version 5.
pub const OF_PANDA: Library = Library("panda.py");
/// libfranka 0.21, which speaks version 10.
pub const OF_FR3: Library = Library("fr3.py");
/// The port that clients connect to.
pub const PORT: u16 = 1337;

/// `hw-sim` as a robot at an address of its own; stopped when it is dropped.
pub struct Robot {
    running: Running,
    address: Ipv4Addr,
    /// Python and the program of its clients there.
    client: (PathBuf, &'static str),
    place: Place,
}

impl Robot {
    /// A Panda that waits for clients of its library. `None`, after [`testkit::not_run`], where
    /// that cannot be had.
    pub fn start(test: &str) -> Option<Self> {
        Self::judged_by(&OF_PANDA, 5, test)
    }

    /// A robot of this version of the interface that waits for clients of a library. `None`, after
    /// [`testkit::not_run`], where that cannot be had.
    pub fn judged_by(library: &Library, version: u16, test: &str) -> Option<Self> {
        let python = Environment::JUDGES.python(test)?;
        let (address, place) = (own_address(), Place::new());
        let scenes = testkit::root().join("ipc/scene/scenes");
        let scene = std::fs::read_to_string(scenes.join("paper-robot.toml")).unwrap();
        // Clients here move the arm as they like, and not for its camera's sake.
        let scene = scene.replace("violation_px = 15.0", "violation_px = 1e4");
        let mut command = testkit::command(testkit::program("hw-sim"));
        command
            .args(["--robot", "panda", "--fci-version"])
            .arg(version.to_string())
            .arg("--fci")
            .arg(format!("{address}:{PORT}"))
            .arg("--scene")
            .arg(place.file("scene.toml", scene))
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
            client: (python, library.0),
            place,
        })
    }

    /// Where it listens.
    pub fn address(&self) -> Ipv4Addr {
        self.address
    }

    /// Starts a client with one case of its program.
    pub fn client(&self, case: &str) -> Running {
        let (python, program) = &self.client;
        let program = testkit::root()
            .join("ipc/clients/panda/tests/judges/fci")
            .join(program);
        let mut command = script(python, &program);
        command
            .arg(self.address.to_string())
            .arg(case)
            .stdout(Stdio::piped())
            .stderr(Stdio::piped());
        Running::start(command)
    }

    /// What a client saw in one case of its program.
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
