//! Whether a daemon serves a domain, found out without joining it.

use std::io::ErrorKind;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

use ipc::Domain;
use program::Exit;

use crate::failure::Failure;

/// The file in which the daemon leaves its process id, and which it keeps locked.
const FILE: &str = "vpcd.pid";

/// Joins a domain that exists.
///
/// # Errors
/// [`absent`] where the directory does not exist, which joining would create, or is another user's;
/// [`ipc::JoinError`].
pub fn join(directory: &Path) -> Result<Domain, Failure> {
    match Presence::of(directory) {
        Presence::NoDomain | Presence::Foreign(_) => Err(absent(directory)),
        _ => Ok(Domain::join(directory)?),
    }
}

/// That no daemon is known to be at work in this domain: there is none, or nobody may look.
pub fn absent(directory: &Path) -> Failure {
    let domain = directory.display();
    let (exit, message) = match Presence::of(directory) {
        Presence::Foreign(owner) => {
            let [owner, whom] =
                owner.map_or(["another user", "root"].map(str::to_owned), |owner| {
                    let whom = format!("sudo -u '#{owner}' vpcctl --domain {domain} ...");
                    [format!("user {owner}"), whom]
                });
            let message = format!(
                "domain {domain}: that of {owner}; NOTHING WAS DONE: this user may not even see whether a vpcd is at work \
                 there; ask {owner}, or {whom}"
            );
            (Exit::NoPermission, message)
        }
        _ => {
            let message = format!(
                "domain {domain}: no vpcd is at work; start it (vpcd --domain {domain} ...), or name its domain with --domain"
            );
            (Exit::NoDaemon, message)
        }
    };
    Failure::new(exit, message)
}

/// The daemon of a domain.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Presence {
    /// There is no such directory.
    NoDomain,
    /// The domain is that of this other user, where the number is known, and we may not look.
    Foreign(Option<u32>),
    /// The directory exists; no daemon has claimed it.
    NoDaemon,
    /// The daemon's process id.
    Process(u32),
}

impl Presence {
    /// Looks for the daemon of the domain in this directory. The lock is looked up in `/proc/locks`
    /// and never tried: a daemon that starts at that instant would find it taken.
    pub fn of(directory: &Path) -> Self {
        let owner = match std::fs::metadata(directory) {
            Ok(found) if found.is_dir() => found.uid(),
            Err(error) if error.kind() == ErrorKind::PermissionDenied => {
                return Self::Foreign(None);
            }
            _ => return Self::NoDomain,
        };
        let file = directory.join(FILE);
        let written = match std::fs::read_to_string(&file) {
            Err(error) if error.kind() == ErrorKind::PermissionDenied && !is_ours(owner) => {
                return Self::Foreign(Some(owner));
            }
            text => text.ok().and_then(|text| text.trim().parse().ok()),
        };
        // Some file systems show another inode in the table; then the process's name decides.
        let inode = std::fs::metadata(&file).map_or(0, |found| found.ino());
        let locks = std::fs::read_to_string("/proc/locks").unwrap_or_default();
        let process = holder(&locks, inode, written)
            .or_else(|| written.filter(|&process| is_daemon(process)));
        process.map_or(Self::NoDaemon, Self::Process)
    }

    /// The daemon's process id.
    pub fn process(self) -> Option<u32> {
        match self {
            Self::Process(process) => Some(process),
            _ => None,
        }
    }
}

fn is_ours(owner: u32) -> bool {
    owner == rustix::process::geteuid().as_raw()
}

/// The daemons of this user: process ids, and the directories of their domains, wherever they were
/// moved; `None` where the directory was removed.
pub fn at_work() -> Vec<(u32, Option<PathBuf>)> {
    let entries = std::fs::read_dir("/proc").into_iter().flatten().flatten();
    let processes = entries.filter_map(|entry| {
        let process = entry.file_name().to_str()?.parse().ok()?;
        let is_one_of_ours = entry.metadata().is_ok_and(|found| is_ours(found.uid()));
        (is_one_of_ours && is_daemon(process)).then_some(process)
    });
    let mut found: Vec<_> = processes
        .filter_map(|process| Some((process, domain_of(process)?)))
        .collect();
    found.sort();
    found
}

/// The directory of the file that this daemon keeps locked, as [`at_work`] tells it; `None` if it
/// has no such file.
fn domain_of(process: u32) -> Option<Option<PathBuf>> {
    let files = std::fs::read_dir(format!("/proc/{process}/fd")).ok()?;
    files.flatten().find_map(|file| {
        let path = std::fs::read_link(file.path()).ok()?;
        let name = path.file_name()?.to_str()?;
        let directory = path.parent()?;
        match name.strip_suffix(GONE) {
            None if name == FILE => Some(Some(directory.to_owned())),
            Some(FILE) => Some(None),
            _ => None,
        }
    })
}

/// What Linux adds to the path of a file that was removed.
const GONE: &str = " (deleted)";

/// The process that holds an exclusive `flock` on this inode. Two file systems may use the same
/// inode number: the process that the file names is preferred.
fn holder(locks: &str, inode: u64, written: Option<u32>) -> Option<u32> {
    let holders = || locks.lines().filter_map(|line| parse(line, inode));
    holders()
        .find(|&process| Some(process) == written)
        .or_else(|| holders().next())
}

/// Reads a line of `/proc/locks`; `None` if it is not an exclusive `flock` on this inode.
fn parse(line: &str, inode: u64) -> Option<u32> {
    let words: Vec<&str> = line.split_whitespace().collect();
    let &[_, "FLOCK", _, "WRITE", process, place, ..] = words.as_slice() else {
        return None;
    };
    let found: u64 = place.rsplit(':').next()?.parse().ok()?;
    process.parse().ok().filter(|_| found == inode)
}

fn is_daemon(process: u32) -> bool {
    std::fs::read_to_string(format!("/proc/{process}/comm")).is_ok_and(|name| name.trim() == "vpcd")
}

#[cfg(test)]
mod tests {
    use super::*;

    const LOCKS: &str = "\
1: POSIX  ADVISORY  WRITE 11 00:1c:77 0 EOF
2: FLOCK  ADVISORY  READ  12 00:1c:77 0 EOF
3: FLOCK  ADVISORY  WRITE 13 00:1c:770 0 EOF
4: FLOCK  ADVISORY  WRITE 14 00:1d:77 0 EOF
5: FLOCK  ADVISORY  WRITE 15 00:1c:77 0 EOF
";

    #[test]
    fn the_holder_of_an_exclusive_flock_is_found_by_inode() {
        assert_eq!(holder(LOCKS, 770, None), Some(13));
        assert_eq!(holder(LOCKS, 7, None), None);
        assert_eq!(holder(LOCKS, 77, Some(15)), Some(15));
        assert_eq!(holder(LOCKS, 77, Some(99)), Some(14));
    }

    #[test]
    fn a_claimed_domain_has_a_process_and_an_abandoned_one_has_none() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join(FILE);
        assert_eq!(
            Presence::of(&directory.path().join("none")),
            Presence::NoDomain
        );
        assert_eq!(Presence::of(directory.path()), Presence::NoDaemon);
        let us = std::process::id();
        std::fs::write(&path, format!("{us}\n")).unwrap();
        assert_eq!(Presence::of(directory.path()), Presence::NoDaemon);
        let file = std::fs::File::open(&path).unwrap();
        file.lock().unwrap();
        assert_eq!(Presence::of(directory.path()), Presence::Process(us));
    }
}
