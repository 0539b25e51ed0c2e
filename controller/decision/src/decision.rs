//! What the law, the gate before it, or the supervisor behind it decides to send.

use messages::{Hold, TwistState};
use serde::{Deserialize, Serialize};

/// A command, before it becomes a message.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Decision {
    /// Camera twist, camera frame, m/s and rad/s.
    pub twist: [f64; 6],
    /// Velocity of the arm's elbow, rad/s.
    pub elbow: f64,
    /// State of the controller.
    pub state: TwistState,
    /// Why the twist of the law is not sent; `None` if it is.
    pub hold: Option<Hold>,
}

impl Decision {
    /// The zero twist until the hold is gone.
    pub const fn hold(hold: Hold) -> Self {
        Self::still(hold, TwistState::Holding)
    }

    /// The zero twist in this state.
    pub const fn still(hold: Hold, state: TwistState) -> Self {
        Self {
            twist: [0.0; 6],
            elbow: 0.0,
            state,
            hold: Some(hold),
        }
    }
}
