//! The directory of the domain and its shared memory.

use std::io::ErrorKind;
use std::os::unix::fs::MetadataExt;
use std::path::Path;
use std::time::Duration;

use super::Finding;
use crate::presence::{Presence, holders};

/// Where Linux keeps POSIX shared memory.
const SHARED_MEMORY: &str = "/dev/shm";
/// Age from which shared memory without a size is left over from a killed process.
const UNBORN: Duration = Duration::from_secs(1);
/// The domain of the service (systemd/vpcd.service).
const SERVICE: &str = "/run/vpcd";

pub(super) fn examine(directory: &Path) -> Vec<Finding> {
    let mut findings = vec![place(directory, rustix::process::geteuid().as_raw())];
    findings.extend(elsewhere(directory, Path::new(SERVICE)));
    findings.push(leftovers(directory, Path::new(SHARED_MEMORY)));
    findings
}

/// Owner and mode.
fn place(directory: &Path, us: u32) -> Finding {
    let what = "domain";
    let path = directory.display();
    let found = match std::fs::symlink_metadata(directory) {
        Ok(found) => found,
        Err(error) if error.kind() == ErrorKind::NotFound => {
            let words = format!("{path}: does not exist yet; the first process creates it");
            return Finding::ok(what, words);
        }
        Err(error) => {
            let remedy = "run as the user of the daemon, or name another --domain";
            return Finding::fail(what, format!("{path}: {error}"), remedy);
        }
    };
    let (owner, mode) = (found.uid(), found.mode() & 0o777);
    if !found.is_dir() {
        let remedy = format!("remove it, or name the directory itself with --domain: ls -l {path}");
        Finding::fail(
            what,
            format!("{path}: a link or a file, no directory"),
            remedy,
        )
    } else if owner != us {
        let remedy =
            format!("sudo -u '#{owner}' vpcctl --domain {path} ..., or name another domain");
        let words = format!("{path}: belongs to user {owner}, and we are user {us}");
        Finding::fail(what, words, remedy)
    } else if mode & ipc::WRITABLE_BY_OTHERS != 0 {
        let words = format!("{path}: mode {mode:03o} lets others put files into it");
        Finding::fail(what, words, format!("chmod 700 {path}"))
    } else if mode & 0o077 != 0 {
        let words = format!("{path}: mode {mode:03o} lets others look into it");
        Finding::warn(what, words, format!("chmod 700 {path}"))
    } else {
        Finding::ok(what, format!("{path}: ours, mode {mode:03o}"))
    }
}

/// Whether the service's domain exists, where no daemon runs in the one asked for.
fn elsewhere(directory: &Path, service: &Path) -> Option<Finding> {
    if directory == service || Presence::of(directory).process().is_some() {
        return None;
    }
    // Other users cannot see inside: that it exists tells that the service was started.
    let owner = std::fs::symlink_metadata(service).ok()?.uid();
    let path = service.display();
    let words = format!("{path} exists: the service's domain, of user {owner}");
    let remedy = format!("to reach the service: sudo -u vpcd vpcctl --domain {path}");
    Some(Finding::warn("other domain", words, remedy))
}

/// Shared memory that killed processes left.
fn leftovers(directory: &Path, shared: &Path) -> Finding {
    let what = "leftovers";
    let Ok(canonical) = directory.canonicalize() else {
        return Finding::ok(what, "no domain, no shared memory");
    };
    let Ok(entries) = std::fs::read_dir(shared) else {
        let remedy = "mount -t tmpfs tmpfs /dev/shm (in a container: --ipc or --shm-size)";
        return Finding::fail(
            what,
            format!("{}: cannot be read", shared.display()),
            remedy,
        );
    };
    let prefix = ipc::shared_memory_prefix(&canonical);
    let ours = entries
        .flatten()
        .filter(|entry| entry.file_name().to_string_lossy().starts_with(&prefix))
        .filter_map(|entry| entry.metadata().ok());
    let (mut count, mut bytes, mut unborn) = (0, 0, 0);
    for found in ours {
        count += 1;
        bytes += found.len();
        let age = found.modified().ok().and_then(|at| at.elapsed().ok());
        unborn += u32::from(found.len() == 0 && age.is_some_and(|age| age >= UNBORN));
    }
    let size = format!("{count} files, {} KiB in {}", bytes >> 10, shared.display());
    let lock = canonical.join("lock");
    let access = std::fs::metadata(&lock).map_err(|error| error.kind());
    if access.is_err_and(|kind| kind == ErrorKind::PermissionDenied) {
        return Finding::ok(
            what,
            format!("{size}; we may not see whether they are in use"),
        );
    }
    let path = directory.display();
    let remedy = format!("any process that joins clears them away: vpcctl --domain {path} status");
    match (holders(&lock).is_empty(), count, unborn) {
        (_, 0, _) => Finding::ok(what, "none"),
        (false, _, 0) => Finding::ok(what, format!("none; {size} are in use")),
        (false, _, _) => {
            let words = format!("{unborn} of a process killed at its start, beside {size}");
            Finding::warn(what, words, remedy)
        }
        (true, _, _) => Finding::warn(what, format!("{size}, and nobody uses them"), remedy),
    }
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::PermissionsExt;

    use super::super::Verdict;
    use super::*;

    #[test]
    fn owner_and_mode_of_the_directory_are_judged() {
        let us = rustix::process::geteuid().as_raw();
        let parent = tempfile::tempdir().unwrap();
        let directory = parent.path().join("domain");
        assert_eq!(place(&directory, us).verdict, Verdict::Ok);
        std::fs::create_dir(&directory).unwrap();
        let judged = |mode| {
            std::fs::set_permissions(&directory, PermissionsExt::from_mode(mode)).unwrap();
            place(&directory, us).verdict
        };
        assert_eq!(judged(0o777), Verdict::Fail);
        assert_eq!(judged(0o755), Verdict::Warn);
        assert_eq!(judged(0o700), Verdict::Ok);
        let other = place(&directory, us + 1);
        assert!(
            other.remedy.contains(&format!("sudo -u '#{us}'")),
            "{other:?}"
        );
        let link = parent.path().join("link");
        std::os::unix::fs::symlink(&directory, &link).unwrap();
        assert_eq!(place(&link, us).verdict, Verdict::Fail);
    }

    #[test]
    fn what_nobody_uses_is_left_over() {
        let directory = tempfile::tempdir().unwrap();
        let shared = tempfile::tempdir().unwrap();
        let look = || leftovers(directory.path(), shared.path());
        assert_eq!(look().verdict, Verdict::Ok);
        let canonical = directory.path().canonicalize().unwrap();
        let name = format!("{}x", ipc::shared_memory_prefix(&canonical));
        std::fs::write(shared.path().join(name), [0; 2048]).unwrap();
        std::fs::write(shared.path().join("vpc_0123456789abcdef_x"), [0; 2048]).unwrap();
        assert_eq!(look().verdict, Verdict::Warn);
        assert!(look().found.starts_with("1 files, 2 KiB"), "{:?}", look());
        let lock = std::fs::File::create(directory.path().join("lock")).unwrap();
        lock.lock_shared().unwrap();
        assert_eq!(look().verdict, Verdict::Ok, "{:?}", look());
    }

    #[test]
    fn the_services_domain_is_pointed_out() {
        let (asked, service) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        let finding = elsewhere(asked.path(), service.path()).unwrap();
        assert!(finding.remedy.contains("sudo -u vpcd"), "{finding:?}");
        assert_eq!(elsewhere(service.path(), service.path()), None);
        assert_eq!(elsewhere(asked.path(), &service.path().join("none")), None);
    }
}
