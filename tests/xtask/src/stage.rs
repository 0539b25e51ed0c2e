//! The stages of CI, each a command that anyone runs alone: `cargo xtask strict`, `unprivileged`,
//! `clients`, `judges` and `long`. `.ci/run` runs them in a fresh clone, after the README's commands.
//!
//! A stage ends with its first failure. `VPC_STRICT=1`, which CI sets, makes a judge that cannot
//! run on this machine fail, unless `.ci/exceptions` lists it.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Instant;

use anyhow::{Context as _, bail, ensure};
use serde_json::Value;

use crate::root;

/// The two workspaces, below the root of the repository.
const WORKSPACES: [&str; 2] = [".", "ipc/clients"];

/// Test executables that run cargo, which another user may not reach.
const NEEDS_CARGO: [&str; 2] = ["documents", "layers"];

/// Returns a command of cargo in a workspace.
fn cargo(workspace: &str, arguments: &[&str]) -> Command {
    let mut cargo = testkit::command(env!("CARGO"));
    cargo.current_dir(root().join(workspace)).args(arguments);
    cargo
}

/// Runs a command to its end and prints how long it took.
fn run(name: &str, command: &mut Command) -> anyhow::Result<()> {
    println!("\n-- {name}");
    let begin = Instant::now();
    let status = command.status().with_context(|| format!("{command:?}"))?;
    ensure!(status.success(), "{name}: {status}");
    println!("-- {name}: {:.0} s", begin.elapsed().as_secs_f64());
    Ok(())
}

/// Runs cargo with these arguments in both workspaces, in the second also if the first fails.
fn in_both(arguments: &[&str]) -> anyhow::Result<()> {
    let outcomes = WORKSPACES.map(|workspace| {
        let name = format!("cargo {} in {workspace}", arguments.join(" "));
        run(&name, &mut cargo(workspace, arguments))
    });
    outcomes.into_iter().collect()
}

/// Format, lints, documentation, generated files, licences and sources of packages.
pub fn strict() -> anyhow::Result<()> {
    in_both(&["fmt", "--all", "--check"])?;
    // Judges and measurements are no targets of `cargo test`, nor of `--all-targets`.
    let apart = [
        (".", &["judges", "measure"][..]),
        ("ipc/clients", &["judges"]),
    ];
    for (workspace, targets) in apart {
        let lint = |targets: &[&str]| {
            let mut clippy = cargo(workspace, &["clippy", "--workspace", "--locked"]);
            clippy.args(targets).args(["--", "-D", "warnings"]);
            run(
                &format!("cargo clippy {} in {workspace}", targets.join(" ")),
                &mut clippy,
            )
        };
        lint(&["--all-targets"])?;
        let targets = targets.iter().flat_map(|target| ["--test", target]);
        lint(&targets.collect::<Vec<_>>())?;
    }
    // A user's own debug build does not optimize the law; its stack must do all the same.
    let plain = "profile.dev.package.vpc.opt-level=0";
    let stack = ["test", "--locked", "--test", "stack", "--config", plain];
    run(
        "the stack of a law that is not optimized",
        &mut cargo(".", &stack),
    )?;
    for workspace in WORKSPACES {
        let mut doc = cargo(workspace, &["doc", "--workspace", "--no-deps", "--locked"]);
        doc.env("RUSTDOCFLAGS", "-D warnings");
        run(&format!("cargo doc in {workspace}"), &mut doc)?;
    }
    crate::codegen(true)?;
    in_both(&["deny", "--locked", "check", "licenses", "bans", "sources"])
}

/// The test executables of the root once more, as a user without any right (`nobody`).
pub fn unprivileged() -> anyhow::Result<()> {
    ensure!(
        rustix::process::geteuid().is_root(),
        "only root can become another user; an ordinary user runs `cargo test`"
    );
    let place = testkit::Place::for_all_users();
    let own = place.path("nobody");
    std::fs::create_dir(&own)?;
    const NOBODY: u32 = 65534;
    std::os::unix::fs::chown(&own, Some(NOBODY), Some(NOBODY))?;
    for (name, program, directory) in test_executables()? {
        if NEEDS_CARGO.contains(&name.as_str()) {
            continue;
        }
        let mut command = testkit::command("setpriv");
        command.args(["--reuid", "65534", "--regid", "65534", "--clear-groups"]);
        command.args(["--bounding-set", "-all", "--no-new-privs"]);
        command.arg(program).current_dir(&directory);
        // As cargo does; insta would ask cargo for the root.
        command.env("CARGO_MANIFEST_DIR", &directory);
        command.env("INSTA_WORKSPACE_ROOT", root());
        // Programs are built, in a directory that is not this user's.
        command
            .env("VPC_BUILT", "1")
            .env("HOME", &own)
            .env("TMPDIR", &own);
        run(&format!("{name}, as nobody"), &mut command)?;
    }
    Ok(())
}

/// Name, path and working directory of each test executable of the root.
fn test_executables() -> anyhow::Result<Vec<(String, PathBuf, PathBuf)>> {
    let build = ["test", "--no-run", "--locked", "--message-format=json"];
    let output = cargo(".", &build)
        .stderr(std::process::Stdio::inherit())
        .output()?;
    ensure!(
        output.status.success(),
        "cargo test --no-run: {}",
        output.status
    );
    let mut found = Vec::new();
    for line in String::from_utf8(output.stdout)?.lines() {
        let message: Value = serde_json::from_str(line)?;
        let text = |value: &Value| value.as_str().map(str::to_owned);
        let is_test = message["profile"]["test"] == true;
        if let (true, Some(program)) = (is_test, text(&message["executable"])) {
            let name = text(&message["target"]["name"]).context("a target without a name")?;
            let manifest = text(&message["manifest_path"]).context("no manifest_path")?;
            let directory = Path::new(&manifest).parent().context("no directory")?;
            found.push((name, program.into(), directory.to_owned()));
        }
    }
    ensure!(!found.is_empty(), "cargo built no test executable");
    Ok(found)
}

/// Builds and tests the clients' workspace.
pub fn clients() -> anyhow::Result<()> {
    run(
        "cargo build",
        &mut cargo("ipc/clients", &["build", "--locked"]),
    )?;
    run(
        "cargo test",
        &mut cargo("ipc/clients", &["test", "--locked"]),
    )
}

/// Programs, libraries and data of others judge ours.
pub fn judges() -> anyhow::Result<()> {
    in_both(&[
        "test",
        "--workspace",
        "--locked",
        "--no-fail-fast",
        "--test",
        "judges",
    ])
}

/// What takes long: installations, the Python module, the package, the book, and every test at full
/// length.
pub fn long() -> anyhow::Result<()> {
    let programs = [
        ("controller", "vpcd"),
        ("hw-sim", "hw-sim"),
        ("controller/vpcctl", "vpcctl"),
        ("memory-blob/builder", "vpc-memory"),
        ("ipc/clients/panda", "vpc-panda"),
        ("ipc/clients/camera", "vpc-camera"),
        ("ipc/clients/ros2", "vpc-ros2"),
    ];
    let place = testkit::Place::new();
    let installed = place.path("installed");
    for (directory, program) in programs {
        let mut install = cargo(
            ".",
            &["install", "--locked", "--debug", "--quiet", "--no-track"],
        );
        install
            .args(["--path", directory, "--root"])
            .arg(&installed);
        run(&format!("cargo install --path {directory}"), &mut install)?;
        let mut version = testkit::command(installed.join("bin").join(program));
        version.arg("--version").env_clear().current_dir("/");
        run(
            &format!("{program} --version, without an environment"),
            &mut version,
        )?;
    }
    let mut failures = Vec::new();
    for workspace in WORKSPACES {
        let mut tests = cargo(
            workspace,
            &["test", "--workspace", "--locked", "--no-fail-fast"],
        );
        tests.args(["--", "--include-ignored"]).env("VPC_LONG", "1");
        failures.extend(
            run(
                &format!("every test at full length in {workspace}"),
                &mut tests,
            )
            .err(),
        );
        let mut judges = cargo(
            workspace,
            &["test", "--workspace", "--locked", "--no-fail-fast"],
        );
        judges
            .args(["--test", "judges", "--", "--include-ignored"])
            .env("VPC_LONG", "1");
        failures.extend(
            run(
                &format!("every judge at full length in {workspace}"),
                &mut judges,
            )
            .err(),
        );
    }
    if !failures.is_empty() {
        let failures: Vec<_> = failures.iter().map(|error| format!("{error:#}")).collect();
        bail!("{}", failures.join("; "));
    }
    Ok(())
}
