//! Whether a calibration is good enough, in words.

use std::fmt;

/// What is wrong with a result, and what to do; nothing if it is good.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Verdict {
    faults: Vec<String>,
}

impl Verdict {
    /// Adds what is wrong where `is_wrong`.
    pub(crate) fn refuse_if(&mut self, is_wrong: bool, words: impl FnOnce() -> String) {
        if is_wrong {
            self.faults.push(words());
        }
    }

    /// Whether the result can be used.
    pub fn is_good(&self) -> bool {
        self.faults.is_empty()
    }
}

impl fmt::Display for Verdict {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.is_good() {
            return write!(f, "good");
        }
        write!(f, "not good enough: {}", self.faults.join("; "))
    }
}
