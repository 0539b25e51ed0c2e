//! The guard of a domain: which processes are in it, which one starts right now, and which one may
//! clean up.
//!
//! A process that is killed while it creates a service can leave that service unusable for ever.
//! Two locked files prevent it:
//!
//! - `startup` is locked exclusively by a process that joins, leaves or opens a port, for as long
//!   as that takes: one at a time.
//! - `lock` is locked in shared mode by every participant for as long as it lives. A process that
//!   gets it exclusively while holding `startup` is alone, and removes what dead processes left
//!   before it creates anything.
//!
//! So services are only ever created by a process that is alone in the domain; if it is killed
//! halfway, the next one is alone again. The kernel drops the locks of dead processes, however they
//! died. Linux does not turn an exclusive lock into a shared one atomically; no other process can
//! slip in between, because trying takes `startup`.
//!
//! A third kind of lock says who publishes. iceoryx2 counts publishers too, but a kill can leave it
//! a place too few for good, which then must not be the only one.

use std::fs::{DirBuilder, File, OpenOptions};
use std::io;
use std::os::unix::fs::{DirBuilderExt, MetadataExt, OpenOptionsExt};
use std::path::{Path, PathBuf};
use std::time::Duration;

use rustix::fs::{FlockOperation, flock};
use rustix::io::Errno;
use rustix::process::{Pid, getpid};

use crate::error::JoinReason;

/// Permissions that the directory of a domain must not have: users who can replace its files can
/// take part.
pub const WRITABLE_BY_OTHERS: u32 = 0o022;

/// Directory of the publishers' locks in that of the domain.
const PUBLISHERS: &str = "publishers";

/// Longest wait for others that join or leave. Joining takes milliseconds; a process that holds the
/// lock for longer is stopped.
const PATIENCE: Duration = Duration::from_secs(10);
/// Pause between two attempts.
const PAUSE: Duration = Duration::from_millis(1);

/// Membership of a domain, for life.
#[derive(Debug)]
pub(crate) struct Guard {
    directory: PathBuf,
    /// Device and inode of the directory. They stay its own while `member` is open below it.
    place: (u64, u64),
    member: File,
}

/// The startup lock: the exclusive right to join, leave or open a port. Ends when dropped.
#[derive(Debug)]
pub(crate) struct Startup(#[allow(dead_code)] File);

impl Guard {
    /// Enters the domain in `directory`, which is created if it is missing. `wipe` runs if no other
    /// process is in it.
    pub(crate) fn enter(
        directory: &Path,
        wipe: impl FnOnce(&Path) -> io::Result<()>,
    ) -> Result<(Self, Startup), JoinReason> {
        let directory = prepare(directory)?;
        let startup = Startup::take(&directory, PATIENCE)?;
        let member = open(&directory, "lock")?;
        if try_lock(&member)? {
            wipe(&directory)?;
        }
        // Never waits: only the holder of `startup`, which is this process, locks `lock`
        // exclusively.
        flock(&member, FlockOperation::NonBlockingLockShared).map_err(io::Error::from)?;
        let guard = Self {
            place: place(&directory)?,
            directory,
            member,
        };
        Ok((guard, startup))
    }

    /// Waits for the startup lock.
    pub(crate) fn startup(&self) -> Result<Startup, JoinReason> {
        // Another directory's lock would protect nothing of ours.
        match place(&self.directory) {
            Ok(found) if found == self.place => Startup::take(&self.directory, PATIENCE),
            _ => Err(JoinReason::Moved),
        }
    }

    /// Leaves; `wipe` runs if no other process is in the domain.
    pub(crate) fn leave(
        &self,
        _startup: &Startup,
        wipe: impl FnOnce(&Path) -> io::Result<()>,
    ) -> io::Result<()> {
        // Even if this fails, Linux has dropped the shared lock, which is what leaving means.
        match try_lock(&self.member)? {
            true => wipe(&self.directory),
            false => Ok(()),
        }
    }

    /// The directory, canonical.
    pub(crate) fn directory(&self) -> &Path {
        &self.directory
    }
}

impl Startup {
    fn take(directory: &Path, patience: Duration) -> Result<Self, JoinReason> {
        let file = open(directory, "startup")?;
        for _ in 0..patience.as_nanos() / PAUSE.as_nanos() {
            if try_lock(&file)? {
                return Ok(Self(file));
            }
            std::thread::sleep(PAUSE);
        }
        Err(JoinReason::Busy(patience.as_secs()))
    }
}

/// A publisher's place in a service, until it is dropped or its process ends.
#[derive(Debug)]
pub(crate) struct Place {
    file: File,
    process: Pid,
}

impl Drop for Place {
    fn drop(&mut self) {
        // Children that were forked without exec hold the same file: closing ours would not do, and
        // theirs must not free our place.
        if getpid() == self.process {
            let _ = flock(&self.file, FlockOperation::Unlock);
        }
    }
}

impl Place {
    /// Takes one of the `most` places; `None` while others have them all.
    pub(crate) fn take(
        guard: &Guard,
        _startup: &Startup,
        service: &str,
        most: usize,
    ) -> io::Result<Option<Self>> {
        let directory = guard.directory.join(PUBLISHERS);
        let name = service.replace('/', "-");
        for place in 1..=most {
            let file = open(&directory, &format!("{name}-{place}"))?;
            if try_lock(&file)? {
                return Ok(Some(Self {
                    file,
                    process: getpid(),
                }));
            }
        }
        Ok(None)
    }
}

/// Device and inode of a directory.
fn place(directory: &Path) -> io::Result<(u64, u64)> {
    let found = std::fs::symlink_metadata(directory)?;
    Ok((found.dev(), found.ino()))
}

/// Tries to lock a file exclusively; false if another process holds a lock on it.
fn try_lock(file: &File) -> io::Result<bool> {
    match flock(file, FlockOperation::NonBlockingLockExclusive) {
        Ok(()) => Ok(true),
        Err(Errno::WOULDBLOCK) => Ok(false),
        Err(errno) => Err(errno.into()),
    }
}

/// Opens a file to be locked. Descriptors are closed in child processes, so that these do not stay
/// members.
fn open(directory: &Path, name: &str) -> io::Result<File> {
    OpenOptions::new()
        .create(true)
        .truncate(false)
        .write(true)
        .mode(0o600)
        .open(directory.join(name))
}

/// Creates the directory if it is missing, and checks that it is ours: names below /tmp can be
/// guessed.
fn prepare(directory: &Path) -> Result<PathBuf, JoinReason> {
    DirBuilder::new()
        .recursive(true)
        .mode(0o700)
        .create(directory)?;
    let found = std::fs::symlink_metadata(directory)?;
    let (owner, us) = (found.uid(), rustix::process::geteuid().as_raw());
    if !found.is_dir() || owner != us {
        return Err(JoinReason::NotOurs { owner, us });
    }
    let mode = found.mode() & 0o777;
    if mode & WRITABLE_BY_OTHERS != 0 {
        return Err(JoinReason::Open(mode));
    }
    let directory = directory.canonicalize()?;
    DirBuilder::new()
        .recursive(true)
        .mode(0o700)
        .create(directory.join(PUBLISHERS))?;
    Ok(directory)
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
    fn who_was_moved_neither_wipes_nor_opens_at_the_old_place() {
        let place = tempfile::tempdir().unwrap();
        let [old, new] = ["old", "new"].map(|name| place.path().join(name));
        let (guard, startup) = Guard::enter(&old, |_| Ok(())).unwrap();
        drop(startup);
        drop(guard.startup().unwrap());
        std::fs::rename(&old, &new).unwrap();
        assert!(matches!(guard.startup(), Err(JoinReason::Moved)));
        let (_other, startup) = Guard::enter(&old, |_| Ok(())).unwrap();
        drop(startup);
        let message = guard.startup().unwrap_err().to_string();
        assert!(message.contains("moved or replaced"), "{message}");
    }

    #[test]
    fn publishers_have_so_many_places_and_free_them() {
        let directory = tempfile::tempdir().unwrap();
        let (guard, startup) = Guard::enter(directory.path(), |_| Ok(())).unwrap();
        let take = || Place::take(&guard, &startup, "a/b", 2).unwrap();
        let (first, second) = (take(), take());
        assert!(first.is_some() && second.is_some() && take().is_none());
        drop(first);
        assert!(take().is_some());
    }

    #[test]
    fn a_stopped_starter_is_reported() {
        let directory = tempfile::tempdir().unwrap();
        let _stopped = Startup::take(directory.path(), PATIENCE).unwrap();
        let error = Startup::take(directory.path(), Duration::from_millis(3)).unwrap_err();
        let message = error.to_string();
        assert!(message.contains("joining or leaving"), "{message}");
    }

    #[test]
    fn a_directory_that_others_may_write_to_is_refused() {
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
        // Read access reveals file names and nothing else.
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
        assert!(matches!(error, JoinReason::NotOurs { .. }), "{error}");
    }
}
