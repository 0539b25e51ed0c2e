//! Writing to standard output: colours on a terminal, no error if the reader has closed it.

use std::io::{self, ErrorKind, IsTerminal, Write};

use messages::{Hold, TwistState};
use program::Exit;

use crate::failure::Failure;

/// Writes text to standard output. A reader that left, as `head` does, is no failure.
///
/// # Errors
/// [`Exit::Software`] with the operating system's reason.
pub fn write(text: &str) -> Result<(), Failure> {
    let mut output = io::stdout().lock();
    match output
        .write_all(text.as_bytes())
        .and_then(|()| output.flush())
    {
        Err(error) if error.kind() != ErrorKind::BrokenPipe => {
            let message = format!("cannot write the output: {error}");
            Err(Failure::new(Exit::Software, message))
        }
        _ => Ok(()),
    }
}

/// Whether colours may be used: standard output is a terminal, and NO_COLOR is empty or not set.
pub fn colours() -> bool {
    io::stdout().is_terminal() && no_color_allows(std::env::var_os("NO_COLOR").as_deref())
}

/// The rule of no-color.org: any value but the empty one forbids.
fn no_color_allows(value: Option<&std::ffi::OsStr>) -> bool {
    value.is_none_or(|value| value.is_empty())
}

/// How a word is shown.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Tone {
    /// As it should be.
    Good,
    /// Worth a look.
    Warning,
    /// Wrong.
    Bad,
}

impl Tone {
    /// The tone of a state with its cause. A camera that stays away, at the end of a run for
    /// instance, is worth a look; so is what an operator asked for.
    pub fn of(state: TwistState, hold: Option<Hold>) -> Self {
        match (state, hold) {
            (TwistState::Moving | TwistState::Arrived, _) => Self::Good,
            (TwistState::Braking | TwistState::Disarmed, _) => Self::Warning,
            (_, None | Some(Hold::NoFeatures | Hold::Stale | Hold::Lost)) => Self::Warning,
            (TwistState::Holding | TwistState::Stopped, _) => Self::Bad,
        }
    }

    /// `good`, `warning` or `bad`: a class of the page.
    pub fn name(self) -> &'static str {
        match self {
            Self::Good => "good",
            Self::Warning => "warning",
            Self::Bad => "bad",
        }
    }
}

/// The text in the colour of the tone, if colours are on.
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

    #[test]
    fn a_camera_that_ended_is_no_error_and_a_wrong_message_is() {
        for hold in [Hold::NoFeatures, Hold::Stale] {
            assert_eq!(Tone::of(TwistState::Holding, Some(hold)), Tone::Warning);
        }
        assert_eq!(
            Tone::of(TwistState::Disarmed, Some(Hold::Lost)),
            Tone::Warning
        );
        assert_eq!(
            Tone::of(TwistState::Holding, Some(Hold::Invalid)),
            Tone::Bad
        );
    }
}
