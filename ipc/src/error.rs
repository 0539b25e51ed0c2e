//! What can go wrong.

use std::io;

use iceoryx2::node::NodeCreationFailure;
use iceoryx2::port::publisher::PublisherCreateError;
use iceoryx2::port::subscriber::SubscriberCreateError;
use iceoryx2::port::{LoanError, SendError};
use iceoryx2::service::builder::publish_subscribe::PublishSubscribeOpenOrCreateError;

use crate::field::Stamp;
use crate::message::Invalid;

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

/// Why a port could not be opened.
#[derive(Debug, thiserror::Error)]
pub enum OpenError {
    /// The service has its one publisher.
    #[error(
        "{service}: another publisher is at work in domain {domain}; allowed: {most} (stop the other, or use another domain)"
    )]
    Taken {
        /// The service.
        service: &'static str,
        /// The domain's directory.
        domain: String,
        /// Most publishers.
        most: usize,
    },
    /// The service has all the subscribers that it takes.
    #[error("{service}: {most} subscribers are at work; allowed: {most}")]
    Full {
        /// The service.
        service: &'static str,
        /// Most subscribers.
        most: usize,
    },
    /// iceoryx2 refused the publisher.
    #[error("{service}: no publisher: {source}")]
    Publisher {
        /// The service.
        service: &'static str,
        /// Its reason.
        r#source: PublisherCreateError,
    },
    /// iceoryx2 refused the subscriber.
    #[error("{service}: no subscriber: {source}")]
    Subscriber {
        /// The service.
        service: &'static str,
        /// Its reason.
        r#source: SubscriberCreateError,
    },
    /// The domain is being left.
    #[error("{service}: the domain is being left")]
    Left {
        /// The service.
        service: &'static str,
    },
    /// The guard of the domain.
    #[error(transparent)]
    Guard(#[from] JoinError),
}

/// Why a message was not published.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum PublishError {
    /// No room for the message.
    #[error("{service}: no room for a message: {source}")]
    Loan {
        /// The service.
        service: &'static str,
        /// iceoryx2's reason.
        r#source: LoanError,
    },
    /// Not delivered.
    #[error("{service}: not delivered: {source}")]
    Send {
        /// The service.
        service: &'static str,
        /// iceoryx2's reason.
        r#source: SendError,
    },
}

/// Why nothing could be received.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum ReceiveError {
    /// A message came and was refused.
    #[error("{invalid}")]
    Invalid {
        /// What is wrong with it.
        invalid: Invalid,
        /// Its head, so that it can be answered.
        stamp: Stamp,
    },
    /// The connection failed.
    #[error("{service}: cannot receive: {source}")]
    Transport {
        /// The service.
        service: &'static str,
        /// iceoryx2's reason.
        r#source: iceoryx2::port::ReceiveError,
    },
}

/// Why an operator could not ask.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum AskError {
    /// The request was not sent.
    #[error(transparent)]
    Publish(#[from] PublishError),
    /// The answers cannot be received.
    #[error(transparent)]
    Receive(#[from] ReceiveError),
}
