//! What the law, the gate before it, or the supervisor behind it decides to send.

use core::fmt;

use messages::{Hold, TwistState};
use serde::{Deserialize, Serialize};

/// A command, before it becomes a message.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Decision {
    /// Camera twist, camera frame, m/s and rad/s.
    pub twist: [f64; 6],
    /// State of the controller.
    pub state: TwistState,
    /// Why the twist of the law is not sent; `None` if it is.
    pub hold: Option<HoldReason>,
}

impl Decision {
    /// The zero twist until the reason is gone.
    pub const fn hold(reason: HoldReason) -> Self {
        Self::still(reason, TwistState::Holding)
    }

    /// The zero twist in this state.
    pub const fn still(reason: HoldReason, state: TwistState) -> Self {
        Self {
            twist: [0.0; 6],
            state,
            hold: Some(reason),
        }
    }

    /// The reason as it travels.
    pub fn hold_code(&self) -> u32 {
        hold_code(self.hold)
    }
}

/// A reason, or none, as it travels.
pub fn hold_code(reason: Option<HoldReason>) -> u32 {
    reason.map_or(Hold::None, Hold::from).code()
}

macro_rules! hold_reasons {
    ($($reason:ident)+) => {
        /// Why the twist of the law is not sent: the values of [`Hold`] except `None`, with the
        /// same meanings.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
        #[allow(missing_docs)]
        pub enum HoldReason {
            $($reason,)+
        }

        impl From<HoldReason> for Hold {
            fn from(reason: HoldReason) -> Self {
                match reason {
                    $(HoldReason::$reason => Self::$reason,)+
                }
            }
        }

        impl HoldReason {
            /// The reason of a code; `None` for [`Hold::None`] and for unknown codes.
            pub fn from_code(code: u32) -> Option<Self> {
                match Hold::from_code(code)? {
                    Hold::None => None,
                    $(Hold::$reason => Some(Self::$reason),)+
                }
            }
        }
    };
}

hold_reasons! {
    NoFeatures Stale Invalid Hidden Count NotFinite OffImage Transport BadTwist Order Clock Solver RobotFault RobotLost
    Overruns NotArmed Operator Shutdown Lost Standstill Mixed Frozen Unclean NoRobot
    NotFollowed NoWay NotFollowing Elsewhere Arrived
}

impl fmt::Display for HoldReason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        Hold::from(*self).fmt(f)
    }
}
