//! The command as a process.

use std::path::{Path, PathBuf};
use std::process::Output;

/// Runs `vpcctl` on a domain; it ends by itself, or else after five minutes.
pub fn vpcctl(domain: &Path, words: &[&str]) -> Output {
    testkit::command("timeout")
        .args(["--foreground", "300", env!("CARGO_BIN_EXE_vpcctl")])
        .arg("--domain")
        .arg(domain)
        .args(words)
        .output()
        .unwrap()
}

/// Writes a scene with a painted mask, a ring about (300, 700) px, instead of the paper's
/// occlusions.
pub fn painted_scene(directory: &Path) -> PathBuf {
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

pub fn stdout(output: &Output) -> String {
    String::from_utf8(output.stdout.clone()).unwrap()
}

pub fn stderr(output: &Output) -> String {
    String::from_utf8(output.stderr.clone()).unwrap()
}
