//! The stop: `D/stop`, a file of 64 bytes in the domain's directory. Whoever may write it can stop
//! the camera; there is no lock to take, no place to find and no queue to wait in.
//!
//! | Bytes | Written by | Meaning |
//! |---|---|---|
//! | 0 to 31 | whoever stops | the stop that is asked for |
//! | 32 to 63 | the controller | the stop that it obeyed, once the zero twist is sent |
//!
//! The controller leaves the file with both halves equal and with [`OBEYED_AT`] as its time of last
//! change. It writes its own half alone, so that a stop that is asked for meanwhile stays so.
//! Anything else at this path is a stop: other bytes, another length, another time (so the same
//! words twice, or `touch`), another file, none. The controller looks in each cycle, after the
//! requests of operators, so that a stop wins over an `arm` of the same cycle. A stop that was
//! asked for while no controller ran is obeyed by the next one. The file is read and not mapped: a
//! shell's `>` truncates it, and a mapping would end in SIGBUS then.

use std::ffi::{CStr, CString};
use std::fs::{File, OpenOptions};
use std::io;
use std::os::fd::{AsFd, BorrowedFd};
use std::os::unix::ffi::OsStrExt;
use std::os::unix::fs::{FileExt, MetadataExt, OpenOptionsExt};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use rustix::fs::{AtFlags, CWD, OFlags, StatxFlags, Timespec, Timestamps, futimens, statx};
use rustix::process::{Resource, getrlimit};

use crate::clock::now_ns;

/// Name of the file in the domain's directory.
pub const STOP_FILE: &str = "stop";

/// Time of the last change of the file after a stop was obeyed: the beginning of 1970. Any other
/// write changes it.
const OBEYED_AT: Time = (0, 0);
/// Bytes of each half, and of both.
const HALF: usize = 32;
const BOTH: usize = 2 * HALF;
/// Polling interval while waiting for the stop to be obeyed.
const POLL: Duration = Duration::from_millis(2);

type Content = [u8; HALF];

/// The controller's end.
#[derive(Debug)]
pub struct StopFile {
    file: File,
    /// Where whoever stops looks for it: the path from the root, for the system call.
    path: CString,
    /// Device, as major and minor number, and inode of the open file.
    place: (u32, u32, u64),
    /// What is asked for, and the time of the last change when that was read.
    asked: Content,
    changed: Time,
}

impl StopFile {
    /// Opens the file in the directory of a domain, or creates it, writable by its owner alone. The
    /// file's permissions say which other users may stop; they are kept. From then on it has its
    /// room on the disk, so that a stop needs none.
    ///
    /// # Errors
    /// [`StopError::File`] if it cannot be used, is no plain file, has another name (a hard link)
    /// or is another user's, or if the disk has no room for it.
    pub fn open(directory: &Path) -> Result<Self, StopError> {
        let path = directory.join(STOP_FILE);
        let refuse = |source| StopError::File {
            path: path.clone(),
            source,
        };
        let mut options = OpenOptions::new();
        options
            .read(true)
            .write(true)
            .mode(0o600)
            .custom_flags((OFlags::NOFOLLOW | OFlags::NONBLOCK).bits() as i32);
        let (file, is_new) = match options.clone().create_new(true).open(&path) {
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {
                (options.open(&path).map_err(refuse)?, false)
            }
            result => (result.map_err(refuse)?, true),
        };
        let found = file.metadata().map_err(refuse)?;
        if !found.is_file() {
            return Err(refuse(io::Error::other("not a plain file; remove it")));
        }
        if found.nlink() > 1 {
            let reason = "has another name, which a stop would write to; remove it";
            return Err(refuse(io::Error::other(reason)));
        }
        let (owner, us) = (found.uid(), rustix::process::geteuid().as_raw());
        if owner != us {
            let reason = format!("belongs to user {owner}, not to user {us}; remove it");
            return Err(refuse(io::Error::other(reason)));
        }
        let absolute = std::path::absolute(&path).map_err(refuse)?;
        let absolute =
            CString::new(absolute.as_os_str().as_bytes()).map_err(|error| refuse(error.into()))?;
        let (asked, _) = read(&file).map_err(refuse)?;
        let (place, changed, _) = place(&absolute).map_err(refuse)?;
        let this = Self {
            place,
            path: absolute,
            file,
            asked,
            changed,
        };
        // A file that is there is as it was obeyed, or asks for a stop; to write it could undo one.
        if is_new {
            this.write_obeyed().map_err(refuse)?;
            this.file.sync_all().map_err(refuse)?;
        }
        Ok(this)
    }

    /// Whether a stop was asked for that was not obeyed yet. Two system calls; neither allocates
    /// nor waits. Also true where the file cannot be read, or the domain's path leads to another
    /// one or to none: nobody could stop any more.
    pub fn is_asked(&mut self) -> bool {
        let in_place = place(&self.path).ok().filter(|found| found.0 == self.place);
        let is_in_place = in_place.is_some();
        // Where the file was moved, who asks there is answered, too.
        let found = in_place.map_or_else(|| of(&self.file), Ok);
        // The time first: what changes afterwards is newer.
        let (Ok((_, changed, length)), Ok((asked, obeyed))) = (found, read(&self.file)) else {
            return true;
        };
        (self.asked, self.changed) = (asked, changed);
        let is_as_left = changed == OBEYED_AT && length == BOTH as u64;
        !is_in_place || !is_as_left || obeyed != Some(asked)
    }

    /// Acknowledges what [`StopFile::is_asked`] saw: the zero twist is sent. Where that cannot be
    /// written, the stop stays asked for.
    pub fn obey(&mut self) {
        // The process that asked reports that the answer did not come.
        let _ = self.write_obeyed();
    }

    fn write_obeyed(&self) -> io::Result<()> {
        let (_, changed, _) = of(&self.file)?;
        self.file.write_all_at(&self.asked, HALF as u64)?;
        self.file.set_len(BOTH as u64)?;
        if changed != self.changed {
            // By whoever asked since: the same words again, or `touch`.
            return Ok(());
        }
        let (tv_sec, tv_nsec) = (OBEYED_AT.0, OBEYED_AT.1.into());
        let time = Timespec { tv_sec, tv_nsec };
        let times = Timestamps {
            last_access: time,
            last_modification: time,
        };
        Ok(futimens(&self.file, &times)?)
    }
}

/// A time of last change: s since 1970, and ns.
type Time = (i64, u32);

/// Of a file: device and inode, time of the last change, length.
type Found = ((u32, u32, u64), Time, u64);

/// What is at a path.
fn place(path: &CStr) -> io::Result<Found> {
    look(CWD, path, AtFlags::SYMLINK_NOFOLLOW)
}

/// The same of an open file, wherever it is.
fn of(file: &File) -> io::Result<Found> {
    look(file.as_fd(), c"", AtFlags::EMPTY_PATH)
}

/// Asks no server where the file system has one.
fn look(at: BorrowedFd, path: &CStr, how: AtFlags) -> io::Result<Found> {
    let flags = how | AtFlags::STATX_DONT_SYNC;
    let wanted = StatxFlags::INO | StatxFlags::MTIME | StatxFlags::SIZE;
    let found = statx(at, path, flags, wanted)?;
    let changed = (found.stx_mtime.tv_sec, found.stx_mtime.tv_nsec);
    let device = (found.stx_dev_major, found.stx_dev_minor);
    let place = (device.0, device.1, found.stx_ino);
    Ok((place, changed, found.stx_size))
}

/// Why a stop is not known to have been obeyed.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs)]
pub enum StopError {
    /// The file cannot be used.
    #[error("{}: cannot stop by it: {source}", path.display())]
    File { path: PathBuf, source: io::Error },
    /// No controller has obeyed it in time.
    #[error(
        "{}: asked for a stop, which no vpcd obeyed within {seconds} s; it stays asked for, and the next vpcd of this domain begins disarmed",
        path.display()
    )]
    NotObeyed { path: PathBuf, seconds: f64 },
}

/// A stop that was asked for.
#[derive(Debug)]
pub struct Asked {
    file: File,
    path: PathBuf,
}

impl Asked {
    /// Asks for a stop in the domain of this directory, which need not be joined. Does not wait.
    /// Where the file cannot be written, as on a full disk that copies on write, or beyond the
    /// limit on the size of files (`ulimit -f`), it is emptied, and where that fails, removed: both
    /// are stops.
    ///
    /// # Errors
    /// [`StopError::File`] if there is no such file, or nothing of it may be changed.
    pub fn in_domain(directory: &Path) -> Result<Self, StopError> {
        let path = directory.join(STOP_FILE);
        let open = || {
            let file = OpenOptions::new().read(true).write(true).open(&path)?;
            let mut word = Content::default();
            let text = format!("{} {}", std::process::id(), now_ns());
            let pairs = word.iter_mut().zip(text.bytes());
            pairs.for_each(|(to, from)| *to = from);
            // Beyond it a write would end a program that does not ignore SIGXFSZ.
            let most = getrlimit(Resource::Fsize).current;
            let written = match most.is_none_or(|most| most >= HALF as u64) {
                true => file.write_all_at(&word, 0),
                false => Err(io::ErrorKind::FileTooLarge.into()),
            };
            written
                .or_else(|_| file.set_len(0))
                .or_else(|_| std::fs::remove_file(&path))?;
            Ok(file)
        };
        match open() {
            Ok(file) => Ok(Self { file, path }),
            Err(source) => Err(StopError::File { path, source }),
        }
    }

    /// Whether the controller has sent the zero twist since.
    ///
    /// # Errors
    /// [`StopError::File`] if the file cannot be read.
    pub fn is_obeyed(&self) -> Result<bool, StopError> {
        match read(&self.file) {
            // What another one asked for since then is as good.
            Ok((asked, obeyed)) => Ok(obeyed == Some(asked)),
            Err(source) => Err(StopError::File {
                path: self.path.clone(),
                source,
            }),
        }
    }

    /// That no controller has obeyed it for so long.
    pub fn not_obeyed(&self, after: Duration) -> StopError {
        StopError::NotObeyed {
            path: self.path.clone(),
            seconds: (after.as_secs_f64() * 1e3).round() / 1e3,
        }
    }
}

/// Asks for a stop in the domain of this directory, and waits until the controller has sent the
/// zero twist, `patience` at most. Returns how long that took.
///
/// # Errors
/// [`StopError`].
pub fn stop(directory: &Path, patience: Duration) -> Result<Duration, StopError> {
    let begin = Instant::now();
    let asked = Asked::in_domain(directory)?;
    while !asked.is_obeyed()? {
        if begin.elapsed() >= patience {
            return Err(asked.not_obeyed(patience));
        }
        std::thread::sleep(POLL);
    }
    Ok(begin.elapsed())
}

/// What is asked for, and what was obeyed: `None` while the file is too short for it.
fn read(file: &File) -> io::Result<(Content, Option<Content>)> {
    let mut both = [0; BOTH];
    let count = file.read_at(&mut both, 0)?;
    let (asked, obeyed) = both.split_at(HALF);
    let half = |bytes: &[u8]| {
        let mut content = Content::default();
        content.copy_from_slice(bytes);
        content
    };
    Ok((half(asked), (count == both.len()).then(|| half(obeyed))))
}

#[cfg(test)]
mod tests {

    use super::*;

    const SHORT: Duration = Duration::from_millis(20);

    #[test]
    fn each_change_asks_once() {
        let domain = tempfile::tempdir().unwrap();
        let mut controller = StopFile::open(domain.path()).unwrap();
        assert!(!controller.is_asked());
        for _ in 0..3 {
            assert!(matches!(
                stop(domain.path(), SHORT),
                Err(StopError::NotObeyed { .. })
            ));
            assert!(controller.is_asked() && controller.is_asked());
            controller.obey();
            assert!(!controller.is_asked());
        }
    }

    #[test]
    fn who_asks_learns_that_it_was_obeyed() {
        let domain = tempfile::tempdir().unwrap();
        let mut controller = StopFile::open(domain.path()).unwrap();
        let asks: Vec<_> = (0..8)
            .map(|_| {
                let directory = domain.path().to_owned();
                std::thread::spawn(move || stop(&directory, Duration::from_secs(10)))
            })
            .collect();
        while asks.iter().any(|ask| !ask.is_finished()) {
            if controller.is_asked() {
                controller.obey();
            }
            std::thread::sleep(SHORT);
        }
        for ask in asks {
            ask.join().unwrap().unwrap();
        }
    }

    #[test]
    fn a_stop_that_nobody_obeyed_waits_for_the_next_controller() {
        let domain = tempfile::tempdir().unwrap();
        drop(StopFile::open(domain.path()).unwrap());
        let message = stop(domain.path(), SHORT).unwrap_err().to_string();
        assert!(
            message.contains("next vpcd of this domain begins disarmed"),
            "{message}"
        );
        let mut controller = StopFile::open(domain.path()).unwrap();
        assert!(controller.is_asked());
        controller.obey();
        drop(controller);
        assert!(!StopFile::open(domain.path()).unwrap().is_asked());
    }

    #[test]
    fn a_shell_stops_with_what_it_has() {
        let domain = tempfile::tempdir().unwrap();
        let mut controller = StopFile::open(domain.path()).unwrap();
        let shell = |line: &str| {
            let mut shell = testkit::command("sh");
            let status = shell.args(["-c", line]).current_dir(domain.path()).status();
            assert!(status.unwrap().success(), "{line}");
        };
        for line in [
            "date +%s%N > stop",
            "printf %s $$ | dd of=stop conv=notrunc status=none",
            "printf %s $$ >> stop",
            ": > stop",
            "echo stop > stop",
            "cp -p stop same && cp same stop",
            "touch stop",
        ] {
            // The same words again are a stop again.
            for _ in 0..2 {
                shell(line);
                assert!(controller.is_asked() && controller.is_asked(), "{line}");
                controller.obey();
                assert!(!controller.is_asked(), "{line}");
                shell("cmp -s -n 32 -i 0:32 stop stop");
            }
        }
        // Also while no controller runs.
        drop(controller);
        assert!(!StopFile::open(domain.path()).unwrap().is_asked());
        shell("touch stop");
        assert!(StopFile::open(domain.path()).unwrap().is_asked());
    }

    #[test]
    fn a_stop_that_comes_while_another_is_obeyed_stays_asked_for() {
        for line in ["echo again > stop", ": > stop", "touch -d yesterday stop"] {
            let domain = tempfile::tempdir().unwrap();
            let mut controller = StopFile::open(domain.path()).unwrap();
            let shell = |line: &str| {
                let mut shell = testkit::command("sh");
                let status = shell.args(["-c", line]).current_dir(domain.path()).status();
                assert!(status.unwrap().success(), "{line}");
            };
            shell("echo first > stop");
            assert!(controller.is_asked());
            shell(line);
            controller.obey();
            assert!(controller.is_asked(), "{line}");
            controller.obey();
            assert!(!controller.is_asked(), "{line}");
        }
        let domain = tempfile::tempdir().unwrap();
        let mut controller = StopFile::open(domain.path()).unwrap();
        Asked::in_domain(domain.path()).unwrap();
        assert!(controller.is_asked());
        let second = Asked::in_domain(domain.path()).unwrap();
        controller.obey();
        assert!(!second.is_obeyed().unwrap() && controller.is_asked());
        controller.obey();
        assert!(second.is_obeyed().unwrap());
    }

    #[test]
    fn who_asks_in_a_domain_that_was_moved_is_answered() {
        let place = tempfile::tempdir().unwrap();
        let [here, there] = ["here", "there"].map(|name| place.path().join(name));
        std::fs::create_dir(&here).unwrap();
        let mut controller = StopFile::open(&here).unwrap();
        std::fs::rename(&here, &there).unwrap();
        let asked = Asked::in_domain(&there).unwrap();
        assert!(controller.is_asked());
        controller.obey();
        assert!(asked.is_obeyed().unwrap() && controller.is_asked());
    }

    #[test]
    fn a_file_with_another_name_is_refused_and_not_written() {
        let domain = tempfile::tempdir().unwrap();
        let other = domain.path().join("precious");
        std::fs::write(&other, "precious").unwrap();
        std::fs::hard_link(&other, domain.path().join(STOP_FILE)).unwrap();
        let message = StopFile::open(domain.path()).unwrap_err().to_string();
        assert!(message.contains("has another name"), "{message}");
        assert_eq!(std::fs::read(other).unwrap(), b"precious");
    }

    #[test]
    fn how_long_it_waited_is_told_in_milliseconds() {
        let domain = tempfile::tempdir().unwrap();
        drop(StopFile::open(domain.path()).unwrap());
        let asked = Asked::in_domain(domain.path()).unwrap();
        let message = asked.not_obeyed(Duration::from_nanos(1_999_999_690));
        assert!(message.to_string().contains("within 2 s;"), "{message}");
    }

    #[test]
    fn a_file_that_was_moved_linked_or_replaced_is_a_stop() {
        for line in [
            "mv d/stop d/elsewhere",
            "ln d/stop d/backup; rm d/stop",
            "rm d/stop; cp -p d/before d/stop",
            "mv d moved",
            "mv d moved; cp -rp moved d",
        ] {
            let place = tempfile::tempdir().unwrap();
            let directory = place.path().canonicalize().unwrap().join("d");
            std::fs::create_dir(&directory).unwrap();
            let mut controller = StopFile::open(&directory).unwrap();
            let shell = |line: &str| {
                let mut shell = testkit::command("sh");
                let status = shell.args(["-c", line]).current_dir(place.path()).status();
                assert!(status.unwrap().success(), "{line}");
            };
            shell("cp -p d/stop d/before");
            assert!(!controller.is_asked());
            shell(line);
            assert!(controller.is_asked(), "{line}");
            controller.obey();
            assert!(
                controller.is_asked(),
                "{line}: nobody could stop it any more"
            );
        }
        // The same file by another way is the same file.
        let place = tempfile::tempdir().unwrap();
        let [directory, moved] = ["d", "moved"].map(|name| place.path().join(name));
        std::fs::create_dir(&directory).unwrap();
        let mut controller = StopFile::open(&directory).unwrap();
        std::fs::rename(&directory, &moved).unwrap();
        std::os::unix::fs::symlink(&moved, &directory).unwrap();
        assert!(!controller.is_asked());
    }

    #[test]
    fn without_its_file_it_is_stopped() {
        let domain = tempfile::tempdir().unwrap();
        let file = domain.path().join(STOP_FILE);
        let mut controller = StopFile::open(domain.path()).unwrap();
        // As many editors write.
        std::fs::write(domain.path().join("new"), "now").unwrap();
        std::fs::rename(domain.path().join("new"), &file).unwrap();
        assert!(controller.is_asked());
        controller.obey();
        assert!(controller.is_asked());
        std::fs::remove_file(&file).unwrap();
        let message = stop(domain.path(), SHORT).unwrap_err().to_string();
        assert!(
            message.contains("/stop: cannot stop by it: No such file"),
            "{message}"
        );
        std::fs::create_dir(&file).unwrap();
        assert!(matches!(
            StopFile::open(domain.path()),
            Err(StopError::File { .. })
        ));
    }
}
