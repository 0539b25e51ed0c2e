//! The file of findings, and the page that is written from it.

use std::fmt::Write as _;
use std::path::Path;

use serde::Serialize;

use crate::machine::{may_be_real_time, processors};
use crate::sheet::{Figure, Finding, Outcome};

/// Where it was measured.
#[derive(Clone, Debug, Serialize)]
pub struct Machine {
    processors: usize,
    kernel: String,
    /// The scheduling class that `vpcd` may have.
    class: &'static str,
}

impl Machine {
    /// This one.
    pub fn this() -> Self {
        let kernel = rustix::system::uname();
        let class = match may_be_real_time() {
            true => "SCHED_FIFO",
            false => "SCHED_OTHER",
        };
        Self {
            processors: processors().len(),
            kernel: kernel.release().to_string_lossy().into_owned(),
            class,
        }
    }
}

/// All findings of a run.
#[derive(Clone, Debug, Serialize)]
pub struct Page {
    commit: String,
    date: String,
    machine: Machine,
    is_long: bool,
    pub findings: Vec<Finding>,
}

impl Page {
    /// One without findings.
    pub fn new(machine: Machine, is_long: bool) -> Self {
        let mut git = testkit::command("git");
        git.args(["rev-parse", "HEAD"]).current_dir(testkit::root());
        let mut date = testkit::command("date");
        date.args(["-u", "+%Y-%m-%dT%H:%M:%SZ"]);
        Self {
            commit: said(git),
            date: said(date),
            machine,
            is_long,
            findings: Vec::new(),
        }
    }

    /// How many findings are so.
    pub fn count(&self, is_so: impl Fn(&Outcome) -> bool) -> usize {
        let outcomes = self.findings.iter().map(|finding| &finding.outcome);
        outcomes.filter(|outcome| is_so(outcome)).count()
    }

    /// The counts in a line.
    pub fn summary(&self) -> String {
        let kept = self.count(|outcome| *outcome == Outcome::Kept);
        let broken = self.count(Outcome::is_broken);
        let rest = self.findings.len() - kept - broken;
        format!("{kept} kept, {broken} broken, {rest} not shown")
    }

    /// Writes the file, and beside it the page.
    pub fn write(&self, file: &Path) -> std::io::Result<()> {
        if let Some(directory) = file.parent() {
            std::fs::create_dir_all(directory)?;
        }
        let text = serde_json::to_string_pretty(self).map_err(std::io::Error::from)?;
        std::fs::write(file, text + "\n")?;
        std::fs::write(file.with_extension("md"), self.text())
    }

    fn text(&self) -> String {
        let Machine {
            processors,
            kernel,
            class,
        } = &self.machine;
        let length = if self.is_long { ", full length" } else { "" };
        let mut text = format!(
            "# Measured\n\n{}{length}. Commit {}, {}; {processors} processors, Linux {kernel}, {class}.\n\n| name | finding | figures | s |\n|---|---|---|--:|\n",
            self.summary(),
            self.commit,
            self.date,
        );
        for finding in &self.findings {
            let figures: Vec<_> = finding.figures.iter().map(Figure::to_string).collect();
            let reason = finding.outcome.reason();
            let colon = if reason.is_empty() { "" } else { ": " };
            let cell = |words: &str| words.replace('|', "/").replace('\n', " ");
            let _ = writeln!(
                text,
                "| {} | {}{colon}{} | {} | {:.0} |",
                finding.name,
                finding.outcome.word(),
                cell(reason),
                cell(&figures.join(", ")),
                finding.seconds,
            );
        }
        text
    }
}

/// What a command printed, or `unknown`.
fn said(mut command: std::process::Command) -> String {
    let output = command
        .output()
        .ok()
        .filter(|output| output.status.success());
    output.map_or_else(
        || "unknown".to_owned(),
        |output| String::from_utf8_lossy(&output.stdout).trim().to_owned(),
    )
}
