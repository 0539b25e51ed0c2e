//! What `cargo table --json` writes: rows, and every run.

use std::fmt::Display;

use serde::Serialize;

/// The document.
#[derive(Clone, Debug, Serialize)]
pub struct Document<'a, Row, Run> {
    /// The command line.
    pub command: String,
    /// What stands above the table: scene, starts, and the camera's flaws.
    pub title: &'a str,
    /// Rows of these runs.
    pub rows: &'a [Row],
    /// Runs, strategy by strategy, in the order of the starts.
    pub runs: Vec<Record<Run>>,
}

/// One run in the document.
#[derive(Clone, Debug, Serialize)]
pub struct Record<Run> {
    /// Index of its start among all starts.
    pub start: usize,
    /// Strategy and window, or an external method.
    pub strategy: String,
    /// What happened.
    #[serde(flatten)]
    pub run: Run,
}

/// The runs of each strategy as they stand in a document; the first is from start `first`.
pub fn records<Run>(all: &[(impl Display, Vec<Run>)], first: usize) -> Vec<Record<&Run>> {
    let each = all.iter().flat_map(|(name, runs)| {
        (first..).zip(runs).map(move |(start, run)| Record {
            start,
            strategy: name.to_string(),
            run,
        })
    });
    each.collect()
}
