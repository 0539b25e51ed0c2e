//! What can go wrong.

use std::io;

use iceoryx2::node::NodeCreationFailure;
use iceoryx2::port::SendError;
use iceoryx2::service::builder::publish_subscribe::PublishSubscribeOpenOrCreateError;
use messages::{Invalid, Stamp};

/// A domain could not be joined.
#[derive(Debug, thiserror::Error)]
#[error("domain {directory}: {reason}")]
#[allow(missing_docs)]
pub struct JoinError {
    pub directory: String,
    pub reason: JoinReason,
}

/// Why a domain could not be joined.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs)]
pub enum JoinReason {
    /// The directory cannot be used.
    #[error(transparent)]
    Directory(#[from] io::Error),
    /// The directory belongs to another user, or is a link.
    #[error("owned by user {owner}; allowed: a directory (no link) of user {us}")]
    NotOurs { owner: u32, us: u32 },
    /// Other users could replace the locks and the files by which services are found.
    #[error("mode {0:03o} lets other users put files into it; allowed: mode 700 (chmod 700)")]
    Open(u32),
    /// The directory is not at its path any more.
    #[error("was moved or replaced since this process joined it; start the process again")]
    Moved,
    /// iceoryx2 does not take the path.
    #[error("not a usable path; allowed: at most 200 bytes, letters, digits and . - _ /")]
    Path,
    /// Writing to shared memory would end this process by SIGBUS.
    #[error(
        "/dev/shm has {free} bytes free; needed: {needed}; remove what fills it (du -a /dev/shm | sort -n), or make it larger \
         (mount -o remount,size=1G /dev/shm); a stop needs none of it"
    )]
    NoRoom { free: u64, needed: u64 },
    /// iceoryx2 keeps small files in the directory.
    #[error("its disk is full; remove what fills it; a stop needs none of it ({0})")]
    FullDisk(Box<JoinReason>),
    /// Another process has been joining or leaving for this many seconds.
    #[error(
        "another process has been joining or leaving for {0} s; end it if it is stopped, or use another domain"
    )]
    Busy(u64),
    /// iceoryx2 refused the node.
    #[error("iceoryx2 cannot make its files there: {0}")]
    Node(#[from] NodeCreationFailure),
    /// A service exists with other types or another quality of service.
    #[error(
        "{service} is of another version of the contract: {found}; this program's: {ours}; stop every process of this domain first ({reason})"
    )]
    OtherContract {
        service: &'static str,
        /// Type name of the message that the domain's service carries.
        found: String,
        ours: &'static str,
        reason: PublishSubscribeOpenOrCreateError,
    },
    /// A service could not be opened.
    #[error("{service}: {reason}")]
    Service {
        service: &'static str,
        reason: PublishSubscribeOpenOrCreateError,
    },
}

/// Why a port could not be opened.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs)]
pub enum OpenError {
    /// The service has all the publishers that it takes.
    #[error(
        "{service}: another publisher is at work in domain {domain}; allowed: {most} (stop the other, or use another domain)"
    )]
    Taken {
        service: &'static str,
        domain: String,
        most: usize,
    },
    /// The service has all the subscribers that it takes.
    #[error("{service}: {most} subscribers are at work; allowed: {most}")]
    Full { service: &'static str, most: usize },
    /// iceoryx2 refused the port.
    #[error("{service}: iceoryx2 refused the port: {reason}")]
    Port {
        service: &'static str,
        reason: String,
    },
    /// The domain's locks cannot be taken.
    #[error(transparent)]
    Guard(#[from] JoinError),
}

/// A message was not published.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{service}: not delivered: {reason}")]
#[allow(missing_docs)]
pub struct PublishError {
    pub service: &'static str,
    pub reason: SendError,
}

/// Why no memory was loaned for an image.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[allow(missing_docs)]
pub enum LoanError {
    /// The header describes no image.
    #[error(transparent)]
    Header(#[from] Invalid),
    /// The publisher was opened for smaller images.
    #[error("{service}: an image of {bytes} bytes; allowed: {most}, for which the port was opened")]
    TooLarge {
        service: &'static str,
        bytes: usize,
        most: usize,
    },
    /// iceoryx2 has no memory: an image is loaned already, or subscribers hold too many.
    #[error("{service}: no memory for an image: {reason}")]
    Transport {
        service: &'static str,
        reason: iceoryx2::port::LoanError,
    },
}

/// Why nothing could be received.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[allow(missing_docs)]
pub enum ReceiveError {
    /// A message came and was refused. The head is kept so that it can be answered.
    #[error("{invalid}")]
    Invalid { invalid: Invalid, stamp: Stamp },
    /// The connection failed.
    #[error("{service}: cannot receive: {reason}")]
    Transport {
        service: &'static str,
        reason: iceoryx2::port::ReceiveError,
    },
}

/// Why an operator could not ask.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[allow(missing_docs)]
pub enum AskError {
    #[error(transparent)]
    Publish(#[from] PublishError),
    #[error(transparent)]
    Receive(#[from] ReceiveError),
}
