//! `vpcctl doctor`: what is wrong with this machine or set-up, and how to mend it.

mod daemon;
mod domain;
mod files;
mod machine;

use std::path::PathBuf;
use std::time::Duration;

use crate::exit::Exit;
use crate::output::{Tone, paint};

/// How it is with one thing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// As it should be.
    Ok,
    /// Works, but look at it.
    Warn,
    /// Must be mended.
    Fail,
}

/// One thing that was looked at.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Finding {
    /// What was looked at, one or two words.
    pub what: &'static str,
    /// How it is.
    pub verdict: Verdict,
    /// What was found.
    pub found: String,
    /// How to mend it; empty where nothing is to be.
    pub remedy: String,
}

impl Finding {
    fn ok(what: &'static str, found: impl Into<String>) -> Self {
        Self::new(what, Verdict::Ok, found, "")
    }

    fn warn(what: &'static str, found: impl Into<String>, remedy: impl Into<String>) -> Self {
        Self::new(what, Verdict::Warn, found, remedy)
    }

    fn fail(what: &'static str, found: impl Into<String>, remedy: impl Into<String>) -> Self {
        Self::new(what, Verdict::Fail, found, remedy)
    }

    fn new(
        what: &'static str,
        verdict: Verdict,
        found: impl Into<String>,
        remedy: impl Into<String>,
    ) -> Self {
        Self {
            what,
            verdict,
            found: found.into(),
            remedy: remedy.into(),
        }
    }
}

/// What to look at.
#[derive(Clone, Debug)]
pub struct Patient {
    /// The domain's directory.
    pub directory: PathBuf,
    /// A scene file.
    pub scene: Option<PathBuf>,
    /// A memory of motion.
    pub memory: Option<PathBuf>,
    /// How long to watch a running daemon.
    pub watch: Duration,
}

/// Looks at everything. A domain that is not there is not created.
pub fn examine(patient: &Patient) -> Vec<Finding> {
    let mut findings = domain::examine(&patient.directory);
    findings.extend(daemon::examine(&patient.directory, patient.watch));
    findings.extend(files::examine(
        patient.scene.as_deref(),
        patient.memory.as_deref(),
    ));
    findings.extend(machine::examine());
    findings
}

/// The findings as text, a line each and another one for a remedy, and the exit code.
pub fn report(findings: &[Finding], colours: bool) -> (String, Exit) {
    let mut text = String::new();
    for finding in findings {
        let (word, tone) = match finding.verdict {
            Verdict::Ok => ("ok  ", Tone::Good),
            Verdict::Warn => ("warn", Tone::Warning),
            Verdict::Fail => ("FAIL", Tone::Bad),
        };
        let word = paint(word, tone, colours);
        text += &format!("{word}  {:<12}{}\n", finding.what, finding.found);
        if !finding.remedy.is_empty() {
            text += &format!("                  -> {}\n", finding.remedy);
        }
    }
    match findings
        .iter()
        .any(|finding| finding.verdict == Verdict::Fail)
    {
        true => (text, Exit::Attention),
        false => (text, Exit::Ok),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_warning_does_not_fail_and_a_failure_does() {
        let warning = Finding::warn("clock", "hpet", "use tsc");
        let (text, exit) = report(std::slice::from_ref(&warning), false);
        assert_eq!(
            text,
            "warn  clock       hpet\n                  -> use tsc\n"
        );
        assert_eq!(exit, Exit::Ok);
        let failure = Finding::fail("domain", "gone", "mkdir");
        assert_eq!(report(&[warning, failure], false).1, Exit::Attention);
    }
}
