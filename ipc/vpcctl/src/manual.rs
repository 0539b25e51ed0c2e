//! Shell completions and man pages, made from the description of the command line.

use std::path::Path;

use clap::{Command, CommandFactory};
use clap_complete::Shell;

use crate::arguments::Arguments;
use crate::exit::Failure;

/// The completions for a shell.
pub fn completions(shell: Shell) -> String {
    let mut script = Vec::new();
    clap_complete::generate(shell, &mut Arguments::command(), "vpcctl", &mut script);
    String::from_utf8_lossy(&script).into_owned()
}

/// Writes the man pages, `vpcctl.1` and one for each command, into a directory, which is created; tells their names.
///
/// # Errors
/// [`Failure::Write`] names the file.
pub fn write(directory: &Path) -> Result<Vec<String>, Failure> {
    let trouble = |path: &Path| {
        let path = path.display().to_string();
        move |source| Failure::Write { path, source }
    };
    std::fs::create_dir_all(directory).map_err(trouble(directory))?;
    let mut command = Arguments::command();
    // Hands the options that all commands share down to them.
    command.build();
    let mut names = Vec::new();
    for page in pages(&command) {
        // Subcommands are displayed under their full names, `vpcctl-status`.
        let name = format!("{}.1", page.get_display_name().unwrap_or("vpcctl"));
        let path = directory.join(&name);
        let mut text = Vec::new();
        clap_mangen::Man::new(page)
            .render(&mut text)
            .map_err(trouble(&path))?;
        std::fs::write(&path, text).map_err(trouble(&path))?;
        names.push(name);
    }
    Ok(names)
}

/// The command itself and its subcommands.
fn pages(command: &Command) -> impl Iterator<Item = Command> {
    let subcommands = command
        .get_subcommands()
        .filter(|sub| sub.get_name() != "help");
    std::iter::once(command).chain(subcommands).map(|command| {
        // Its own subcommand `help` has no page to be referred to.
        command.clone().disable_help_subcommand(true)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_command_has_a_page_with_its_options() {
        let directory = tempfile::tempdir().unwrap();
        let names = write(&directory.path().join("man1")).unwrap();
        for name in [
            "vpcctl.1",
            "vpcctl-status.1",
            "vpcctl-strategy.1",
            "vpcctl-doctor.1",
        ] {
            assert!(names.contains(&name.to_owned()), "{names:?}");
        }
        let page =
            std::fs::read_to_string(directory.path().join("man1/vpcctl-strategy.1")).unwrap();
        for words in ["neighbours", "domain", "knn64"] {
            assert!(page.contains(words), "{words} is missing:\n{page}");
        }
    }

    #[test]
    fn the_package_ships_what_the_command_line_says() {
        let share = Path::new(env!("CARGO_MANIFEST_DIR")).join("share");
        let again = "renew it: bash ipc/vpcctl/share/renew.sh";
        let directory = tempfile::tempdir().unwrap();
        for name in write(directory.path()).unwrap() {
            let shipped = std::fs::read_to_string(share.join(&name)).unwrap_or_default();
            let made = std::fs::read_to_string(directory.path().join(&name)).unwrap();
            assert!(
                shipped == made,
                "share/{name} is of another command line; {again}"
            );
        }
        for (shell, name) in [
            (Shell::Bash, "vpcctl.bash"),
            (Shell::Zsh, "_vpcctl"),
            (Shell::Fish, "vpcctl.fish"),
        ] {
            let shipped = std::fs::read_to_string(share.join(name)).unwrap_or_default();
            assert!(
                shipped == completions(shell),
                "share/{name} is of another command line; {again}"
            );
        }
    }

    #[test]
    fn completions_know_commands_and_options() {
        for shell in [Shell::Bash, Shell::Zsh, Shell::Fish] {
            let script = completions(shell);
            assert!(
                script.contains("strategy") && script.contains("timeout"),
                "{shell}"
            );
        }
    }
}
