//! The file of a build's state: what an interrupted build, or a part of one, leaves.
//!
//! A line `vpc-memory-state 1 SHA256`, the digest being that of all that follows; a line with the
//! [`Header`] in JSON; then scene, masks and progress in Postcard. The same state gives the same
//! bytes.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, BufRead, BufReader, Read};
use std::path::Path;

use memory_blob::{create, hex, replace};
use scene::{SceneFiles, Share};
use serde::{Deserialize, Serialize};
use serde_json::Value;
use sha2::{Digest, Sha256};
use toml_schema::FileError;

use crate::build::Progress;
use crate::settings::BuildSettings;

/// Begin of the first line, before the digest.
const MAGIC: &str = "vpc-memory-state 1 ";
/// Most bytes of the first two lines.
const MAX_LINES: u64 = 1 << 20;
/// The program and its version, as in the provenance of a memory.
pub(crate) const TOOL: &str = concat!("vpc-memory ", env!("CARGO_PKG_VERSION"));

/// What a state belongs to, and how far it is.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Header {
    /// Program and version.
    pub tool: String,
    /// SHA-256 of the scene file and its masks, 64 hexadecimal digits.
    pub scene: String,
    /// Which part it is.
    pub part: Share,
    /// Successful trajectories that the part has to collect.
    pub wanted: usize,
    /// Those that it has.
    pub found: usize,
    /// Batches done.
    pub batches: u64,
    /// How the memory is built; the trajectories are those of all parts.
    pub settings: BuildSettings,
}

/// The state of a build.
#[derive(Clone, Debug)]
pub struct BuildState {
    /// What it belongs to.
    pub header: Header,
    /// The scene.
    pub scene: SceneFiles,
    /// What has been collected.
    pub progress: Progress,
}

/// What follows the header.
#[derive(Serialize, Deserialize)]
struct Body<Text, Masks, Collected> {
    path: Text,
    scene: Text,
    masks: Masks,
    progress: Collected,
}

/// Why the state of a build is refused.
#[derive(Debug, thiserror::Error)]
pub enum StateError {
    /// The file cannot be read or written.
    #[error("{path}: {source}")]
    Io {
        /// The file.
        path: String,
        /// The operating system's reason.
        source: io::Error,
    },
    /// The file is none, or is damaged.
    #[error("{path}: {what}; remove it to begin anew")]
    Damaged {
        /// The file.
        path: String,
        /// What was found and expected.
        what: String,
    },
    /// The file belongs to something else.
    #[error("{path}: {key} is {found}; expected: {expected}")]
    Foreign {
        /// The file.
        path: String,
        /// What differs.
        key: String,
        /// In this file.
        found: String,
        /// In what it has to belong to.
        expected: String,
    },
    /// The scene in the file does not parse.
    #[error(transparent)]
    Scene(#[from] FileError),
}

impl Header {
    /// The header of a part that nothing was done of.
    pub fn new(scene: &SceneFiles, settings: &BuildSettings, part: Share) -> Self {
        Self {
            tool: TOOL.to_owned(),
            scene: scene.digest(),
            part,
            wanted: part.range(settings.trajectories).len(),
            found: 0,
            batches: 0,
            settings: settings.clone(),
        }
    }

    /// Reads the header of a file alone. The digest is not compared: [`BuildState::read`] does.
    ///
    /// # Errors
    /// [`StateError`] if the file is none, or of another version.
    pub fn read(path: &Path) -> Result<Self, StateError> {
        let file = File::open(path).map_err(|source| unreadable(path, source))?;
        Ok(lines(path, &mut BufReader::new(file))?.1)
    }

    /// Whether all trajectories of the part are there.
    pub fn is_complete(&self) -> bool {
        self.found >= self.wanted
    }

    /// Checks that this header, of the file at `path`, is of the same build as `other`; the parts
    /// may differ.
    ///
    /// # Errors
    /// [`StateError::Foreign`] names what differs.
    pub fn belongs_to(&self, other: &Self, path: &Path) -> Result<(), StateError> {
        let pairs = [
            ("version", self.tool.clone(), other.tool.clone()),
            (
                "checksum of the scene",
                self.scene.clone(),
                other.scene.clone(),
            ),
        ];
        let [ours, theirs] = [self, other].map(|header| flat(&header.settings));
        let keys = theirs.keys().chain(ours.keys());
        let settings = keys.map(|key| {
            let value = |of: &BTreeMap<String, String>| of.get(key).cloned().unwrap_or_default();
            (key.as_str(), value(&ours), value(&theirs))
        });
        let mut all = pairs.into_iter().chain(settings);
        match all.find(|(_, found, expected)| found != expected) {
            None => Ok(()),
            Some((key, found, expected)) => Err(StateError::Foreign {
                path: path.display().to_string(),
                key: key.to_owned(),
                found,
                expected,
            }),
        }
    }

    /// Checks that this header, of the file at `path`, is of the same part of the same build as
    /// `other`.
    fn is_same_part(&self, other: &Self, path: &Path) -> Result<(), StateError> {
        self.belongs_to(other, path)?;
        if self.part == other.part {
            return Ok(());
        }
        Err(StateError::Foreign {
            path: path.display().to_string(),
            key: "part".to_owned(),
            found: self.part.to_string(),
            expected: other.part.to_string(),
        })
    }
}

impl BuildState {
    /// Reads a file and verifies its digest.
    ///
    /// # Errors
    /// [`StateError`] if the file is none, is damaged, or of another version.
    pub fn read(path: &Path) -> Result<Self, StateError> {
        let file = File::open(path).map_err(|source| unreadable(path, source))?;
        let mut reader = BufReader::new(file);
        let (expected, header, line) = lines(path, &mut reader)?;
        let mut body = Vec::new();
        let read = reader.read_to_end(&mut body);
        read.map_err(|source| unreadable(path, source))?;
        let found = hex(&Sha256::new()
            .chain_update(&line)
            .chain_update(&body)
            .finalize());
        if found != expected {
            let what = format!("damaged: its SHA-256 is {found}; expected: {expected}");
            return Err(damaged(path, what));
        }
        let body: Body<String, BTreeMap<String, Vec<u8>>, Progress> =
            postcard::from_bytes(&body).map_err(|error| damaged(path, error.to_string()))?;
        let missing = |name: &str| io::Error::new(io::ErrorKind::NotFound, name.to_owned());
        let mask = |name: &str| body.masks.get(name).cloned().ok_or_else(|| missing(name));
        let scene = SceneFiles::parse(body.scene, &body.path, &mask)?;
        for (index, trajectory) in body.progress.trajectories.iter().enumerate() {
            let checked = trajectory.check(&scene.scene);
            checked.map_err(|what| damaged(path, format!("trajectory {index}: {what}")))?;
        }
        Ok(Self {
            header,
            scene,
            progress: body.progress,
        })
    }

    /// Goes on from the file at `path`, if there is one; else from nothing.
    ///
    /// # Errors
    /// [`StateError`] if the file is damaged or belongs to something else.
    pub fn resume(
        path: &Path,
        scene: SceneFiles,
        settings: &BuildSettings,
        part: Share,
    ) -> Result<Self, StateError> {
        let header = Header::new(&scene, settings, part);
        if !path.exists() {
            return Ok(Self {
                header,
                scene,
                progress: Progress::default(),
            });
        }
        let state = Self::read(path)?;
        state.header.is_same_part(&header, path)?;
        Ok(state)
    }

    /// Replaces the file at `path` by this state with new progress, atomically. It keeps a file of
    /// the same part that is complete, or has more batches: another process works on the part, too.
    ///
    /// # Errors
    /// [`StateError`] if the file cannot be written, or if another build has written it since: that
    /// file stays.
    pub fn save(&mut self, path: &Path, progress: &Progress) -> Result<(), StateError> {
        (self.header.found, self.header.batches) = (progress.trajectories.len(), progress.batches);
        let failed = |source| unreadable(path, source);
        let bytes = self.bytes(progress).map_err(failed)?;
        if !path.exists() {
            match create(path, &bytes) {
                // Another process was faster.
                Err(error) if error.kind() == io::ErrorKind::AlreadyExists => (),
                created => return created.map_err(failed),
            }
        }
        let there = Header::read(path)?;
        there.is_same_part(&self.header, path)?;
        let is_kept = match (there.is_complete(), self.header.is_complete()) {
            (false, false) => there.batches > self.header.batches,
            (is_complete, _) => is_complete,
        };
        if is_kept {
            return Ok(());
        }
        replace(path, &bytes).map_err(failed)
    }

    fn bytes(&self, progress: &Progress) -> io::Result<Vec<u8>> {
        let body = Body {
            path: &self.scene.path,
            scene: &self.scene.text,
            masks: &self.scene.masks,
            progress,
        };
        let mut rest = serde_json::to_vec(&self.header)?;
        rest.push(b'\n');
        let rest = postcard::to_extend(&body, rest).map_err(io::Error::other)?;
        let digest = hex(&Sha256::digest(&rest));
        let mut bytes = format!("{MAGIC}{digest}\n").into_bytes();
        bytes.extend(rest);
        Ok(bytes)
    }
}

/// The digest, the header, and the line that it stands in.
fn lines(path: &Path, reader: &mut impl BufRead) -> Result<(String, Header, Vec<u8>), StateError> {
    let mut line = || {
        let mut line = Vec::new();
        let read = reader.take(MAX_LINES).read_until(b'\n', &mut line);
        read.map(|_| line)
            .map_err(|source| unreadable(path, source))
    };
    let first = line()?;
    let first = std::str::from_utf8(&first).ok();
    let digest = first.and_then(|first| first.strip_prefix(MAGIC)?.strip_suffix('\n'));
    let digest = digest.map(str::to_owned).ok_or_else(|| {
        let what = format!("not the state of a build; expected: a file that begins with `{MAGIC}`");
        damaged(path, what)
    })?;
    let line = line()?;
    let unread = |error: serde_json::Error| damaged(path, format!("its header: {error}"));
    let header: Value = serde_json::from_slice(&line).map_err(unread)?;
    if header["tool"] != TOOL {
        return Err(StateError::Foreign {
            path: path.display().to_string(),
            key: "version".to_owned(),
            found: header["tool"].to_string(),
            expected: TOOL.to_owned(),
        });
    }
    let header = serde_json::from_value(header).map_err(unread)?;
    Ok((digest, header, line))
}

/// Settings by their keys; those of a table as `table.key`.
fn flat(settings: &BuildSettings) -> BTreeMap<String, String> {
    fn put(value: &Value, key: String, into: &mut BTreeMap<String, String>) {
        match value {
            Value::Object(table) => {
                for (name, value) in table {
                    let dot = if key.is_empty() { "" } else { "." };
                    put(value, format!("{key}{dot}{name}"), into);
                }
            }
            value => {
                into.insert(key, value.to_string());
            }
        }
    }
    let mut all = BTreeMap::new();
    let value = serde_json::to_value(settings).unwrap_or_default();
    put(&value, String::new(), &mut all);
    all
}

fn unreadable(path: &Path, source: io::Error) -> StateError {
    StateError::Io {
        path: path.display().to_string(),
        source,
    }
}

fn damaged(path: &Path, what: String) -> StateError {
    StateError::Damaged {
        path: path.display().to_string(),
        what,
    }
}
