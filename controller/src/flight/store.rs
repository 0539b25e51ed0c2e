//! The directory of flight records: whole files only, and a bounded number of them.

use std::fs::{self, DirBuilder, File, OpenOptions};
use std::io;
use std::os::unix::fs::{DirBuilderExt, MetadataExt, OpenOptionsExt};
use std::path::{Path, PathBuf};

use recording::WriteError;

/// Prefix of file names.
const PREFIX: &str = "vpcd-";
/// Suffix of whole files.
const SUFFIX: &str = ".mcap";
/// Suffix of files that are being written.
const BESIDE: &str = ".mcap.tmp";

/// What a file leaves of the disk, bytes: a record must not be what fills it.
const RESERVE: u64 = 64 << 20;

/// Why a flight record was not written.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs)]
pub enum StoreError {
    #[error("{directory}: cannot be used for flight records: {source}")]
    Directory {
        directory: String,
        source: io::Error,
    },
    /// The directory belongs to another user, who could remove or replace the files.
    #[error("{directory}: belongs to user {found}; allowed: {own}, who runs vpcd")]
    Owner {
        directory: String,
        found: u32,
        own: u32,
    },
    #[error("{path}: cannot write the flight record: {source}")]
    Write { path: String, source: io::Error },
    /// The disk would be left without a reserve.
    #[error(
        "{directory}: {free} bytes free; needed: {needed}, for the flight record and a reserve of {RESERVE} bytes"
    )]
    NoRoom {
        directory: String,
        free: u64,
        needed: u64,
    },
    #[error(transparent)]
    Recording(#[from] WriteError),
}

/// A directory that keeps the newest files.
#[derive(Clone, Debug)]
pub struct Store {
    directory: PathBuf,
    keep: usize,
}

impl Store {
    /// A store in this directory, which is made with the first file; it keeps `keep` files, at
    /// least one.
    pub fn new(directory: PathBuf, keep: usize) -> Self {
        Self {
            directory,
            keep: keep.max(1),
        }
    }

    /// Makes a file of at most `most` bytes, whole or not at all, readable by this user only, and
    /// removes the oldest ones beyond those kept. Leaves 64 MiB of the disk. `stamp` orders files
    /// by age, `cause` tells them apart: letters, digits and hyphens. `fill` is called with the
    /// path of an empty file, and synchronizes what it writes to the disk, which may take long.
    ///
    /// # Errors
    /// [`StoreError`]; nothing is left of the file then.
    pub fn write(
        &self,
        stamp: u64,
        cause: &str,
        most: u64,
        fill: impl FnOnce(&Path) -> Result<(), WriteError>,
    ) -> Result<PathBuf, StoreError> {
        self.prepare()?;
        self.check_room(most)?;
        let name = format!("{PREFIX}{stamp:015}-{cause}");
        let path = self.directory.join(format!("{name}{SUFFIX}"));
        let beside = self.directory.join(format!("{name}{BESIDE}"));
        let failed = |source| StoreError::Write {
            path: path.display().to_string(),
            source,
        };
        let written = || {
            let mut how = OpenOptions::new();
            let made = how.write(true).create_new(true).mode(0o600).open(&beside);
            made.map_err(failed)?;
            fill(&beside)?;
            fs::rename(&beside, &path).map_err(failed)?;
            // The directory holds the name.
            let directory = File::open(&self.directory);
            directory.and_then(|d| d.sync_all()).map_err(failed)
        };
        if let Err(error) = written() {
            let _ = fs::remove_file(&beside);
            return Err(error);
        }
        self.prune();
        Ok(path)
    }

    /// The files, the oldest first.
    pub fn files(&self) -> Vec<PathBuf> {
        self.named(SUFFIX)
    }

    fn prepare(&self) -> Result<(), StoreError> {
        let directory = || self.directory.display().to_string();
        let trouble = |source| StoreError::Directory {
            directory: directory(),
            source,
        };
        let mut builder = DirBuilder::new();
        let made = builder.recursive(true).mode(0o700).create(&self.directory);
        made.map_err(trouble)?;
        let found = fs::metadata(&self.directory).map_err(trouble)?.uid();
        let own = rustix::process::geteuid().as_raw();
        if found != own {
            return Err(StoreError::Owner {
                directory: directory(),
                found,
                own,
            });
        }
        Ok(())
    }

    fn check_room(&self, most: u64) -> Result<(), StoreError> {
        let directory = || self.directory.display().to_string();
        let found =
            rustix::fs::statvfs(&self.directory).map_err(|error| StoreError::Directory {
                directory: directory(),
                source: error.into(),
            })?;
        let free = found.f_bavail.saturating_mul(found.f_frsize);
        let needed = most.saturating_add(RESERVE);
        match free < needed {
            true => Err(StoreError::NoRoom {
                directory: directory(),
                free,
                needed,
            }),
            false => Ok(()),
        }
    }

    /// What cannot be removed now is removed after the next file, or by its owner.
    fn prune(&self) {
        let files = self.files();
        for file in files.iter().rev().skip(self.keep) {
            let _ = fs::remove_file(file);
        }
        // Left by a daemon that was killed: the store has one writer, and that one is here.
        for file in self.named(BESIDE) {
            let _ = fs::remove_file(file);
        }
    }

    fn named(&self, suffix: &str) -> Vec<PathBuf> {
        let Ok(entries) = fs::read_dir(&self.directory) else {
            return Vec::new();
        };
        let is_ours = |path: &Path| {
            let name = path.file_name().and_then(|name| name.to_str());
            name.is_some_and(|name| name.starts_with(PREFIX) && name.ends_with(suffix))
        };
        let paths = entries.filter_map(|entry| Some(entry.ok()?.path()));
        let mut files: Vec<PathBuf> = paths.filter(|path| is_ours(path)).collect();
        files.sort();
        files
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn text(text: &str) -> impl FnOnce(&Path) -> Result<(), WriteError> {
        move |path| {
            fs::write(path, text).unwrap();
            Ok(())
        }
    }

    #[test]
    fn the_newest_files_are_kept_and_nothing_else_is_touched() {
        let place = tempfile::tempdir().unwrap();
        let directory = place.path().join("deep/er");
        let store = Store::new(directory.clone(), 2);
        store.write(5, "request", 9, text("five")).unwrap();
        fs::write(directory.join("notes.txt"), "mine").unwrap();
        fs::write(
            directory.join("vpcd-000000000000001-fault.mcap.tmp"),
            "torn",
        )
        .unwrap();
        store.write(7, "fault", 9, text("seven")).unwrap();
        let last = store.write(600, "request", 9, text("six hundred")).unwrap();
        assert_eq!(fs::read(&last).unwrap(), b"six hundred");
        let files = store.files();
        assert_eq!(files.len(), 2);
        assert_eq!(fs::read(&files[0]).unwrap(), b"seven");
        assert_eq!(fs::read_dir(&directory).unwrap().count(), 3);
        assert_eq!(fs::metadata(&last).unwrap().mode() & 0o777, 0o600);
    }

    #[test]
    fn a_record_that_would_fill_the_disk_is_not_written() {
        let place = tempfile::tempdir().unwrap();
        let store = Store::new(place.path().to_owned(), 2);
        let found = rustix::fs::statvfs(place.path()).unwrap();
        let free = found.f_bavail * found.f_frsize;
        let error = store.write(5, "exit", free, text("x")).unwrap_err();
        assert!(matches!(error, StoreError::NoRoom { .. }), "{error}");
        assert!(store.files().is_empty());
        store.write(5, "exit", 9, text("x")).unwrap();
    }

    #[test]
    fn an_unwritable_path_is_named_and_nothing_is_left() {
        let place = tempfile::tempdir().unwrap();
        let taken = place.path().join("taken");
        fs::write(&taken, "a file").unwrap();
        let error = Store::new(taken, 2)
            .write(5, "request", 9, text("x"))
            .unwrap_err();
        assert!(
            error.to_string().contains("/taken: cannot be used"),
            "{error}"
        );
        let store = Store::new(place.path().to_owned(), 2);
        fs::create_dir_all(place.path().join("vpcd-000000000000005-exit.mcap/inside")).unwrap();
        let error = store.write(5, "exit", 9, text("x")).unwrap_err();
        assert!(
            error.to_string().contains("-exit.mcap: cannot write"),
            "{error}"
        );
        assert!(store.named(BESIDE).is_empty());
    }
}
