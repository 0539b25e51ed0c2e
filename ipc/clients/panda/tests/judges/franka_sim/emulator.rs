//! Other teams' emulators as processes.

use std::net::Ipv4Addr;
use std::process::Stdio;

use testkit::python::{Environment, script};
use testkit::{Ended, Running};

use crate::robot::own_address;

const FRANKA_SIM: Environment = Environment {
    name: "python-franka-sim",
    requirements: &[],
    packages: &["franka-sim==1.1.7", "mujoco==3.2.7", "numpy==1.26.4"],
};

const FRANKY_SIM: Environment = Environment {
    name: "python-franky-sim",
    requirements: &[],
    packages: &[
        "franky-sim==1.0.4",
        "mujoco==4.0.0",
        "numpy==2.4.6",
        "pin==4.1.0",
    ],
};

/// Whose emulator it is.
#[derive(Clone, Copy)]
pub enum Team {
    /// franka-sim, which holds each command against the vendor's limits.
    Franka,
    /// franky-sim, whose joints have the robot's torques.
    Franky,
}

/// A robot at an address of its own; stopped when it is dropped.
pub struct Emulator {
    running: Running,
    address: Ipv4Addr,
}

impl Emulator {
    /// franka-sim, which waits for a client. `None`, after [`testkit::not_run`], where it cannot be
    /// had.
    pub fn start(test: &str) -> Option<Self> {
        Self::start_at(Team::Franka, test, &panda::READY)
    }

    /// The robot of a team with these joints, rad.
    pub fn start_at(team: Team, test: &str, q: &[f64; 7]) -> Option<Self> {
        let (environment, program) = match team {
            Team::Franka => (FRANKA_SIM, "emulator.py"),
            Team::Franky => (FRANKY_SIM, "franky.py"),
        };
        let python = environment.python(test)?;
        let address = own_address();
        let tests = testkit::root().join("ipc/clients/panda/tests/judges/franka_sim");
        let program = tests.join(program);
        let mut command = script(&python, &program);
        command
            .arg(address.to_string())
            .args(q.map(|q| q.to_string()))
            .stdout(Stdio::piped())
            .stderr(Stdio::piped());
        let mut running = Running::start(command);
        running.line("Server ready for new client connection");
        Some(Self { running, address })
    }

    /// Where it listens, on the port of the interface.
    pub fn address(&self) -> Ipv4Addr {
        self.address
    }

    /// Stops it; its log.
    pub fn stopped(self) -> String {
        let Ended { stdout, stderr, .. } = self.running.terminated();
        stdout + &stderr
    }
}
