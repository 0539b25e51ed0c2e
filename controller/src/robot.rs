//! The robot's state by its messages: at fault, silent, or fine. Pure; the time is an argument.

use ipc::{RobotFaults, RobotMode, RobotState};
use serde::{Deserialize, Serialize};

use crate::decision::HoldReason;
use crate::input::Input;

/// What the robot's messages have said so far.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct RobotWatch {
    lost_ns: Option<u64>,
    /// When the last state was published, CLOCK_MONOTONIC, ns; not later than it was looked at.
    heard_ns: Option<u64>,
    at_fault: bool,
}

impl RobotWatch {
    /// A watch for which a robot is lost after `lost_ns` of silence; `None` in lockstep, where time
    /// does not pass.
    pub fn new(lost_ns: Option<u64>) -> Self {
        Self {
            lost_ns,
            heard_ns: None,
            at_fault: false,
        }
    }

    /// What is wrong at `now_ns`, after what was received by then. A robot that was never heard is
    /// none: a camera may be carried by something that says nothing.
    pub fn look(&mut self, input: &Input<RobotState>, now_ns: u64) -> Option<HoldReason> {
        if let Input::Message(state) = input {
            // A stamp from the future would put off the silence after it.
            self.heard_ns = Some(state.stamp.published_ns.min(now_ns));
            self.at_fault = is_fault(state);
        }
        let silent = |heard: u64| {
            let limit = self.lost_ns;
            limit.is_some_and(|limit| now_ns.saturating_sub(heard) > limit)
        };
        // A state that breaks the contract is as good as none: it ends in silence.
        match self.heard_ns {
            _ if self.at_fault => Some(HoldReason::RobotFault),
            Some(heard) if silent(heard) => Some(HoldReason::RobotLost),
            _ => None,
        }
    }
}

/// Whether the robot stopped by itself.
fn is_fault(state: &RobotState) -> bool {
    state.mode() == Some(RobotMode::Fault) || state.faults().any(RobotFaults::REFLEX)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn state(mode: RobotMode, faults: RobotFaults, published_ns: u64) -> Input<RobotState> {
        let mut message = RobotState::free_camera([0.0; 3], [0.0; 3], published_ns);
        message.mode = mode.code();
        message.faults = faults.0;
        message.stamp.published_ns = published_ns;
        Input::Message(message)
    }

    #[test]
    fn a_robot_that_was_never_heard_is_not_missed() {
        assert_eq!(
            RobotWatch::new(Some(10)).look(&Input::Nothing, 1 << 40),
            None
        );
    }

    #[test]
    fn silence_is_noticed_and_ends_with_the_next_state() {
        let mut watch = RobotWatch::new(Some(10));
        let fine = RobotFaults::default();
        assert_eq!(watch.look(&state(RobotMode::Moving, fine, 100), 101), None);
        assert_eq!(watch.look(&Input::Nothing, 110), None);
        assert_eq!(
            watch.look(&Input::Nothing, 111),
            Some(HoldReason::RobotLost)
        );
        assert_eq!(watch.look(&state(RobotMode::Idle, fine, 112), 113), None);
    }

    #[test]
    fn a_state_from_the_future_puts_off_no_silence() {
        let mut watch = RobotWatch::new(Some(10));
        let future = state(RobotMode::Moving, RobotFaults::default(), u64::MAX);
        assert_eq!(watch.look(&future, 100), None);
        assert_eq!(
            watch.look(&Input::Nothing, 111),
            Some(HoldReason::RobotLost)
        );
    }

    #[test]
    fn a_fault_lasts_until_the_robot_says_otherwise() {
        let mut watch = RobotWatch::new(None);
        let fine = RobotFaults::default();
        let reflex = state(RobotMode::Moving, RobotFaults::REFLEX, 1);
        assert_eq!(watch.look(&reflex, 2), Some(HoldReason::RobotFault));
        assert_eq!(
            watch.look(&Input::Nothing, 1 << 40),
            Some(HoldReason::RobotFault)
        );
        assert_eq!(watch.look(&state(RobotMode::Idle, fine, 3), 4), None);
        let fault = state(RobotMode::Fault, fine, 5);
        assert_eq!(watch.look(&fault, 6), Some(HoldReason::RobotFault));
        // Standing still because commands are missing, or cutting one to the limits, is no fault.
        let cut = RobotFaults(RobotFaults::STALE_COMMAND.0 | RobotFaults::COMMAND_LIMITED.0);
        assert_eq!(watch.look(&state(RobotMode::Stale, cut, 7), 8), None);
    }
}
