//! `cargo xtask measure`: what needs the wall clock, measured on this machine.

use anyhow::{Context as _, ensure};

use crate::root;

/// Runs the measurements whose name has one of these words, or all; the findings go to
/// `target/measure/results.json`, and a page beside it.
///
/// # Errors
/// If one of them is broken.
pub fn measure(names: &[String], is_long: bool) -> anyhow::Result<()> {
    let mut cargo = testkit::command(env!("CARGO"));
    cargo.current_dir(root());
    cargo.args(["test", "--quiet", "--test", "measure", "--"]);
    cargo.args(names);
    if is_long {
        cargo.arg("--long");
    }
    let status = cargo.status().context("cargo cannot be run")?;
    ensure!(status.success(), "a promise is broken: {status}");
    Ok(())
}
