//! One daemon per domain: a locked file names its process.
//!
//! The contract allows one publisher of twists in a domain and so refuses a second daemon too, but
//! it cannot name the first one.
//!
//! The file also tells the next daemon of an end that was not clean, until an operator arms. For a
//! daemon that begins armed that is not enough: the power may fail, and the domain's directory be
//! gone with the machine. It leaves a second note, in a directory of state that outlives the
//! machine.

use std::fs::{DirBuilder, File, OpenOptions, TryLockError};
use std::io::{self, Read, Write};
use std::os::unix::ffi::OsStrExt;
use std::os::unix::fs::{DirBuilderExt, FileExt, OpenOptionsExt};
use std::path::{Path, PathBuf};

use decision::presence::{Note, Presence};

/// Name of the file in the domain's directory.
pub const FILE: &str = "vpcd.pid";
/// Most bytes of a note that are read.
const MOST: u64 = 32;

/// Why the domain could not be claimed.
#[derive(Debug, thiserror::Error)]
pub enum InstanceError {
    /// Another daemon has it.
    #[error(
        "domain {directory}: another vpcd is at work, process {holder}; end it (also if it is stopped), or use another domain"
    )]
    Taken {
        /// The domain's directory.
        directory: String,
        /// Its process id, or why that is not known.
        holder: String,
    },
    /// The file cannot be used.
    #[error("{path}: cannot claim the domain: {source}")]
    File {
        /// Path of the file, as given.
        path: String,
        /// The operating system's reason.
        source: io::Error,
    },
    /// There is no place for the note.
    #[error(
        "safety.armed = true: no directory of state, in which an end that was not clean outlives the machine; allowed: one in STATE_DIRECTORY (systemd: StateDirectory=), XDG_STATE_HOME or HOME"
    )]
    NoState,
}

impl InstanceError {
    /// The error of the file, or directory, at this path.
    fn at(path: &Path) -> impl Fn(io::Error) -> Self {
        let path = path.display().to_string();
        move |source| Self::File {
            path: path.clone(),
            source,
        }
    }
}

/// The claim to a domain. The kernel ends it with the process, however that ends.
#[derive(Debug)]
pub struct Instance {
    file: File,
    /// The note that outlives the machine.
    note: Option<PathBuf>,
    /// What the note said, and what it will say.
    pub presence: Presence<String>,
}

impl Instance {
    /// Claims the domain in this directory, which exists, for the calling process. `state` is where
    /// the note goes; `None` for a daemon that moves nothing by itself.
    ///
    /// # Errors
    /// [`InstanceError::Taken`] names the process that has it.
    pub fn claim(directory: &Path, state: Option<&Path>) -> Result<Self, InstanceError> {
        let path = directory.join(FILE);
        let trouble = InstanceError::at(&path);
        let mut file = OpenOptions::new()
            .create(true)
            .truncate(false)
            .read(true)
            .write(true)
            .mode(0o600)
            .open(&path)
            .map_err(&trouble)?;
        match file.try_lock() {
            Ok(()) => (),
            Err(TryLockError::WouldBlock) => {
                return Err(InstanceError::Taken {
                    directory: directory.display().to_string(),
                    holder: holder(&mut file),
                });
            }
            Err(TryLockError::Error(source)) => return Err(trouble(source)),
        }
        let note = state.map(|state| state.join(name(directory)));
        let mut left = read(&file).map_err(&trouble)?;
        let us = std::process::id().to_string();
        let line = format!("{us}\n");
        if let Some(note) = &note {
            let outlived = write_note(note, &line).map_err(InstanceError::at(note))?;
            left = left.or(outlived);
        }
        file.set_len(0)
            .and_then(|()| file.write_all_at(line.as_bytes(), 0))
            .map_err(trouble)?;
        Ok(Self {
            file,
            note,
            presence: Presence::claim(us, left),
        })
    }
}

impl Drop for Instance {
    fn drop(&mut self) {
        // After a panic the next one is to know that this end was not clean.
        if std::thread::panicking() {
            return;
        }
        // The file stays, since removing it could race with a daemon that locks it; empty, it names
        // no process.
        match self.presence.leave() {
            Note::Us => (),
            Note::Before(process) => {
                let _ = self.file.set_len(0);
                let _ = self.file.write_all_at(process.as_bytes(), 0);
            }
            Note::Empty => {
                let _ = self.file.set_len(0);
                let _ = self.note.as_ref().map(std::fs::remove_file);
            }
        }
    }
}

/// The directory of state, which is created if it is missing: systemd's, or the user's.
///
/// # Errors
/// [`InstanceError::NoState`] if the environment names none; [`InstanceError::File`] if it cannot
/// be created.
pub fn state_directory() -> Result<PathBuf, InstanceError> {
    let named = |name| std::env::var_os(name).filter(|value| !value.is_empty());
    let ours = |base: PathBuf| base.join("vpcd");
    let directory = match named("STATE_DIRECTORY") {
        // Several are separated by colons.
        Some(directories) => {
            let first = directories.as_bytes().split(|&byte| byte == b':').next();
            first.map(|bytes| PathBuf::from(std::ffi::OsStr::from_bytes(bytes)))
        }
        None => named("XDG_STATE_HOME")
            .map(PathBuf::from)
            .or_else(|| named("HOME").map(|home| PathBuf::from(home).join(".local/state")))
            .map(ours),
    };
    let directory = directory
        .filter(|directory| directory.is_absolute())
        .ok_or(InstanceError::NoState)?;
    let mut builder = DirBuilder::new();
    let made = builder.recursive(true).mode(0o700).create(&directory);
    made.map_err(InstanceError::at(&directory))?;
    Ok(directory)
}

/// Name of a domain's note: its path, with `%` before what a name cannot have.
fn name(directory: &Path) -> String {
    let text = directory.display().to_string();
    text.replace('%', "%25").replace('/', "%2F") + ".armed"
}

/// Writes the note, so that it outlives the power; what stood there before.
fn write_note(path: &Path, text: &str) -> io::Result<Option<String>> {
    let mut options = OpenOptions::new();
    let options = options.create(true).truncate(false).read(true).write(true);
    let mut file = options.mode(0o600).open(path)?;
    let left = read(&file)?;
    file.set_len(0)?;
    file.write_all(text.as_bytes())?;
    file.sync_all()?;
    File::open(path.parent().unwrap_or(Path::new("/")))?.sync_all()?;
    Ok(left)
}

/// What a note says; anything at all was left by an unclean end.
fn read(file: &File) -> io::Result<Option<String>> {
    let mut left = [0; MOST as usize];
    let count = file.read_at(&mut left, 0)?;
    let text = String::from_utf8_lossy(&left[..count]).trim().to_owned();
    Ok((count > 0).then_some(text))
}

fn holder(file: &mut File) -> String {
    let mut text = String::new();
    match file.take(MOST).read_to_string(&mut text) {
        Ok(_) if !text.trim().is_empty() => text.trim().to_owned(),
        _ => "unknown (it is just starting)".to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_claimed_domain_names_its_process() {
        let directory = tempfile::tempdir().unwrap();
        let first = Instance::claim(directory.path(), None).unwrap();
        let message = Instance::claim(directory.path(), None)
            .unwrap_err()
            .to_string();
        let us = format!("process {};", std::process::id());
        assert!(message.contains(&us), "{message}");
        drop(first);
        let next = Instance::claim(directory.path(), None).unwrap();
        assert_eq!(next.presence.unclean, None);
        drop(next);
        let left = std::fs::read_to_string(directory.path().join(FILE)).unwrap();
        assert_eq!(left, "");
    }

    #[test]
    fn what_a_killed_daemon_wrote_is_replaced() {
        let directory = tempfile::tempdir().unwrap();
        let file = directory.path().join(FILE);
        std::fs::write(&file, "99999999999\n").unwrap();
        let claim = Instance::claim(directory.path(), None).unwrap();
        assert_eq!(claim.presence.unclean.as_deref(), Some("99999999999"));
        let written = std::fs::read_to_string(&file).unwrap();
        assert_eq!(written, format!("{}\n", std::process::id()));
    }

    #[test]
    fn an_unclean_end_is_told_until_an_operator_has_armed() {
        let [directory, state] = [(); 2].map(|()| tempfile::tempdir().unwrap());
        let claim = || Instance::claim(directory.path(), Some(state.path())).unwrap();
        let notes = || std::fs::read_dir(state.path()).unwrap().count();
        let first = claim();
        assert_eq!((first.presence.unclean.as_deref(), notes()), (None, 1));
        // As after a kill, and a power cut that empties the directory.
        std::mem::forget(first);
        for _ in 0..2 {
            std::fs::remove_file(directory.path().join(FILE)).unwrap();
            let failed = claim();
            assert_eq!(
                failed.presence.unclean,
                Some(std::process::id().to_string())
            );
        }
        let mut armed = claim();
        assert!(armed.presence.unclean.is_some());
        armed.presence.has_consent = true;
        drop(armed);
        assert!(claim().presence.unclean.is_none());
        assert_eq!(notes(), 0);
        // Where it begins disarmed, too.
        std::fs::write(directory.path().join(FILE), "12\n").unwrap();
        for _ in 0..2 {
            let claim = Instance::claim(directory.path(), None).unwrap();
            assert_eq!(claim.presence.unclean.as_deref(), Some("12"));
        }
    }

    #[test]
    fn each_domain_has_a_note_of_its_own() {
        let names = ["/a/b", "/a%2Fb", "/a/b/"].map(|path| name(Path::new(path)));
        assert_eq!(names[0], "%2Fa%2Fb.armed");
        assert_ne!(names[0], names[1]);
    }

    #[test]
    fn a_file_that_cannot_be_used_is_named() {
        let directory = tempfile::tempdir().unwrap();
        std::fs::create_dir(directory.path().join(FILE)).unwrap();
        let error = Instance::claim(directory.path(), None).unwrap_err();
        assert!(error.to_string().contains(FILE), "{error}");
    }
}
