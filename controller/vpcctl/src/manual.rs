//! Shell completions and man pages, made from the description of the command line.

use std::io;
use std::path::{Path, PathBuf};

use clap::CommandFactory;
use clap_complete::Shell;

use crate::arguments::Arguments;
use crate::failure::Failure;

/// The completions for a shell.
pub fn completions(shell: Shell) -> Vec<u8> {
    let mut script = Vec::new();
    clap_complete::generate(shell, &mut Arguments::command(), "vpcctl", &mut script);
    script
}

/// Writes what a package ships into a directory, which is created: man pages, and the completions
/// for bash, zsh and fish under the names that these look for. Returns the names of the files.
///
/// # Errors
/// [`Failure`] names the directory that cannot be written to.
pub fn write(directory: &Path) -> Result<Vec<String>, Failure> {
    let files = files(directory).map_err(Failure::write(directory))?;
    let names = files.iter().filter_map(|path| path.file_name());
    Ok(names.map(|name| name.display().to_string()).collect())
}

/// The files: `vpcctl.1`, a page for each command, and the completions.
fn files(directory: &Path) -> io::Result<Vec<PathBuf>> {
    std::fs::create_dir_all(directory)?;
    let mut command = Arguments::command().disable_help_subcommand(true);
    // Hands the options that all commands share down to them.
    command.build();
    let mut files = Vec::new();
    for page in std::iter::once(&command).chain(command.get_subcommands()) {
        files.push(clap_mangen::Man::new(page.clone()).generate_to(directory)?);
    }
    for shell in [Shell::Bash, Shell::Zsh, Shell::Fish] {
        let command = &mut Arguments::command();
        files.push(clap_complete::generate_to(
            shell, command, "vpcctl", directory,
        )?);
    }
    Ok(files)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_command_has_a_man_page_and_completions() {
        let directory = tempfile::tempdir().unwrap();
        let names = write(&directory.path().join("man1")).unwrap();
        for name in [
            "vpcctl.1",
            "vpcctl-status.1",
            "vpcctl-strategy.1",
            "vpcctl-doctor.1",
            "vpcctl.bash",
            "_vpcctl",
            "vpcctl.fish",
        ] {
            assert!(names.contains(&name.to_owned()), "{names:?}");
        }
        let page =
            std::fs::read_to_string(directory.path().join("man1/vpcctl-strategy.1")).unwrap();
        for words in ["timeout", "domain", "knn64"] {
            assert!(page.contains(words), "{words} is missing:\n{page}");
        }
    }

    #[test]
    fn completions_know_commands_and_options() {
        for shell in [Shell::Bash, Shell::Zsh, Shell::Fish] {
            let script = String::from_utf8(completions(shell)).unwrap();
            assert!(
                script.contains("strategy") && script.contains("timeout"),
                "{shell}"
            );
        }
    }
}
