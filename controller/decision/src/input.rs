//! What a cycle receives.

use messages::{DesiredTwist, Features, InputCode, RobotState, Stamp};

/// What came from one port.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Input<T> {
    /// A message. Where it stands in the sequence follows from its stamp and the one before.
    Message(T),
    /// Nothing.
    Nothing,
    /// A message with this head that did not pass its checks.
    Refused(Stamp),
    /// The connection failed.
    Failed,
}

/// All that a cycle learns before it decides, except the requests of operators.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Inputs {
    /// The instant for which the cycle decides, CLOCK_MONOTONIC, ns.
    pub now_ns: u64,
    /// From the camera.
    pub features: Input<Features>,
    /// From the robot.
    pub robot: Input<RobotState>,
    /// From the program that wants a twist.
    pub desired: Input<DesiredTwist>,
    /// Releases missed just before this cycle.
    pub missed: u32,
    /// Whether the machine was suspended just before this cycle.
    pub suspended: bool,
    /// Whether the daemon is to stop.
    pub shutdown: bool,
}

impl<T: messages::Message> Input<T> {
    /// The code and the head of the message for a cycle's record.
    pub fn wire(&self) -> (InputCode, Stamp) {
        match self {
            Self::Nothing => (InputCode::Nothing, Stamp::default()),
            Self::Message(message) => (InputCode::Message, *message.stamp()),
            Self::Refused(stamp) => (InputCode::Refused, *stamp),
            Self::Failed => (InputCode::Failed, Stamp::default()),
        }
    }
}
