//! The command as a process, against a stand-in for the daemon: same ports, same contract, no law.

mod browser;
mod doctor;
mod metrics;
mod requests;
mod serve;
mod stand_in;
mod status;
mod watch;

use std::path::Path;
use std::process::{Command, Output};

/// Runs `vpcctl` on a domain; it ends by itself, or else after a minute.
fn vpcctl(domain: &Path, words: &[&str]) -> Output {
    Command::new("timeout")
        .args(["60", env!("CARGO_BIN_EXE_vpcctl")])
        .arg("--domain")
        .arg(domain)
        .args(words)
        .output()
        .unwrap()
}

fn stdout(output: &Output) -> String {
    String::from_utf8(output.stdout.clone()).unwrap()
}

fn stderr(output: &Output) -> String {
    String::from_utf8(output.stderr.clone()).unwrap()
}
