//! The guard of a domain: who is in it, who starts right now, and who may clean up.
//!
//! A process that is killed while it creates a service can leave that service unusable for ever. Two locked files
//! stand against it:
//!
//! - `startup` is held exclusively by whoever joins, leaves or opens a port, for as long as that takes: one at a time.
//! - `lock` is held in common by every participant for as long as it lives. Whoever gets it exclusively while it
//!   holds `startup` is alone, and wipes what the dead left behind before it creates anything.
//!
//! So services are only ever created by a process that is alone in the domain; were it killed half-way, the next one
//! would be alone again. The kernel drops the locks of the dead, however they died. Going over from the exclusive to
//! the common lock is not atomic in Linux; nobody can slip in between, because trying takes `startup`.

use std::fs::{DirBuilder, File, OpenOptions};
use std::io;
use std::os::unix::fs::{DirBuilderExt, MetadataExt, OpenOptionsExt};
use std::path::{Path, PathBuf};
use std::time::Duration;

use rustix::fs::{FlockOperation, flock};
use rustix::io::Errno;

use crate::error::JoinError;

/// Permissions that the directory of a domain must not have: who can replace its files can take part.
pub const WRITABLE_BY_OTHERS: u32 = 0o022;

/// Longest wait for others that join or leave. Joining takes milliseconds; who holds the lock for longer is stopped.
const PATIENCE: Duration = Duration::from_secs(10);
/// Pause between two attempts.
const PAUSE: Duration = Duration::from_millis(1);

/// Membership of a domain, for life.
#[derive(Debug)]
pub(crate) struct Guard {
    directory: PathBuf,
    member: File,
}

/// The exclusive right to join, leave or open a port; ends when dropped.
#[derive(Debug)]
pub(crate) struct Startup {
    _file: File,
}

impl Guard {
    /// Enters the domain in `directory`, which is created where it is missing. `wipe` runs if nobody else is in.
    pub(crate) fn enter(
        directory: &Path,
        wipe: impl FnOnce(&Path) -> io::Result<()>,
    ) -> Result<(Self, Startup), JoinError> {
        let trouble = |source: io::Error| JoinError::Directory {
            path: directory.display().to_string(),
            source,
        };
        let directory = prepare(directory)?;
        let startup = Startup::take(&directory, PATIENCE)?;
        let member = open(&directory, "lock").map_err(trouble)?;
        match flock(&member, FlockOperation::NonBlockingLockExclusive) {
            Ok(()) => wipe(&directory).map_err(trouble)?,
            Err(Errno::WOULDBLOCK) => (),
            Err(errno) => return Err(trouble(errno.into())),
        }
        // Never waits: nobody holds `lock` exclusively but the holder of `startup`, which is us.
        flock(&member, FlockOperation::NonBlockingLockShared).map_err(|e| trouble(e.into()))?;
        let guard = Self { directory, member };
        Ok((guard, startup))
    }

    /// Waits for the right to join, leave or open a port.
    pub(crate) fn startup(&self) -> Result<Startup, JoinError> {
        Startup::take(&self.directory, PATIENCE)
    }

    /// Leaves; `wipe` runs if nobody else is in.
    pub(crate) fn leave(
        &self,
        _startup: &Startup,
        wipe: impl FnOnce(&Path) -> io::Result<()>,
    ) -> io::Result<()> {
        match flock(&self.member, FlockOperation::NonBlockingLockExclusive) {
            Ok(()) => wipe(&self.directory),
            // Linux has let go of the common lock by now, which is what leaving means.
            Err(_) => Ok(()),
        }
    }

    /// The directory, canonical.
    pub(crate) fn directory(&self) -> &Path {
        &self.directory
    }
}

impl Startup {
    fn take(directory: &Path, patience: Duration) -> Result<Self, JoinError> {
        let path = directory.display().to_string();
        let file = open(directory, "startup").map_err(|source| JoinError::Directory {
            path: path.clone(),
            source,
        })?;
        let attempts = patience.as_nanos() / PAUSE.as_nanos();
        for _ in 0..attempts {
            match flock(&file, FlockOperation::NonBlockingLockExclusive) {
                Ok(()) => return Ok(Self { _file: file }),
                Err(Errno::WOULDBLOCK) => std::thread::sleep(PAUSE),
                Err(errno) => {
                    let source = errno.into();
                    return Err(JoinError::Directory { path, source });
                }
            }
        }
        let seconds = patience.as_secs();
        Err(JoinError::Busy { path, seconds })
    }
}

/// Opens a file to be locked; descriptors are closed in children that are started, so that they do not stay members.
fn open(directory: &Path, name: &str) -> io::Result<File> {
    OpenOptions::new()
        .create(true)
        .truncate(false)
        .write(true)
        .mode(0o600)
        .open(directory.join(name))
}

/// Creates the directory where it is missing, and makes sure that it is ours: names below /tmp can be guessed.
fn prepare(directory: &Path) -> Result<PathBuf, JoinError> {
    let path = directory.display().to_string();
    let trouble = |source| JoinError::Directory {
        path: path.clone(),
        source,
    };
    DirBuilder::new()
        .recursive(true)
        .mode(0o700)
        .create(directory)
        .map_err(trouble)?;
    let found = std::fs::symlink_metadata(directory).map_err(trouble)?;
    let (owner, us) = (found.uid(), rustix::process::geteuid().as_raw());
    if !found.is_dir() || owner != us {
        return Err(JoinError::NotOurs { path, owner, us });
    }
    let mode = found.mode() & 0o777;
    if mode & WRITABLE_BY_OTHERS != 0 {
        return Err(JoinError::Open { path, mode });
    }
    directory.canonicalize().map_err(trouble)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_who_is_alone_wipes() {
        let directory = tempfile::tempdir().unwrap();
        let mut wiped = Vec::new();
        let mut enter = |name: &'static str| {
            let (guard, startup) = Guard::enter(directory.path(), |_| {
                wiped.push(name);
                Ok(())
            })
            .unwrap();
            drop(startup);
            guard
        };
        let first = enter("first");
        let second = enter("second");
        drop(first);
        let third = enter("third");
        drop((second, third));
        let _fourth = enter("fourth");
        assert_eq!(wiped, ["first", "fourth"]);
    }

    #[test]
    fn a_stopped_starter_is_reported_instead_of_waited_for_without_end() {
        let directory = tempfile::tempdir().unwrap();
        let _stopped = Startup::take(directory.path(), PATIENCE).unwrap();
        let error = Startup::take(directory.path(), Duration::from_millis(3)).unwrap_err();
        assert!(
            error.to_string().contains("is joining or leaving"),
            "{error}"
        );
    }

    #[test]
    fn a_directory_that_others_may_write_to_is_refused_with_its_mode() {
        use std::os::unix::fs::PermissionsExt;
        let directory = tempfile::tempdir().unwrap();
        let enter = |mode: u32| {
            let permissions = std::fs::Permissions::from_mode(mode);
            std::fs::set_permissions(directory.path(), permissions).unwrap();
            Guard::enter(directory.path(), |_| Ok(()))
        };
        for mode in [0o777, 0o770, 0o702] {
            let message = enter(mode).unwrap_err().to_string();
            let words = format!("mode {mode:o} lets other users put files into it; allowed: ");
            assert!(message.contains(&words), "{message}");
        }
        // Who is let look sees names only.
        assert!(enter(0o755).is_ok() && enter(0o700).is_ok());
    }

    #[test]
    fn a_link_that_somebody_planted_is_refused() {
        let directory = tempfile::tempdir().unwrap();
        let (target, link) = (
            directory.path().join("target"),
            directory.path().join("link"),
        );
        std::fs::create_dir(&target).unwrap();
        std::os::unix::fs::symlink(&target, &link).unwrap();
        let error = Guard::enter(&link, |_| Ok(())).unwrap_err();
        assert!(matches!(error, JoinError::NotOurs { .. }), "{error}");
    }
}
