//! Whether a daemon serves a domain, found out without joining it: joining would create what is not there.

use std::os::unix::fs::MetadataExt;
use std::path::Path;

/// Name of the file in which the daemon leaves its process id and which it keeps locked.
const FILE: &str = "vpcd.pid";

/// Who serves a domain.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Presence {
    /// There is no such directory.
    NoDomain,
    /// The directory is there; no daemon has claimed it.
    NoDaemon,
    /// The process of the daemon.
    Process(u32),
}

impl Presence {
    /// Looks who serves the domain in this directory. A lock is looked up in `/proc/locks` and never tried, since a
    /// daemon that starts at this very instant would take us for another one.
    pub fn of(directory: &Path) -> Self {
        if !directory.is_dir() {
            return Self::NoDomain;
        }
        let file = directory.join(FILE);
        let written = std::fs::read_to_string(&file)
            .ok()
            .and_then(|text| text.trim().parse().ok());
        let inode = std::fs::metadata(&file).map(|found| found.ino());
        let locks = std::fs::read_to_string("/proc/locks");
        let holder = match (inode, locks) {
            (Ok(inode), Ok(locks)) => holder(&locks, inode, written),
            _ => None,
        };
        // Some file systems show another inode in the table: then the name of the process decides.
        match holder.or_else(|| written.filter(|&pid| is_daemon(pid))) {
            Some(process) => Self::Process(process),
            None => Self::NoDaemon,
        }
    }

    /// The daemon's process id.
    pub fn process(self) -> Option<u32> {
        match self {
            Self::Process(process) => Some(process),
            _ => None,
        }
    }
}

/// The process that holds an exclusive `flock` on this inode. Inodes of two file systems may be equal: the process that
/// the file names is preferred.
fn holder(locks: &str, inode: u64, written: Option<u32>) -> Option<u32> {
    let holders = locks.lines().filter_map(flock);
    let holders = holders.filter(|lock| lock.is_exclusive && lock.inode == inode);
    let holders: Vec<u32> = holders.map(|lock| lock.process).collect();
    written
        .filter(|process| holders.contains(process))
        .or_else(|| holders.first().copied())
}

/// Whether some process holds a `flock` on this file.
pub fn is_locked(file: &Path) -> bool {
    let (Ok(found), Ok(locks)) = (
        std::fs::metadata(file),
        std::fs::read_to_string("/proc/locks"),
    ) else {
        return false;
    };
    locks
        .lines()
        .filter_map(flock)
        .any(|lock| lock.inode == found.ino())
}

/// A line of `/proc/locks`.
struct Flock {
    is_exclusive: bool,
    process: u32,
    inode: u64,
}

fn flock(line: &str) -> Option<Flock> {
    let mut words = line.split_whitespace().skip(1);
    let (kind, _, mode) = (words.next()?, words.next()?, words.next()?);
    let process = words.next()?.parse().ok()?;
    let inode = words.next()?.rsplit(':').next()?.parse().ok()?;
    (kind == "FLOCK").then_some(Flock {
        is_exclusive: mode == "WRITE",
        process,
        inode,
    })
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
