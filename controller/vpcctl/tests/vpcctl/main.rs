//! The command as a process, against a stand-in for the daemon: same ports, same contract, no law.

mod browser;
mod check_bridge;
mod doctor;
mod foxglove;
mod full;
mod metrics;
mod monitoring;
mod recordings;
mod recover;
mod requests;
mod serve;
mod stand_in;
mod status;
mod teach;
mod watch;

use std::path::{Path, PathBuf};
use std::process::Output;

/// Runs `vpcctl` on a domain; it ends by itself, or else after a minute.
fn vpcctl(domain: &Path, words: &[&str]) -> Output {
    testkit::command("timeout")
        .args(["--foreground", "60", env!("CARGO_BIN_EXE_vpcctl")])
        .arg("--domain")
        .arg(domain)
        .args(words)
        .output()
        .unwrap()
}

/// Writes a scene with a painted mask, a ring about (300, 700) px, instead of the paper's
/// occlusions.
fn painted_scene(directory: &Path) -> PathBuf {
    let is_white = |u: u32, v: u32| {
        let square = u.abs_diff(300).pow(2) + v.abs_diff(700).pow(2);
        (120 * 120..200 * 200).contains(&square)
    };
    scene::write_mask(&directory.join("ring.png"), 1024, 1024, is_white).unwrap();
    let (head, _) = scene::PAPER_SIM.split_once("[[occlusion]]").unwrap();
    let text = format!("{head}[[occlusion]]\nname = \"ring\"\nmask = \"ring.png\"\n");
    let path = directory.join("painted.toml");
    std::fs::write(&path, text).unwrap();
    path
}

fn stdout(output: &Output) -> String {
    String::from_utf8(output.stdout.clone()).unwrap()
}

fn stderr(output: &Output) -> String {
    String::from_utf8(output.stderr.clone()).unwrap()
}
