//! A domain: one set of the four services, in a directory of its own.

use std::fs::DirEntry;
use std::io;
use std::os::unix::ffi::OsStrExt;
use std::path::{Path, PathBuf};
use std::rc::Rc;
use std::time::Duration;

use iceoryx2::node::{Node, NodeBuilder, NodeCreationFailure};
use iceoryx2::prelude::{Config, FileName, LogLevel, SemanticString, SignalHandlingMode};
use iceoryx2::service::builder::publish_subscribe::{
    PublishSubscribeOpenError, PublishSubscribeOpenOrCreateError,
};
use iceoryx2::service::ipc::Service;
use iceoryx2::service::port_factory::publish_subscribe::PortFactory;

use crate::ghost;
use crate::guard::{Guard, Startup};
use crate::message::Message;
use crate::port::{OpenError, Publisher, Subscriber};
use crate::{CycleRecord, Features, Reply, Request, RobotState, TwistCommand};

/// Most processes in one domain.
const MAX_NODES: usize = 32;
/// Where Linux keeps POSIX shared memory.
const SHARED_MEMORY: &str = "/dev/shm";

/// Age from which on shared memory without a size is taken for the work of a killed process: giving it one is the next
/// thing that its creator does.
const UNBORN: Duration = Duration::from_millis(300);

/// One opened service.
pub type Factory<T> = PortFactory<Service, T, ()>;

/// The services. Everybody opens all of them, so that each exists from the first participant to the last.
#[derive(Debug)]
pub struct Factories {
    pub(crate) features: Factory<Features>,
    pub(crate) twist: Factory<TwistCommand>,
    pub(crate) robot: Factory<RobotState>,
    pub(crate) cycles: Factory<CycleRecord>,
    pub(crate) requests: Factory<Request>,
    pub(crate) replies: Factory<Reply>,
}

/// Why a domain could not be joined.
#[derive(Debug, thiserror::Error)]
pub enum JoinError {
    /// The directory cannot be used.
    #[error("domain {path}: {source}")]
    Directory {
        /// The directory.
        path: String,
        /// The operating system's reason.
        r#source: io::Error,
    },
    /// The directory belongs to somebody else, or is a link.
    #[error("domain {path}: owned by user {owner}; allowed: a directory (no link) of user {us}")]
    NotOurs {
        /// The directory.
        path: String,
        /// Its owner.
        owner: u32,
        /// Who we are.
        us: u32,
    },
    /// Other users may put files into the directory, or take ours away: the locks, and what the services are found by.
    #[error(
        "domain {path}: mode {mode:03o} lets other users put files into it; allowed: mode 700 (chmod 700 {path})"
    )]
    Open {
        /// The directory.
        path: String,
        /// Its permissions.
        mode: u32,
    },
    /// The path is longer than iceoryx2 takes, or not plain.
    #[error(
        "domain {path}: not a usable path; allowed: at most 200 bytes, letters, digits and . - _ /"
    )]
    Path {
        /// The directory.
        path: String,
    },
    /// Another process has been joining or leaving for too long.
    #[error(
        "domain {path}: another process is joining or leaving since {seconds} s; is one stopped? end it, or use another domain"
    )]
    Busy {
        /// The directory.
        path: String,
        /// How long was waited.
        seconds: u64,
    },
    /// iceoryx2 refused the node.
    #[error("domain {path}: no node: {source}")]
    Node {
        /// The directory.
        path: String,
        /// Its reason.
        r#source: NodeCreationFailure,
    },
    /// A service exists with other types or another quality of service.
    #[error(
        "domain {path}: {service} is of another version of the contract; stop every process of this domain first ({source})"
    )]
    OtherContract {
        /// The directory.
        path: String,
        /// The service.
        service: &'static str,
        /// iceoryx2's reason.
        r#source: PublishSubscribeOpenOrCreateError,
    },
    /// A service could not be opened.
    #[error("domain {path}: {service}: {source}")]
    Service {
        /// The directory.
        path: String,
        /// The service.
        service: &'static str,
        /// iceoryx2's reason.
        r#source: PublishSubscribeOpenOrCreateError,
    },
}

/// Membership of a domain. Cheap to clone; ports keep it alive. Stays in the thread that made it: a second thread
/// joins for itself.
#[derive(Clone, Debug)]
pub struct Domain {
    shared: Rc<Shared>,
}

/// What leaves the domain when the last port is gone.
#[derive(Debug)]
pub(crate) struct Shared {
    factories: Option<Factories>,
    node: Option<Node<Service>>,
    config: Config,
    guard: Guard,
}

impl Drop for Shared {
    fn drop(&mut self) {
        // Services are removed by their last user: not while somebody else is opening them. Should that somebody be
        // stopped, leave all the same.
        let startup = self.guard.startup();
        drop(self.factories.take());
        drop(self.node.take());
        if let Ok(startup) = startup {
            // What cannot be removed now, the next one removes.
            let _ = self.guard.leave(&startup, wipe);
        }
    }
}

/// The directory for who names none: `/tmp/vpc-<uid>`.
pub fn default_directory() -> PathBuf {
    PathBuf::from(format!("/tmp/vpc-{}", rustix::process::geteuid().as_raw()))
}

impl Domain {
    /// How many files of shared memory a domain has at the moment; it need not be joined for that.
    ///
    /// # Errors
    /// Where the directory does not exist or shared memory cannot be listed.
    pub fn segments(directory: &Path) -> io::Result<usize> {
        Ok(ours(&directory.canonicalize()?)?.count())
    }

    /// Joins the domain in `directory`, which is created where it is missing. Clears away what killed participants
    /// left behind.
    ///
    /// # Errors
    /// [`JoinError`] names the directory and what stands against it.
    pub fn join(directory: &Path) -> Result<Self, JoinError> {
        iceoryx2::prelude::set_log_level(LogLevel::Error);
        let (guard, _startup) = Guard::enter(directory, wipe)?;
        let path = guard.directory().display().to_string();
        let config = configuration(guard.directory())
            .ok_or_else(|| JoinError::Path { path: path.clone() })?;
        remove_unborn(guard.directory());
        ghost::clean(&config);
        let node = NodeBuilder::new()
            .config(&config)
            .signal_handling_mode(SignalHandlingMode::Disabled)
            .create::<Service>()
            .map_err(|source| JoinError::Node {
                path: path.clone(),
                source,
            })?;
        let factories = Factories {
            features: open(&node, &path)?,
            twist: open(&node, &path)?,
            robot: open(&node, &path)?,
            cycles: open(&node, &path)?,
            requests: open(&node, &path)?,
            replies: open(&node, &path)?,
        };
        ghost::lay(&factories, &config);
        let shared = Shared {
            factories: Some(factories),
            node: Some(node),
            config,
            guard,
        };
        Ok(Self {
            shared: Rc::new(shared),
        })
    }

    /// The directory, canonical.
    pub fn directory(&self) -> &Path {
        self.shared.guard.directory()
    }

    /// Removes shared memory that a killed process created and never gave a size. iceoryx2 0.9.3, run by root, waits
    /// for such a size without an end, also in peers that only receive; joining removes it, and whoever has an
    /// ordinary thread calls this once a second, so that its loop is freed even if nobody joins. Does not wait.
    pub fn sweep(&self) {
        unborn(self.directory());
    }

    /// The one publisher of `T`.
    ///
    /// # Errors
    /// [`OpenError::Taken`] while another one lives, even if it is stopped.
    pub fn publisher<T: Message>(&self) -> Result<Publisher<T>, OpenError> {
        Publisher::open(&self.shared)
    }

    /// A subscriber of `T` that keeps the newest `buffer` messages, 1 to `T::QOS.buffer`.
    ///
    /// # Errors
    /// [`OpenError::Full`] where the service has all the subscribers that it takes.
    pub fn subscriber<T: Message>(&self, buffer: usize) -> Result<Subscriber<T>, OpenError> {
        Subscriber::open(&self.shared, buffer.clamp(1, T::QOS.buffer))
    }
}

impl Shared {
    pub(crate) fn factory<T: Message>(&self) -> Result<&Factory<T>, OpenError> {
        let gone = OpenError::Left {
            service: T::SERVICE,
        };
        self.factories.as_ref().map(T::factory).ok_or(gone)
    }

    pub(crate) fn directory(&self) -> String {
        self.guard.directory().display().to_string()
    }

    pub(crate) fn startup(&self) -> Result<Startup, JoinError> {
        self.guard.startup()
    }

    /// Clears away participants that were killed, for who holds the right to start up.
    pub(crate) fn bury_the_dead(&self) {
        remove_unborn(self.guard.directory());
        ghost::clean(&self.config);
        if let Some(services) = &self.factories {
            ghost::lay(services, &self.config);
        }
    }
}

/// Opens a service; creates it where we are the first.
fn open<T: Message>(node: &Node<Service>, path: &str) -> Result<Factory<T>, JoinError> {
    use PublishSubscribeOpenError as Open;
    use PublishSubscribeOpenOrCreateError as Error;
    let service = T::SERVICE;
    let refuse = |source: Error| match source {
        Error::PublishSubscribeOpenError(
            Open::IncompatibleTypes
            | Open::IncompatibleMessagingPattern
            | Open::IncompatibleOverflowBehavior
            | Open::DoesNotSupportRequestedMinBufferSize
            | Open::DoesNotSupportRequestedMinHistorySize
            | Open::DoesNotSupportRequestedAmountOfPublishers
            | Open::DoesNotSupportRequestedAmountOfSubscribers,
        ) => JoinError::OtherContract {
            path: path.to_owned(),
            service,
            source,
        },
        _ => JoinError::Service {
            path: path.to_owned(),
            service,
            source,
        },
    };
    // The names are constants of this crate, all of them valid.
    let name = service
        .try_into()
        .map_err(|_| refuse(Error::SystemInFlux))?;
    node.service_builder(&name)
        .publish_subscribe::<T>()
        .max_publishers(T::QOS.publishers)
        .max_subscribers(T::QOS.subscribers)
        .max_nodes(MAX_NODES)
        .history_size(T::QOS.history)
        .subscriber_max_buffer_size(T::QOS.buffer)
        .subscriber_max_borrowed_samples(1)
        .enable_safe_overflow(true)
        .open_or_create()
        .map_err(refuse)
}

/// iceoryx2's configuration, made here and not read from a file, with a root and a prefix that no other domain has.
fn configuration(directory: &Path) -> Option<Config> {
    let bytes = directory.as_os_str().as_bytes();
    if bytes.len() > 200 {
        return None;
    }
    let root = directory.join("iox2");
    let mut config = Config::default();
    config
        .global
        .set_root_path(&iceoryx2::prelude::Path::new(root.as_os_str().as_bytes()).ok()?);
    config.global.prefix = FileName::new(shared_memory_prefix(directory).as_bytes()).ok()?;
    // Who joins cleans up, under the guard (`ghost`).
    config.global.node.cleanup_dead_nodes_on_creation = false;
    config.global.node.cleanup_dead_nodes_on_destruction = false;
    Some(config)
}

/// Begin of the names of a domain's shared memory: `vpc_`, 16 hexadecimal digits of the 64-bit FNV-1a hash of the
/// canonical path, `_`.
pub fn shared_memory_prefix(directory: &Path) -> String {
    let hash = directory
        .as_os_str()
        .as_bytes()
        .iter()
        .fold(0xcbf2_9ce4_8422_2325_u64, |hash, &byte| {
            (hash ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01b3)
        });
    format!("vpc_{hash:016x}_")
}

/// Removes what the dead left: our root, and our files in shared memory. Only for who is alone in the domain.
fn wipe(directory: &Path) -> io::Result<()> {
    let gone = |result: io::Result<()>| match result {
        Err(error) if error.kind() != io::ErrorKind::NotFound => Err(error),
        _ => Ok(()),
    };
    gone(std::fs::remove_dir_all(directory.join("iox2")))?;
    ours(directory)?.try_for_each(|entry| gone(std::fs::remove_file(entry.path())))
}

/// Our files in shared memory.
fn ours(directory: &Path) -> io::Result<impl Iterator<Item = DirEntry>> {
    let prefix = shared_memory_prefix(directory);
    let entries = std::fs::read_dir(SHARED_MEMORY)?.filter_map(Result::ok);
    Ok(entries.filter(move |entry| entry.file_name().as_bytes().starts_with(prefix.as_bytes())))
}

/// Removes shared memory without a size that is old enough to have been left by a killed process; tells how many are
/// too young to say.
fn unborn(directory: &Path) -> usize {
    let Ok(entries) = ours(directory) else {
        return 0;
    };
    entries
        .filter(|entry| {
            let Ok(found) = entry.metadata() else {
                return false;
            };
            let age = found.modified().ok().and_then(|at| at.elapsed().ok());
            let is_old = age.is_some_and(|age| age >= UNBORN);
            if found.len() == 0 && is_old {
                // Somebody else may have been faster.
                let _ = std::fs::remove_file(entry.path());
            }
            found.len() == 0 && !is_old
        })
        .count()
}

/// Waits until it is clear what is unborn, and removes it. Next to always there is nothing to wait for.
fn remove_unborn(directory: &Path) {
    let pause = Duration::from_millis(5);
    for _ in 0..2 * UNBORN.as_millis() / pause.as_millis() {
        if unborn(directory) == 0 {
            return;
        }
        std::thread::sleep(pause);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_directory_has_its_prefix() {
        assert_eq!(
            shared_memory_prefix(Path::new("/tmp/vpc-0")),
            "vpc_dab3ee1dc20aec86_"
        );
        let [a, b] = ["/tmp/a", "/tmp/b"].map(|path| shared_memory_prefix(Path::new(path)));
        assert_ne!(a, b);
    }

    #[test]
    fn a_path_that_iceoryx2_cannot_take_is_refused() {
        assert!(configuration(Path::new("/tmp/vpc-0")).is_some());
        assert!(configuration(Path::new(&format!("/tmp/{}", "x".repeat(200)))).is_none());
    }
}
