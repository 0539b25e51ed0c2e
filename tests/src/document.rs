//! What `cargo table --json` writes: rows, every run, and what they belong to; of all starts or of a
//! part of them, and parts merged.

use std::collections::BTreeMap;
use std::fs;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use anyhow::{Context, bail, ensure};
use memory_blob::hex;
use scene::{Pose, Share};
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use crate::column;
use crate::row::{self, Row};
use crate::run::Run;
use crate::spec::Spec;

/// The program and its version.
const TABLE: &str = concat!("table ", env!("CARGO_PKG_VERSION"));
/// What runs belong to: parts of the same table have the same.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Origin {
    /// Program and version.
    pub version: String,
    /// SHA-256 of the scene file and its masks.
    pub scene: String,
    /// SHA-256 of the memory.
    pub memory: Option<String>,
    /// SHA-256 of all starts.
    pub starts_digest: String,
    /// Number of all starts.
    pub starts: usize,
    /// Flags with their values, given or by default; not those that name files.
    pub settings: BTreeMap<String, Vec<String>>,
}

impl Origin {
    /// The origin of runs from some of these starts.
    pub fn new(
        scene: String,
        memory: Option<&[u8; 32]>,
        starts: &[Pose],
        settings: BTreeMap<String, Vec<String>>,
    ) -> Self {
        Self {
            version: TABLE.to_owned(),
            scene,
            memory: memory.map(|digest| hex(digest)),
            starts_digest: hex(&Sha256::digest(scene::starts_csv(starts))),
            starts: starts.len(),
            settings,
        }
    }

    /// What differs from another origin: its name, and both values.
    fn difference(&self, other: &Self) -> Option<(String, String, String)> {
        let memory = |of: &Self| of.memory.clone().unwrap_or_else(|| "none".to_owned());
        let starts = |of: &Self| format!("{} with checksum {}", of.starts, of.starts_digest);
        let pairs = [
            ("version", self.version.clone(), other.version.clone()),
            (
                "checksum of the scene",
                self.scene.clone(),
                other.scene.clone(),
            ),
            ("checksum of the memory", memory(self), memory(other)),
            ("starts", starts(self), starts(other)),
        ];
        let fixed = pairs.map(|(name, found, expected)| (name.to_owned(), found, expected));
        let keys = other.settings.keys().chain(self.settings.keys());
        let flags = keys.map(|key| {
            let value = |of: &Self| {
                of.settings
                    .get(key)
                    .map_or("none".to_owned(), |v| v.join(","))
            };
            (
                format!("--{}", key.replace('_', "-")),
                value(self),
                value(other),
            )
        });
        let mut all = fixed.into_iter().chain(flags);
        all.find(|(_, found, expected)| found != expected)
    }
}

/// The document.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Document<Row, Run> {
    /// The command line.
    pub command: String,
    /// What stands above the table: scene, starts, and the camera's flaws.
    pub title: String,
    /// What the runs belong to.
    pub origin: Origin,
    /// Which part of the starts.
    pub part: Share,
    /// Rows of these runs.
    #[serde(skip_deserializing, default = "Vec::new")]
    pub rows: Vec<Row>,
    /// Runs, strategy by strategy, in the order of the starts.
    pub runs: Vec<Record<Run>>,
}

/// One run in the document.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Record<Run> {
    /// Index of its start among all starts.
    pub start: usize,
    /// Strategy and window.
    pub strategy: String,
    /// What happened.
    #[serde(flatten)]
    pub run: Run,
}

/// The runs of each strategy as they stand in a document; the first is from start `first`.
pub fn records<Run>(all: &[(Spec, Vec<Run>)], first: usize) -> Vec<Record<&Run>> {
    let each = all.iter().flat_map(|(spec, runs)| {
        (first..).zip(runs).map(move |(start, run)| Record {
            start,
            strategy: spec.to_string(),
            run,
        })
    });
    each.collect()
}

/// The runs of each strategy from all starts, in their order.
pub type Table = Vec<(Spec, Vec<Run>)>;

/// Merges the parts of a table, in whatever order their files are given. Rows are made anew from all
/// runs, so that they are those of one table; the times of cycles are those that the parts measured.
///
/// # Errors
/// Names the file that does not belong, or is there twice, what differs and what is expected; the
/// parts that are missing.
pub fn merge(paths: &[PathBuf]) -> anyhow::Result<(Document<Row, Run>, Table)> {
    let mut parts: Vec<(&Path, Document<Row, Run>)> = Vec::new();
    for path in paths {
        let document = read(path)?;
        if let Some((_, first)) = parts.first()
            && let Some((key, found, expected)) = document.origin.difference(&first.origin)
        {
            bail!("{}: {key} is {found}; expected: {expected}", path.display());
        }
        parts.push((path, document));
    }
    Share::check_whole(parts.iter().map(|(path, document)| (*path, document.part)))?;
    parts.sort_by_key(|(_, document)| document.part.index());
    join(parts)
}

/// Joins parts that are all there, in their order.
fn join(parts: Vec<(&Path, Document<Row, Run>)>) -> anyhow::Result<(Document<Row, Run>, Table)> {
    let Some(mut whole) = parts.first().map(|(_, first)| Document {
        part: Share::default(),
        rows: Vec::new(),
        runs: Vec::new(),
        ..first.clone()
    }) else {
        bail!("no parts; expected: at least one");
    };
    let strategies = whole.origin.settings.get("strategies");
    let strategies: Vec<Spec> = strategies
        .into_iter()
        .flatten()
        .map(|spec| spec.parse().map_err(anyhow::Error::msg))
        .collect::<Result<_, _>>()?;
    let mut all: Table = strategies.iter().map(|&spec| (spec, Vec::new())).collect();
    for (path, document) in parts {
        let starts = document.part.range(document.origin.starts);
        let mut runs = document.runs.into_iter();
        for (spec, into) in &mut all {
            for start in starts.clone() {
                let run = runs.next();
                let (path, found) = (path.display(), run.as_ref());
                let found =
                    found.map_or("none".to_owned(), |r| format!("{} {}", r.strategy, r.start));
                let expected = format!("{spec} {start}");
                ensure!(
                    found == expected,
                    "{path}: a run is {found}; expected: {expected}"
                );
                into.extend(run.map(|record| record.run));
            }
        }
        let more = runs.len();
        ensure!(
            more == 0,
            "{}: {more} runs too many; expected: 0",
            path.display()
        );
    }
    whole.rows = all
        .iter()
        .map(|(spec, runs)| Row::of(*spec, runs))
        .collect();
    Ok((whole, all))
}

/// Whether the file at `path` is this part of the same table.
///
/// # Errors
/// Names the file, what differs and what is expected, if it is anything else.
pub fn is_there(path: &Path, origin: &Origin, part: Share) -> anyhow::Result<bool> {
    if !path.exists() {
        return Ok(false);
    }
    let there = read(path)?;
    let parts = ("part".to_owned(), there.part.to_string(), part.to_string());
    let other_part = (there.part != part).then_some(parts);
    match there.origin.difference(origin).or(other_part) {
        None => Ok(true),
        Some((key, found, expected)) => bail!(
            "{}: {key} is {found}; expected: {expected}, or no file",
            path.display()
        ),
    }
}

fn read(path: &Path) -> anyhow::Result<Document<Row, Run>> {
    let name = path.display();
    let bytes = fs::read(path).with_context(|| format!("{name}: cannot read"))?;
    let any: serde_json::Value =
        serde_json::from_slice(&bytes).with_context(|| format!("{name}: damaged"))?;
    let version = any["origin"]["version"].as_str().unwrap_or("none");
    ensure!(
        version == TABLE,
        "{name}: version is {version}; expected: {TABLE}"
    );
    let robot = &any["origin"]["settings"]["robot"][0];
    ensure!(
        robot == "free",
        "{name}: --robot is {robot}; expected: free"
    );
    drop(any);
    serde_json::from_slice(&bytes)
        .with_context(|| format!("{name}: not what `cargo table --json` writes"))
}

impl<Row: Serialize, Run: Serialize> Document<Row, Run> {
    /// Writes a part of a table, unless another process has written it since.
    ///
    /// # Errors
    /// Names the file if it cannot be written, or is something else, which stays.
    pub fn write_part(&self, path: &Path) -> anyhow::Result<()> {
        match memory_blob::create(path, &serde_json::to_vec(self)?) {
            Err(error) if error.kind() == ErrorKind::AlreadyExists => {
                is_there(path, &self.origin, self.part).map(|_| ())
            }
            written => written.with_context(|| format!("{}: cannot write", path.display())),
        }
    }
}

impl<Run> Document<Row, Run> {
    /// Title and rows as they are printed.
    pub fn text(&self, is_wide: bool) -> String {
        let rows = column::markdown(&row::COLUMNS, &self.rows, is_wide);
        format!("{}\n\n{rows}", self.title)
    }
}
