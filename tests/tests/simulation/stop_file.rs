//! The stop file of the domain, a real one in a directory of its own, and hands that change it.

use std::fs::{self, File, OpenOptions};
use std::io::Write;
use std::path::PathBuf;

use ipc::{STOP_FILE, StopFile};
use rand::{Rng, RngExt};

/// What a hand does, and whether the file can be used afterwards.
const HANDS: [(Hand, bool); 10] = [
    (Hand::Ask, true),
    (Hand::Write, true),
    (Hand::Empty, true),
    (Hand::Touch, true),
    (Hand::Append, true),
    (Hand::Rename, false),
    (Hand::LinkAndRemove, false),
    (Hand::CopyOver, false),
    (Hand::Remove, false),
    (Hand::MoveDirectory, false),
];

/// One of them.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Hand {
    /// As `vpcctl stop` does.
    Ask,
    /// `date > domain/stop`
    Write,
    /// `: > domain/stop`
    Empty,
    /// `touch domain/stop`
    Touch,
    /// `echo >> domain/stop`
    Append,
    /// `mv domain/stop domain/elsewhere`
    Rename,
    /// `ln domain/stop domain/backup; rm domain/stop`
    LinkAndRemove,
    /// `cp -p domain/stop new; mv new domain/stop`
    CopyOver,
    /// `rm domain/stop`
    Remove,
    /// `mv domain moved`
    MoveDirectory,
}

/// The directory with the daemon's end of the file.
pub struct Domain {
    directory: tempfile::TempDir,
    file: StopFile,
    /// Whether the daemon saw a stop that it has not acknowledged yet.
    is_stopping: bool,
    /// What `vpcctl` asked for.
    asked: Option<ipc::Asked>,
}

impl Domain {
    /// A new one.
    pub fn new() -> Self {
        // In memory: `StopFile` waits for the disk when it begins.
        let memory = tempfile::tempdir_in("/dev/shm");
        let directory = memory.or_else(|_| tempfile::tempdir()).unwrap();
        let domain = directory.path().join("domain");
        fs::create_dir(&domain).unwrap();
        Self {
            file: StopFile::open(&domain).unwrap(),
            directory,
            is_stopping: false,
            asked: None,
        }
    }

    /// Another process opens it.
    pub fn open_again(&mut self) {
        self.file = StopFile::open(&self.domain()).unwrap();
        self.is_stopping = false;
    }

    fn domain(&self) -> PathBuf {
        self.directory.path().join("domain")
    }

    /// `vpcctl stop`.
    pub fn ask(&mut self) {
        self.asked = Some(ipc::Asked::in_domain(&self.domain()).unwrap());
    }

    /// A hand changes the file, one of those after which it can be used if so wanted. Returns
    /// whether it can.
    pub fn change(&mut self, must_be_usable: bool, random: &mut impl Rng) -> bool {
        let (hand, is_usable) = match must_be_usable {
            true => HANDS[random.random_range(0..5)],
            false => HANDS[random.random_range(0..HANDS.len())],
        };
        let (domain, new) = (self.domain(), self.directory.path().join("new"));
        let file = domain.join(STOP_FILE);
        let done = match hand {
            Hand::Ask => {
                self.ask();
                Ok(())
            }
            Hand::Write => fs::write(&file, "Sun Nov 29 13:00:00 UTC 2026\n"),
            Hand::Empty => File::create(&file).map(drop),
            Hand::Touch => {
                let file = File::options().write(true).open(&file).unwrap();
                file.set_modified(std::time::UNIX_EPOCH + std::time::Duration::from_secs(1))
            }
            Hand::Append => OpenOptions::new()
                .append(true)
                .open(&file)
                .and_then(|mut file| file.write_all(b"\n")),
            Hand::Rename => fs::rename(&file, domain.join("elsewhere")),
            Hand::LinkAndRemove => {
                fs::hard_link(&file, domain.join("backup")).and_then(|()| fs::remove_file(&file))
            }
            Hand::CopyOver => {
                let time = fs::metadata(&file).unwrap().modified().unwrap();
                fs::copy(&file, &new).unwrap();
                let copy = File::options().write(true).open(&new).unwrap();
                copy.set_modified(time)
                    .and_then(|()| fs::rename(&new, &file))
            }
            Hand::Remove => fs::remove_file(&file),
            Hand::MoveDirectory => fs::rename(&domain, self.directory.path().join("moved")),
        };
        done.unwrap();
        is_usable
    }

    /// The daemon looks, after it has taken all requests.
    pub fn is_asked(&mut self) -> bool {
        let is_asked = self.file.is_asked();
        self.is_stopping |= is_asked;
        is_asked
    }

    /// The daemon has sent its command.
    pub fn acknowledge(&mut self) {
        if std::mem::take(&mut self.is_stopping) {
            self.file.obey();
        }
    }

    /// Whether `vpcctl` has asked, and knows that it was obeyed.
    pub fn is_confirmed(&self) -> bool {
        let asked = self.asked.as_ref();
        asked.is_some_and(|asked| asked.is_obeyed().unwrap())
    }
}
