//! Shell completions and man pages, made from the description of the command line.

use std::path::Path;

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
/// [`Failure`] names the file that cannot be written.
pub fn write(directory: &Path) -> Result<Vec<String>, Failure> {
    let mut files = pages()?;
    for (shell, name) in [
        (Shell::Bash, "vpcctl.bash"),
        (Shell::Zsh, "_vpcctl"),
        (Shell::Fish, "vpcctl.fish"),
    ] {
        files.push((name.to_owned(), completions(shell)));
    }
    std::fs::create_dir_all(directory).map_err(Failure::write(directory))?;
    for (name, text) in &files {
        let path = directory.join(name);
        std::fs::write(&path, text).map_err(Failure::write(&path))?;
    }
    Ok(files.into_iter().map(|(name, _)| name).collect())
}

/// The man pages with their names: `vpcctl.1`, and one for each command.
fn pages() -> Result<Vec<(String, Vec<u8>)>, Failure> {
    let mut command = Arguments::command();
    // Hands the options that all commands share down to them.
    command.build();
    let subcommands = command
        .get_subcommands()
        .filter(|sub| sub.get_name() != "help");
    let mut pages = Vec::new();
    for page in std::iter::once(&command).chain(subcommands) {
        // Its own subcommand `help` has no page to be referred to.
        let page = page.clone().disable_help_subcommand(true);
        // Subcommands are displayed under their full names, `vpcctl-status`.
        let name = format!("{}.1", page.get_display_name().unwrap_or("vpcctl"));
        let mut text = Vec::new();
        clap_mangen::Man::new(page).render(&mut text)?;
        pages.push((name, text));
    }
    Ok(pages)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_command_has_a_page_with_its_options_and_every_shell_its_completions() {
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
