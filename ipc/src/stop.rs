//! The stop: `D/stop`, a file of 64 bytes in the domain's directory. Whoever may write it can stop
//! the camera; there is no lock to take, no place to find and no queue to wait in.
//!
//! | Bytes | Written by | Meaning |
//! |---|---|---|
//! | 0 to 31 | whoever stops | any other content than before asks for a stop |
//! | 32 to 63 | the controller | the content that it obeyed, once the zero twist is sent |
//!
//! Bytes beyond the file's end count as zero. The controller reads the file in each cycle, after
//! the requests of operators, so that a stop wins over an `arm` of the same cycle. A stop that was
//! asked for while no controller ran is obeyed by the next one. The file is read and not mapped: a
//! shell's `>` truncates it, and a mapping would end in SIGBUS then.

use std::fs::{File, OpenOptions};
use std::io;
use std::os::unix::fs::{FileExt, MetadataExt, OpenOptionsExt};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use rustix::fs::OFlags;

/// Name of the file in the domain's directory.
pub const STOP_FILE: &str = "stop";

/// Bytes of each half.
const HALF: usize = 32;
/// Pause between two looks of who waits.
const POLL: Duration = Duration::from_millis(2);

type Content = [u8; HALF];

/// The controller's end.
#[derive(Debug)]
pub struct StopFile {
    file: File,
    /// What was obeyed last,
    obeyed: Content,
    /// and what stands there now.
    asked: Content,
}

impl StopFile {
    /// Opens the file in the directory of a domain, or creates it, writable by its owner alone. Who
    /// else may stop is for its permissions to say; they are kept.
    ///
    /// # Errors
    /// [`StopError::File`] if it cannot be used, or is no plain file.
    pub fn open(directory: &Path) -> Result<Self, StopError> {
        let path = directory.join(STOP_FILE);
        let refuse = |source| StopError::File {
            path: path.clone(),
            source,
        };
        let file = OpenOptions::new()
            .create(true)
            .truncate(false)
            .read(true)
            .write(true)
            .mode(0o600)
            .custom_flags((OFlags::NOFOLLOW | OFlags::NONBLOCK).bits() as i32)
            .open(&path)
            .map_err(refuse)?;
        if !file.metadata().map_err(refuse)?.is_file() {
            return Err(refuse(io::Error::other("not a plain file; remove it")));
        }
        let (asked, obeyed) = read(&file).map_err(refuse)?;
        Ok(Self {
            file,
            obeyed: obeyed.unwrap_or_default(),
            asked,
        })
    }

    /// Whether a stop was asked for that was not obeyed yet. Two system calls; neither allocates
    /// nor waits. Also true where the file cannot be read, or was removed or replaced: nobody could
    /// stop any more.
    pub fn is_asked(&mut self) -> bool {
        let is_there = self.file.metadata().is_ok_and(|found| found.nlink() > 0);
        let Ok((asked, _)) = read(&self.file) else {
            return true;
        };
        self.asked = asked;
        !is_there || self.asked != self.obeyed
    }

    /// Acknowledges what [`StopFile::is_asked`] saw: the zero twist is sent.
    pub fn obey(&mut self) {
        self.obeyed = self.asked;
        // Who waits for it will say that it did not come.
        let _ = self.file.write_at(&self.obeyed, HALF as u64);
    }
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
    ///
    /// # Errors
    /// [`StopError::File`] if there is no such file, or it may not be written.
    pub fn in_domain(directory: &Path) -> Result<Self, StopError> {
        let path = directory.join(STOP_FILE);
        let open = || {
            let file = OpenOptions::new().read(true).write(true).open(&path)?;
            let mut word = Content::default();
            let text = format!("{} {}", std::process::id(), crate::now_ns());
            let pairs = word.iter_mut().zip(text.bytes());
            pairs.for_each(|(to, from)| *to = from);
            file.write_all_at(&word, 0)?;
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
            seconds: after.as_secs_f64(),
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
    let mut both = [0; 2 * HALF];
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
            "date +%s%N > stop",
            "printf %s $$ | dd of=stop conv=notrunc status=none",
            ": > stop",
        ] {
            shell(line);
            assert!(controller.is_asked(), "{line}");
            controller.obey();
            assert!(!controller.is_asked(), "{line}");
            shell("cmp -s -n 32 -i 0:32 stop stop");
        }
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
