//! The file of an unfinished build: what Ctrl-C or a kill leaves, and where the next build goes on.
//!
//! A line `vpc-memory-state 3 SHA256`, the digest being that of all that follows; then, in
//! Postcard, what the build is (version, scene, settings) and its progress.

use std::collections::BTreeMap;
use std::fs;
use std::io;
use std::path::Path;

use memory_blob::hex;
use program::replace;
use scene::SceneFiles;
use serde_json::Value;
use sha2::{Digest, Sha256};

use crate::progress::Progress;
use crate::settings::BuildSettings;

/// Begin of the first line, before the digest.
const MAGIC: &[u8] = b"vpc-memory-state 3 ";
/// The program and its version, as in the provenance of a memory.
pub(crate) const TOOL: &str = concat!("vpc-memory ", env!("CARGO_PKG_VERSION"));

/// What makes two builds the same, key by key.
#[derive(Clone, Debug)]
pub struct BuildIdentity(BTreeMap<String, String>);

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
    /// The file is no state, or is damaged.
    #[error("{path}: {what}; remove it to begin anew")]
    Damaged {
        /// The file.
        path: String,
        /// What was found and expected.
        what: String,
    },
    /// The file belongs to another build.
    #[error("{path}: {key} is {found}; expected: {expected}; remove the file to begin anew")]
    Foreign {
        /// The file.
        path: String,
        /// What differs.
        key: String,
        /// In this file.
        found: String,
        /// In the build that is to go on.
        expected: String,
    },
}

impl BuildIdentity {
    /// The build of this scene with these settings by this version of the program.
    pub fn new(scene: &SceneFiles, settings: &BuildSettings) -> Self {
        let mut keys = BTreeMap::new();
        let settings = serde_json::to_value(settings).unwrap_or_default();
        flatten(&settings, String::new(), &mut keys);
        keys.insert("version".to_owned(), TOOL.to_owned());
        keys.insert("checksum of the scene".to_owned(), scene.digest());
        Self(keys)
    }

    /// Progress from the file at `path`, if there is one; else none.
    ///
    /// # Errors
    /// [`StateError`] if the file is damaged or belongs to another build.
    pub fn resume(&self, path: &Path) -> Result<Progress, StateError> {
        let file = match fs::read(path) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(Progress::default()),
            file => file.map_err(|source| io_error(path, source))?,
        };
        let damaged = |what: String| StateError::Damaged {
            path: path.display().to_string(),
            what,
        };
        let lines = file
            .strip_prefix(MAGIC)
            .and_then(|rest| rest.split_at_checked(64))
            .and_then(|(digest, rest)| Some((digest, rest.strip_prefix(b"\n")?)));
        let Some((expected, body)) = lines else {
            let magic = String::from_utf8_lossy(MAGIC);
            let what = format!("not the state of a build; expected: begins with `{magic}`");
            return Err(damaged(what));
        };
        let found = hex(&Sha256::digest(body));
        if found.as_bytes() != expected {
            let expected = String::from_utf8_lossy(expected);
            let what = format!("damaged: its SHA-256 is {found}; expected: {expected}");
            return Err(damaged(what));
        }
        let parsed = |error: postcard::Error| damaged(error.to_string());
        let (keys, progress) = postcard::take_from_bytes(body).map_err(parsed)?;
        self.check(&keys, path)?;
        postcard::from_bytes(progress).map_err(parsed)
    }

    /// Checks that a file at `path` with these keys belongs to this build.
    fn check(&self, found: &BTreeMap<String, String>, path: &Path) -> Result<(), StateError> {
        for key in self.0.keys().chain(found.keys()) {
            let value = |of: &BTreeMap<_, _>| of.get(key).cloned().unwrap_or_default();
            let (found, expected) = (value(found), value(&self.0));
            if found != expected {
                return Err(StateError::Foreign {
                    path: path.display().to_string(),
                    key: key.clone(),
                    found,
                    expected,
                });
            }
        }
        Ok(())
    }

    /// Replaces the file at `path` by the progress of this build, atomically.
    ///
    /// # Errors
    /// [`StateError::Io`] if the file cannot be written.
    pub fn save(&self, path: &Path, progress: &Progress) -> Result<(), StateError> {
        let write = || {
            let body = postcard::to_stdvec(&(&self.0, progress)).map_err(io::Error::other)?;
            let digest = hex(&Sha256::digest(&body));
            replace(path, &[MAGIC, digest.as_bytes(), b"\n", &body].concat())
        };
        write().map_err(|source| io_error(path, source))
    }
}

/// Puts the values of settings under their keys; those of a table under `table.key`.
fn flatten(value: &Value, key: String, into: &mut BTreeMap<String, String>) {
    let Value::Object(table) = value else {
        into.insert(key, value.to_string());
        return;
    };
    for (name, value) in table {
        let dot = if key.is_empty() { "" } else { "." };
        flatten(value, format!("{key}{dot}{name}"), into);
    }
}

fn io_error(path: &Path, source: io::Error) -> StateError {
    StateError::Io {
        path: path.display().to_string(),
        source,
    }
}
