//! What the loop tells, and why it ends.

use crate::refusal::{Counts, Refusal};
use crate::ros::RosError;
use crate::stamp;

/// Why the loop ended.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs)]
pub enum BridgeError {
    #[error(transparent)]
    Ros(#[from] RosError),
    #[error(transparent)]
    Join(#[from] ipc::JoinError),
    #[error(transparent)]
    Open(#[from] ipc::OpenError),
    #[error(transparent)]
    Publish(#[from] ipc::PublishError),
    #[error(transparent)]
    Receive(#[from] ipc::ReceiveError),
    #[error(transparent)]
    SetBack(#[from] stamp::SetBack),
    #[error("its guard has ended, which says zero when the gateway cannot")]
    Guard,
    #[error("no guard can be started, which says zero when the gateway cannot: {0}")]
    NoGuard(std::io::Error),
    #[error(transparent)]
    Scene(#[from] crate::agreement::OtherScene),
}

/// What the loop tells the rest of the program.
#[derive(Clone, Debug)]
pub enum Event {
    /// The first message of a topic was taken.
    Comes(String),
    /// A message was refused.
    Refused(String, Refusal),
    /// The wall clock stepped by this, ns.
    Step(i64),
    /// Counts and clocks, a few times a second.
    Report(Report),
    /// A twist of vpcd could not be turned into the frame of the command: zero was sent.
    NoFrame,
    /// Something could not be sent, and why.
    NotSent(&'static str, String),
    /// A command of vpcd was refused.
    Command(messages::Invalid),
    /// A service was asked for something.
    Service(String),
}

/// What came and went since the start.
#[derive(Clone, Debug, Default)]
pub struct Report {
    /// Each topic that is subscribed to, and what came.
    pub topics: Vec<(String, Counts)>,
    /// Tags that are none of ours.
    pub foreign_tags: u64,
    /// Twists that were sent, and those among them that were zeros of our own.
    pub sent: [u64; 2],
    /// Twists that could not be sent.
    pub not_sent: u64,
    /// Whether a stop is in force: nothing but zeros is sent.
    pub is_stopping: bool,
    /// Steps of the wall clock.
    pub steps: u64,
    /// Monotonic less wall, ns.
    pub offset_ns: i64,
}
