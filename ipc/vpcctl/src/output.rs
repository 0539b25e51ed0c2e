//! Writing to standard output: colours where a person reads, quiet where the reader left.

use std::io::{self, ErrorKind, IsTerminal, Write};

/// Writes text to standard output. A reader that left, as `head` does, is no failure.
///
/// # Errors
/// What the operating system says of any other failure.
pub fn write(text: &str) -> io::Result<()> {
    let mut output = io::stdout().lock();
    match output
        .write_all(text.as_bytes())
        .and_then(|()| output.flush())
    {
        Err(error) if error.kind() == ErrorKind::BrokenPipe => Ok(()),
        result => result,
    }
}

/// Whether colours may be used: standard output is a terminal, and NO_COLOR (if it is there at all) is empty.
pub fn colours() -> bool {
    io::stdout().is_terminal() && no_color_allows(std::env::var_os("NO_COLOR").as_deref())
}

/// The rule of no-color.org: any value but the empty one forbids.
fn no_color_allows(value: Option<&std::ffi::OsStr>) -> bool {
    value.is_none_or(|value| value.is_empty())
}

/// How a word is to be seen.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Tone {
    /// As it should be.
    Good,
    /// To be looked at.
    Warning,
    /// Wrong.
    Bad,
}

/// The text in the colour of the tone, where colours are wanted.
pub fn paint(text: &str, tone: Tone, colours: bool) -> String {
    let code = match tone {
        Tone::Good => 32,
        Tone::Warning => 33,
        Tone::Bad => 31,
    };
    match colours {
        true => format!("\x1b[{code}m{text}\x1b[0m"),
        false => text.to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_color_forbids_unless_it_is_empty() {
        assert!(no_color_allows(None));
        assert!(no_color_allows(Some("".as_ref())));
        assert!(!no_color_allows(Some("0".as_ref())));
    }

    #[test]
    fn text_without_colours_is_plain() {
        assert_eq!(paint("moving", Tone::Good, false), "moving");
        assert_eq!(paint("moving", Tone::Good, true), "\x1b[32mmoving\x1b[0m");
    }
}
