//! Modes of the robot, and requests that they refuse.

use std::fmt;

use thiserror::Error;

/// The robot's mode. Guiding by hand is not modelled.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Mode {
    /// It stands and waits for a motion.
    #[default]
    Idle,
    /// It executes a motion, or brakes at its end.
    Move,
    /// It stopped itself, or is about to: see the errors. Automatic error recovery leads back.
    Reflex,
    /// The user's stop is pressed.
    UserStopped,
    /// It is on the way from reflex to idle.
    AutomaticErrorRecovery,
}

impl Mode {
    /// In words.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Idle => "idle",
            Self::Move => "move",
            Self::Reflex => "reflex",
            Self::UserStopped => "user stopped",
            Self::AutomaticErrorRecovery => "automatic error recovery",
        }
    }
}

impl fmt::Display for Mode {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// Why a request was refused.
#[derive(Clone, Copy, Debug, Error, PartialEq, Eq)]
pub enum RequestError {
    /// The robot is in another mode than the request needs.
    #[error("the robot is in mode \"{mode}\", the request needs \"{needed}\"")]
    Mode {
        /// Its mode.
        mode: Mode,
        /// The mode that the request needs.
        needed: Mode,
    },
    /// The robot still brakes.
    #[error("the robot is in mode \"{mode}\" but not yet at rest")]
    Moving {
        /// Its mode.
        mode: Mode,
    },
}
