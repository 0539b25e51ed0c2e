//! What a page of a release has: source, Debian package, wheel of the Python client, notes, and
//! their checksums.

use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, ensure};
use testkit::python::run;

use crate::root;

const VERSION: &str = env!("CARGO_PKG_VERSION");

/// Makes all of it in a directory, which must be empty or not be there.
pub fn release(to: &Path) -> anyhow::Result<()> {
    let changed = said(tool("git").args(["status", "--porcelain"]))?;
    ensure!(changed.is_empty(), "not committed:\n{changed}");
    std::fs::create_dir_all(to).with_context(|| to.display().to_string())?;
    let to = &to.canonicalize()?;
    let is_empty = std::fs::read_dir(to)?.next().is_none();
    ensure!(is_empty, "{}: not empty", to.display());

    let source = to.join(format!("vpcd-{VERSION}.tar.gz"));
    let mut archive = tool("git");
    archive.args(["archive", "HEAD", "--format=tar.gz"]);
    archive.arg(format!("--prefix=vpcd-{VERSION}/"));
    said(archive.arg("-o").arg(source))?;

    package(to)?;
    let mut wheel = tool("python3");
    wheel.args(["-m", "pip", "wheel", "--quiet", "--no-deps", "--wheel-dir"]);
    said(wheel.arg(to).arg("ipc/clients/python"))?;

    let changes = std::fs::read_to_string(root().join("CHANGELOG.md"))?;
    std::fs::write(to.join("notes.md"), notes(&changes)?)?;
    let sums = said(
        tool("sh")
            .current_dir(to)
            .args(["-c", "sha256sum vpc*.* *.md"]),
    )?;
    std::fs::write(to.join("SHA256SUMS"), &sums)?;
    print!("{sums}");
    Ok(())
}

/// As `controller/Cargo.toml` lists it, with pages of the manual and completions.
fn package(to: &Path) -> anyhow::Result<()> {
    for workspace in [".", "ipc/clients"] {
        let mut cargo = tool(env!("CARGO"));
        cargo.current_dir(root().join(workspace));
        said(cargo.args(["build", "--release", "--locked"]))?;
    }
    // Beside the directory of this program.
    let program = std::env::current_exe()?;
    let target = program.ancestors().nth(2);
    let release = target.context("no target directory")?.join("release");
    let share = release.join("share");
    said(tool(release.join("vpcctl")).arg("man").arg(&share))?;
    said(tool("sh").current_dir(&share).args(["-c", "gzip -9nf *.1"]))?;
    let mut deb = tool(env!("CARGO"));
    deb.args(["deb", "-p", "controller", "--no-build", "--locked"]);
    said(deb.args(["--dbgsym", "--output"]).arg(to))?;
    Ok(())
}

/// The newest section of the changelog, which must be of this version.
fn notes(changes: &str) -> anyhow::Result<&str> {
    let newest = changes.split("\n## ").nth(1).unwrap_or_default();
    let (title, text) = newest.split_once('\n').unwrap_or_default();
    ensure!(
        title.contains(VERSION),
        "CHANGELOG.md: the newest section is {title:?}; allowed: one that names {VERSION}"
    );
    Ok(text.trim_start())
}

/// A program, at the root of the repository.
pub fn tool(program: impl Into<PathBuf>) -> Command {
    let mut command = testkit::command(program.into());
    command.current_dir(root());
    command
}

/// Its standard output.
///
/// # Errors
/// The command, and standard error or how it ended.
pub fn said(command: &mut Command) -> anyhow::Result<String> {
    run(command).map_err(|error| anyhow::anyhow!("{command:?}: {error}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn notes_are_the_newest_section_and_only_of_this_version() {
        let of =
            |version: &str| format!("# Changelog\n\n## {version}\n\nNew.\n\n## 0.0.1\n\nOld.\n");
        assert_eq!(notes(&of(VERSION)).unwrap(), "New.\n");
        let error = notes(&of("9.9.9")).unwrap_err().to_string();
        assert!(
            error.contains("9.9.9") && error.contains(VERSION),
            "{error}"
        );
        assert!(notes("").is_err());
    }
}
