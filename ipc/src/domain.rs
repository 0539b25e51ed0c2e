//! A domain: one set of the contract's services, in a directory of its own.

use std::any::Any;
use std::fs::{DirEntry, File, OpenOptions};
use std::io::{self, Read, Write};
use std::os::unix::ffi::OsStrExt;
use std::os::unix::fs::{MetadataExt, OpenOptionsExt};
use std::path::{Path, PathBuf};
use std::rc::Rc;
use std::time::Duration;

use iceoryx2::node::{Node, NodeBuilder};
use iceoryx2::prelude::{Config, FileName, SemanticString, SignalHandlingMode};
use iceoryx2::service::ipc::Service;
use messages::Message;

use crate::error::{JoinError, JoinReason, OpenError};
use crate::guard::{Guard, Place, Startup};
use crate::service::{self, OpenService};

/// Where Linux keeps POSIX shared memory.
const SHARED_MEMORY: &str = "/dev/shm";

/// Least room in shared memory with which a process joins or opens a port, bytes: what each of that
/// takes at once is tens of kilobytes. iceoryx2 gives files a size and no pages; where there are
/// none left, the kernel ends by SIGBUS whoever writes.
const ROOM: u64 = 1 << 20;

/// Age from which on shared memory of size 0 counts as left by a killed process: its creator gives
/// it a size at once.
const UNFINISHED: Duration = Duration::from_millis(300);

/// Membership of a domain. Cheap to clone; ports keep it alive. Stays in the thread that made it: a
/// second thread joins for itself.
#[derive(Clone, Debug)]
pub struct Domain {
    pub(crate) shared: Rc<Shared>,
}

/// What leaves the domain when the last port is gone.
#[derive(Debug)]
pub(crate) struct Shared {
    services: Vec<Box<dyn OpenService>>,
    node: Option<Node<Service>>,
    config: Config,
    prefix: String,
    guard: Guard,
}

impl Drop for Shared {
    fn drop(&mut self) {
        // The last user removes a service: not while another process is opening it. If that process
        // is stopped, leave all the same.
        let startup = self.guard.startup();
        self.services.clear();
        drop(self.node.take());
        if let Ok(startup) = startup {
            // What cannot be removed now, the next process that joins removes.
            let _ = self.guard.leave(&startup, wipe);
        }
    }
}

/// The default directory: `/tmp/vpc-<uid>`.
pub fn default_directory() -> PathBuf {
    PathBuf::from(format!("/tmp/vpc-{}", rustix::process::geteuid().as_raw()))
}

impl Domain {
    /// How many files of shared memory a domain has at the moment. It need not be joined for that.
    ///
    /// # Errors
    /// The directory does not exist, nobody ever joined it, or shared memory cannot be listed.
    pub fn segments(directory: &Path) -> io::Result<usize> {
        Ok(ours(&shared_memory_prefix(directory)?)?.count())
    }

    /// Joins the domain in `directory`, which is created if it is missing. Removes what killed
    /// participants left.
    ///
    /// # Errors
    /// [`JoinError`] names the directory and the reason.
    pub fn join(directory: &Path) -> Result<Self, JoinError> {
        Self::try_join(directory).map_err(|reason| JoinError {
            directory: directory.display().to_string(),
            reason,
        })
    }

    fn try_join(directory: &Path) -> Result<Self, JoinReason> {
        let (guard, _startup) = Guard::enter(directory, |directory| {
            wipe(directory)?;
            begin_generation(directory)
        })?;
        let prefix = shared_memory_prefix(guard.directory())?;
        let config = configuration(guard.directory(), &prefix).ok_or(JoinReason::Path)?;
        remove_unfinished(&prefix);
        has_room()?;
        let open = || -> Result<_, JoinReason> {
            let node = NodeBuilder::new()
                .config(&config)
                .signal_handling_mode(SignalHandlingMode::Disabled)
                .create::<Service>()?;
            Ok((service::open_all(&node)?, node))
        };
        let (services, node) = open().map_err(|reason| match is_full(guard.directory()) {
            true => JoinReason::FullDisk(Box::new(reason)),
            false => reason,
        })?;
        let shared = Rc::new(Shared {
            services,
            node: Some(node),
            config,
            prefix,
            guard,
        });
        Ok(Self { shared })
    }

    /// The directory, canonical.
    pub fn directory(&self) -> &Path {
        self.shared.guard.directory()
    }
}

impl Shared {
    /// The right to open a port.
    pub(crate) fn startup(&self) -> Result<Startup, OpenError> {
        let startup = self.guard.startup();
        let startup = startup.map_err(|reason| self.error(reason))?;
        has_room().map_err(|reason| self.error(reason))?;
        Ok(startup)
    }

    /// Takes a place among the publishers of `T`.
    pub(crate) fn place<T: Message>(&self, startup: &Startup) -> Result<Place, OpenError> {
        let (service, most) = (T::SERVICE, T::QOS.publishers);
        let place = Place::take(&self.guard, startup, service, most);
        let place = place.map_err(|error| self.error(error.into()))?;
        place.ok_or_else(|| OpenError::Taken {
            service,
            domain: self.directory(),
            most,
        })
    }

    /// Opens a port of the service `F` that carries `T`. If iceoryx2 refuses, removes what killed
    /// participants left and tries again.
    pub(crate) fn open<T: Message, F: OpenService, P>(
        &self,
        _startup: &Startup,
        create: impl Fn(&F) -> Result<P, OpenError>,
    ) -> Result<P, OpenError> {
        let mut services = self.services.iter();
        let factory =
            services.find_map(|service| (service.as_ref() as &dyn Any).downcast_ref::<F>());
        let factory = factory.ok_or_else(|| OpenError::Port {
            service: T::SERVICE,
            reason: "no service of the contract".to_owned(),
        })?;
        create(factory).or_else(|_| {
            remove_unfinished(&self.prefix);
            Node::<Service>::try_cleanup_dead_nodes(&self.config);
            create(factory)
        })
    }

    fn error(&self, reason: JoinReason) -> JoinError {
        JoinError {
            directory: self.directory(),
            reason,
        }
    }

    fn directory(&self) -> String {
        self.guard.directory().display().to_string()
    }
}

/// iceoryx2's configuration, made here and not read from a file, with a root and a prefix that no
/// other domain has.
fn configuration(directory: &Path, prefix: &str) -> Option<Config> {
    let bytes = directory.as_os_str().as_bytes();
    if bytes.len() > 200 {
        return None;
    }
    let root = directory.join("iox2");
    let mut config = Config::default();
    config
        .global
        .set_root_path(&iceoryx2::prelude::Path::new(root.as_os_str().as_bytes()).ok()?);
    config.global.prefix = FileName::new(prefix.as_bytes()).ok()?;
    // Only under the guard: while joining, or opening a port.
    config.global.node.cleanup_dead_nodes_on_destruction = false;
    Some(config)
}

/// Name of the file in the domain's directory that holds its generation: a random number, drawn by
/// each process that finds nobody else in the domain. A domain whose directory was moved takes its
/// generation along, and no other user knows a name of shared memory before it is taken.
const GENERATION: &str = "generation";

/// Draws the number. Call this only while no other process is in the domain.
fn begin_generation(directory: &Path) -> io::Result<()> {
    let mut drawn = [0; 8];
    File::open("/dev/urandom")?.read_exact(&mut drawn)?;
    let text = format!("{:016x}\n", u64::from_le_bytes(drawn));
    let mut options = OpenOptions::new();
    let options = options.create(true).truncate(true).write(true).mode(0o600);
    options
        .open(directory.join(GENERATION))?
        .write_all(text.as_bytes())
}

/// Begin of the names of a domain's shared memory: `vpc_`, the 16 hexadecimal digits of its
/// generation, `_`.
///
/// # Errors
/// The file cannot be read, or holds something else.
pub fn shared_memory_prefix(directory: &Path) -> io::Result<String> {
    let path = directory.join(GENERATION);
    let trouble = |error: io::Error| {
        let text = format!("{}: {error}", path.display());
        io::Error::new(error.kind(), text)
    };
    let mut text = String::new();
    let file = File::open(&path).map_err(trouble)?;
    file.take(32).read_to_string(&mut text).map_err(trouble)?;
    match text.trim_end() {
        digits if digits.len() == 16 && digits.bytes().all(|b| b.is_ascii_hexdigit()) => {
            Ok(format!("vpc_{digits}_"))
        }
        text => Err(trouble(io::Error::new(
            io::ErrorKind::InvalidData,
            format!(
                "{text:?}; allowed: 16 hexadecimal digits; stop every process of this domain, then start again"
            ),
        ))),
    }
}

/// Removes what dead processes left: our root, and our files in shared memory. Call this only while
/// no other process is in the domain.
fn wipe(directory: &Path) -> io::Result<()> {
    let gone = |result: io::Result<()>| match result {
        Err(error) if error.kind() != io::ErrorKind::NotFound => Err(error),
        _ => Ok(()),
    };
    gone(std::fs::remove_dir_all(directory.join("iox2")))?;
    // A new domain has no generation yet; one that was damaged is replaced.
    let Ok(prefix) = shared_memory_prefix(directory) else {
        return Ok(());
    };
    ours(&prefix)?.try_for_each(|entry| gone(std::fs::remove_file(entry.path())))
}

/// Checks that shared memory has room for what a process writes when it joins or opens a port.
fn has_room() -> Result<(), JoinReason> {
    let Ok(found) = rustix::fs::statvfs(SHARED_MEMORY) else {
        return Ok(());
    };
    let (free, needed) = (found.f_bavail.saturating_mul(found.f_frsize), ROOM);
    // A tmpfs without a limit has no blocks.
    match found.f_blocks > 0 && free < needed {
        true => Err(JoinReason::NoRoom { free, needed }),
        false => Ok(()),
    }
}

/// Whether the disk of this directory has no room, or no room for another file.
fn is_full(directory: &Path) -> bool {
    rustix::fs::statvfs(directory).is_ok_and(|found| {
        (found.f_blocks > 0 && found.f_bavail == 0) || (found.f_files > 0 && found.f_favail == 0)
    })
}

/// The files in shared memory with this prefix that belong to this user. Others' are not ours,
/// whatever they are called.
fn ours(prefix: &str) -> io::Result<impl Iterator<Item = DirEntry>> {
    let us = rustix::process::geteuid().as_raw();
    let entries = std::fs::read_dir(SHARED_MEMORY)?.filter_map(Result::ok);
    Ok(entries.filter(move |entry| {
        let is_named = entry.file_name().as_bytes().starts_with(prefix.as_bytes());
        is_named && entry.metadata().is_ok_and(|found| found.uid() == us)
    }))
}

/// Removes shared memory of size 0 that is old enough to have been left by a killed process.
/// Returns how many files are too young to tell.
fn remove_old(prefix: &str) -> usize {
    let unfinished = ours(prefix).into_iter().flatten().filter_map(|entry| {
        let found = entry.metadata().ok().filter(|found| found.len() == 0)?;
        let age = found.modified().ok().and_then(|at| at.elapsed().ok());
        let is_old = age.is_some_and(|age| age >= UNFINISHED);
        if is_old {
            // Another process may have been faster.
            let _ = std::fs::remove_file(entry.path());
        }
        Some(is_old)
    });
    unfinished.filter(|is_old| !is_old).count()
}

/// Waits until every file of size 0 has a size or is old, and removes the old ones. There is almost
/// never one.
fn remove_unfinished(prefix: &str) {
    let pause = Duration::from_millis(5);
    for _ in 0..2 * UNFINISHED.as_millis() / pause.as_millis() {
        if remove_old(prefix) == 0 {
            return;
        }
        std::thread::sleep(pause);
    }
}

#[cfg(test)]
mod tests {
    use iceoryx2::prelude::ZeroCopySend;
    use messages::{Features, Wire};

    use super::*;

    #[test]
    fn each_generation_has_its_prefix() {
        let directory = tempfile::tempdir().unwrap();
        let prefix = || shared_memory_prefix(directory.path());
        assert_eq!(prefix().unwrap_err().kind(), io::ErrorKind::NotFound);
        let drawn = [(); 2].map(|()| {
            begin_generation(directory.path()).unwrap();
            prefix().unwrap()
        });
        assert_ne!(drawn[0], drawn[1]);
        assert_eq!(drawn[0].len(), 21);
        for damaged in ["", "12", "+123456789012345", "dab3ee1dc20aec86x"] {
            std::fs::write(directory.path().join(GENERATION), damaged).unwrap();
            let message = prefix().unwrap_err().to_string();
            assert!(message.contains("generation: "), "{message}");
            // The only process in the domain mends it.
            Domain::join(directory.path()).unwrap();
            assert!(prefix().is_ok());
        }
    }

    #[test]
    fn a_path_that_iceoryx2_cannot_take_is_refused() {
        let configuration = |path: &str| configuration(Path::new(path), "vpc_0_");
        assert!(configuration("/tmp/vpc-0").is_some());
        assert!(configuration(&format!("/tmp/{}", "x".repeat(200))).is_none());
    }

    #[test]
    fn another_version_is_refused_by_the_names_of_both() {
        #[derive(Debug, ZeroCopySend)]
        #[type_name("vpc/Features/00000000")]
        #[repr(C)]
        struct Other(u64);

        let directory = tempfile::tempdir().unwrap();
        begin_generation(directory.path()).unwrap();
        let prefix = shared_memory_prefix(directory.path()).unwrap();
        let config = configuration(directory.path(), &prefix).unwrap();
        let node = NodeBuilder::new().config(&config).create::<Service>();
        let node = node.unwrap();
        let name = Features::SERVICE.try_into().unwrap();
        let other = node.service_builder(&name).publish_subscribe::<Other>();
        let _other = other.create().unwrap();
        let message = service::open_all(&node).unwrap_err().to_string();
        let both = format!(
            "vpc/features is of another version of the contract: vpc/Features/00000000; \
             this program's: {}; stop",
            Features::TYPE_NAME
        );
        assert!(message.starts_with(&both), "{message}");
    }
}
