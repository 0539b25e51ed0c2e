//! What operators ask of the controller, and what it answers.

use core::mem::{offset_of, size_of};

use iceoryx2::prelude::ZeroCopySend;

use crate::cycle::{Hold, StrategyCode};
use crate::message::{self, Invalid, Message, Qos, Stamp, codes};
use crate::twist::TwistState;

codes! {
    /// What an operator asks for.
    Action {
        /// Nothing: the answer tells the state.
        Status = 0 => "status",
        /// Let the law move the camera, from the next good features on.
        Arm = 1 => "arm",
        /// Brake to zero, and stay there until the next `arm`.
        Disarm = 2 => "disarm",
        /// Zero at once, without braking, and stay there until the next `arm`.
        Stop = 3 => "stop",
        /// Change the strategy of the law.
        Strategy = 4 => "strategy",
        /// Write out the flight record.
        Record = 5 => "record",
    }
}

codes! {
    /// What became of a request.
    Outcome {
        /// Done, or already so.
        Done = 0 => "done",
        /// Refused: no good features are coming, so that nothing could be controlled.
        NoFeatures = 1 => "refused: no good features are coming",
        /// Refused: the robot reports a fault, or was heard and fell silent.
        Robot = 2 => "refused: the robot is not ready",
        /// Refused: the camera still brakes; ask again when it stands.
        Braking = 3 => "refused: still braking",
        /// Refused: the controller's memory of motion lacks what the strategy needs, or there is no memory.
        NoMemory = 4 => "refused: no memory of motion for this strategy",
        /// Refused: neighbours out of range (knn: 1 to 64; other strategies: 0).
        Neighbours = 5 => "refused: neighbours out of range",
        /// Refused: the controller is shutting down.
        Shutdown = 6 => "refused: shutting down",
        /// Refused: the controller keeps no flight record.
        NoRecord = 7 => "refused: no flight record is kept",
        /// Refused: the code of the action or of the strategy is none of the contract's.
        Unknown = 8 => "refused: no such action or strategy",
    }
}

/// An operator's request; service `vpc/requests`. Several operators may be at work.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, ZeroCopySend)]
#[type_name("vpc/Request/1")]
pub struct Request {
    /// Head; `data_ns` is zero.
    pub stamp: Stamp,
    /// Chosen by the operator, so that the answer can be told from those to others.
    pub id: u64,
    /// An [`Action`] code.
    pub action: u32,
    /// For `strategy`: a [`StrategyCode`]; else zero.
    pub strategy: u32,
    /// For `strategy` knn: neighbours averaged, 1 to 64; else zero.
    pub neighbours: u32,
    /// Zero.
    pub reserved: u32,
}

const _: () = {
    assert!(size_of::<Request>() == 48);
    assert!(offset_of!(Request, id) == 24);
    assert!(offset_of!(Request, action) == 32);
    assert!(offset_of!(Request, strategy) == 36);
    assert!(offset_of!(Request, neighbours) == 40);
};

impl Request {
    /// A request for an action that needs no more words.
    pub fn new(id: u64, action: Action) -> Self {
        Self {
            stamp: Stamp::default(),
            id,
            action: action.code(),
            strategy: 0,
            neighbours: 0,
            reserved: 0,
        }
    }

    /// A request for another strategy; `neighbours` is for knn.
    pub fn strategy(id: u64, strategy: StrategyCode, neighbours: u32) -> Self {
        Self {
            strategy: strategy.code(),
            neighbours,
            ..Self::new(id, Action::Strategy)
        }
    }

    /// The action; `None` where the code is unknown.
    pub fn action(&self) -> Option<Action> {
        Action::from_code(self.action)
    }

    /// The strategy; `None` where the code is unknown.
    pub fn strategy_code(&self) -> Option<StrategyCode> {
        StrategyCode::from_code(self.strategy)
    }

    /// Whether action and strategy are known.
    ///
    /// # Errors
    /// [`Invalid`] names the one that is not, and its code.
    pub fn check_codes(&self) -> Result<(), Invalid> {
        let (service, strategy) = (Self::SERVICE, self.strategy_code());
        message::check_code(service, "action", self.action, self.action().is_some())?;
        message::check_code(service, "strategy", self.strategy, strategy.is_some())
    }
}

impl Message for Request {
    const SERVICE: &'static str = "vpc/requests";
    /// No history: a controller that restarts must not obey a request from before.
    const QOS: Qos = Qos {
        history: 0,
        buffer: 16,
        subscribers: 4,
        publishers: 8,
    };

    message::carried_by!(requests);

    /// The head only: an unknown action or strategy is answered, with [`Outcome::Unknown`].
    fn check(&self) -> Result<(), Invalid> {
        message::check_stamp(Self::SERVICE, &self.stamp)
    }
}

/// The controller's answer to a request; service `vpc/replies`.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, ZeroCopySend)]
#[type_name("vpc/Reply/1")]
pub struct Reply {
    /// Head; `data_ns` is the publication of the request.
    pub stamp: Stamp,
    /// The request's.
    pub id: u64,
    /// The request's [`Action`] code; zero where that is unknown.
    pub action: u32,
    /// An [`Outcome`] code.
    pub outcome: u32,
    /// A [`TwistState`] code: the state after the request.
    pub state: u32,
    /// A [`Hold`] code: the cause of that state.
    pub hold: u32,
    /// A [`StrategyCode`]: the strategy after the request.
    pub strategy: u32,
    /// Its neighbours (knn), else zero.
    pub neighbours: u32,
}

const _: () = {
    assert!(size_of::<Reply>() == 56);
    assert!(offset_of!(Reply, id) == 24);
    assert!(offset_of!(Reply, action) == 32);
    assert!(offset_of!(Reply, outcome) == 36);
    assert!(offset_of!(Reply, state) == 40);
    assert!(offset_of!(Reply, hold) == 44);
    assert!(offset_of!(Reply, strategy) == 48);
    assert!(offset_of!(Reply, neighbours) == 52);
};

impl Reply {
    /// What became of the request; `None` where the code is unknown, which reception refuses.
    pub fn outcome(&self) -> Option<Outcome> {
        Outcome::from_code(self.outcome)
    }

    /// The state after the request.
    pub fn state(&self) -> Option<TwistState> {
        TwistState::from_code(self.state)
    }

    /// The cause of the state after the request.
    pub fn hold(&self) -> Option<Hold> {
        Hold::from_code(self.hold)
    }
}

impl Message for Reply {
    const SERVICE: &'static str = "vpc/replies";
    const QOS: Qos = Qos {
        history: 0,
        buffer: 64,
        subscribers: 16,
        publishers: 1,
    };

    message::carried_by!(replies);

    fn check(&self) -> Result<(), Invalid> {
        let service = Self::SERVICE;
        message::check_stamp(service, &self.stamp)?;
        for (field, found, known) in [
            (
                "action",
                self.action,
                Action::from_code(self.action).is_some(),
            ),
            ("outcome", self.outcome, self.outcome().is_some()),
            ("state", self.state, self.state().is_some()),
            ("hold", self.hold, self.hold().is_some()),
            (
                "strategy",
                self.strategy,
                StrategyCode::from_code(self.strategy).is_some(),
            ),
        ] {
            message::check_code(service, field, found, known)?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_request_with_an_unknown_action_is_received_so_that_it_can_be_answered() {
        let mut request = Request::new(7, Action::Arm);
        request.stamp.sequence = 1;
        request.action = 99;
        assert_eq!(request.check(), Ok(()));
        let message = request.check_codes().unwrap_err().to_string();
        assert_eq!(
            message,
            "vpc/requests: action = 99; allowed: the codes of CONTRACT.md"
        );
        request.stamp.sequence = 0;
        let message = request.check().unwrap_err().to_string();
        assert!(message.starts_with("vpc/requests: "), "{message}");
    }

    #[test]
    fn a_reply_with_an_unknown_outcome_is_refused() {
        let mut reply = Reply {
            stamp: Stamp::default(),
            id: 7,
            action: Action::Arm.code(),
            outcome: Outcome::NoFeatures.code(),
            state: TwistState::Disarmed.code(),
            hold: Hold::Stale.code(),
            strategy: 0,
            neighbours: 0,
        };
        reply.stamp.sequence = 1;
        assert_eq!(reply.check(), Ok(()));
        reply.outcome = 1000;
        let message = reply.check().unwrap_err().to_string();
        assert!(
            message.starts_with("vpc/replies: outcome = 1000"),
            "{message}"
        );
    }
}
