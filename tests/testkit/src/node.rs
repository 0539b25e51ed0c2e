//! Packages of npm for tests in Node.js, installed at the first use.

use std::path::{Path, PathBuf};
use std::process::Command;

use crate::python::run;
use crate::{are_installed, locked, not_run, root, target_directory};

/// A script, ready to run with the packages that the `package.json` beside it names; its path is
/// from the root of the repository. `None`, after [`not_run`], where the machine has no Node.js or
/// no network.
pub fn script(test: &str, script: &str) -> Option<Command> {
    if !are_installed(test, &["node=nodejs", "npm"]) {
        return None;
    }
    match installed(&root().join(script)) {
        Ok(script) => {
            let mut command = crate::command("node");
            command.arg(script);
            Some(command)
        }
        Err(reason) => {
            not_run(test, format_args!("npm: {reason}"));
            None
        }
    }
}

/// A copy of the script beside its packages, in the target directory.
fn installed(script: &Path) -> Result<PathBuf, String> {
    let text = |path: &Path| {
        let text = std::fs::read_to_string(path);
        text.map_err(|error| format!("{}: {error}", path.display()))
    };
    let written = |path: &Path, text: &str| {
        let done = std::fs::write(path, text);
        done.map_err(|error| format!("{}: {error}", path.display()))
    };
    let folder = script
        .parent()
        .and_then(Path::file_name)
        .unwrap_or_default();
    let directory = target_directory().join("tmp").join("node").join(folder);
    let _turn = locked(&directory)?;
    let wanted = text(&script.with_file_name("package.json"))?;
    // Written at the end: without it, or with other contents, the packages are installed again.
    let note = directory.join("wanted.json");
    if text(&note).ok().as_ref() != Some(&wanted) {
        written(&directory.join("package.json"), &wanted)?;
        let mut npm = crate::command("npm");
        npm.args(["install", "--no-audit", "--no-fund", "--ignore-scripts"]);
        npm.args(["--prefer-offline", "--fetch-retries", "1", "--prefix"])
            .arg(&directory);
        run(&mut npm)?;
        written(&note, &wanted)?;
    }
    let copy = directory.join(script.file_name().unwrap_or_default());
    written(&copy, &text(script)?)?;
    Ok(copy)
}
