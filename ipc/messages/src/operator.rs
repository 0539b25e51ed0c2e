//! Requests of operators, and the controller's replies.

use crate::codes::codes;
use crate::cycle::{Hold, StrategyCode};
use crate::field::Stamp;
use crate::message::{self, Invalid, Message, Qos, message};
use crate::twist::TwistState;

codes! {
    /// What an operator asks for.
    Action {
        /// Nothing but the answer, which has the state.
        Status = 0 => "status",
        /// Let the control law move the camera, from the next good features on.
        Arm = 1 => "arm",
        /// Brake to zero, and stay there until the next `arm`.
        Disarm = 2 => "disarm",
        /// Zero at once, without braking, and stay there until the next `arm`. Use the stop file:
        /// no other operator can keep it waiting.
        Stop = 3 => "stop",
        /// Change the strategy of the control law.
        Strategy = 4 => "strategy",
        /// Write out the flight record.
        Record = 5 => "record",
        /// Clear the robot's errors: asked of its bridge, not of the controller, which answers
        /// done.
        Recover = 6 => "recover",
    }
}

codes! {
    /// The outcome of a request.
    Outcome {
        /// Done, or it was already so.
        Done = 0 => "done",
        /// Refused: no good features are coming, so that nothing could be controlled.
        NoFeatures = 1 => "refused: no good features are coming",
        /// Refused: the robot reports a fault or a reflex.
        RobotFault = 2 => "refused: the robot reports a fault: clear it at the robot, or by vpcctl recover",
        /// Refused: the camera is still braking, or an operator stopped it less than 0.5 s ago; ask
        /// again.
        Braking = 3 => "refused: still braking, or stopped less than 0.5 s ago",
        /// Refused: the controller's memory of motion lacks what the strategy needs, or there is no
        /// memory.
        NoMemory = 4 => "refused: no memory of motion for this strategy",
        /// Refused: neighbours out of range (knn: 1 to 64; other strategies: 0).
        Neighbours = 5 => "refused: neighbours out of range",
        /// Refused: the controller is shutting down.
        Shutdown = 6 => "refused: shutting down",
        /// Refused: the code of the action or of the strategy is unknown.
        Unknown = 8 => "refused: no such action or strategy",
        /// Refused: it leads to motion, and waited for too long, or is from the future.
        Late = 9 => "refused: it waited for more than 0.3 s",
        /// Refused: no robot has told its state yet, and one is required (`safety.robot`).
        NoRobot = 10 =>
            "refused: no robot was heard: start its client, or set safety.robot = \"optional\"",
        /// Refused: the robot's state came and then stopped coming.
        RobotLost = 11 => "refused: the robot fell silent: start its client again",
        /// Refused: what the robot says it carries out is not what it was commanded.
        NotFollowed = 12 => "refused: the robot does not follow its commands",
        /// Refused: an operator has stopped or disarmed it since it was last armed, and the request
        /// does not name the newest veto.
        Vetoed = 13 => "refused: an operator has stopped or disarmed it since it was last armed",
        /// Refused: the scene names an arm, and no positions of as many joints came for 0.5 s, or
        /// those that came were refused.
        NoJoints = 14 => "refused: the arm's joints are unknown",
        /// Refused: the arm's joints do not move as the robot says that its camera moves.
        JointsNotFollowing = 15 => "refused: the arm's joints do not follow",
    }
}

impl Action {
    /// The action of the veto with this name, as a reply or a cycle tells it: a stop or a disarm;
    /// `None` for 0, no veto.
    pub const fn of_veto(name: u32) -> Option<Self> {
        match name {
            0 => None,
            _ if name % 2 == 1 => Some(Self::Stop),
            _ => Some(Self::Disarm),
        }
    }
}

message! {
    /// An operator's request. Several operators may be at work.
    Request {
        /// Head; `data_ns` is zero.
        stamp: Stamp,
        /// Chosen by the operator at random; the reply has the same. 0: the stop file.
        id: u64,
        /// What is asked for. An unknown code is answered with outcome 8.
        action: u32 [any_code(Action)],
        /// For action `strategy`: which one, also answered if unknown; else zero.
        strategy: u32 [any_code(StrategyCode)],
        /// For strategy knn: neighbours averaged, 1 to 64; else zero.
        neighbours: u32,
        /// For action `arm`: the veto, as a reply or a cycle tells it, that the operator knows of
        /// and arms in spite of; 0: none. Else zero.
        veto: u32,
    }
    // No history: a controller that restarts must not obey a request from before.
    "vpc/requests" from "operators": Qos { history: 0, buffer: 16, subscribers: 8, publishers: 8 }
}

impl Request {
    /// The id by which a stop by the stop file is answered and recorded.
    pub const STOP_FILE: u64 = 0;
    /// Most requests that the controller answers in a cycle: as many as can wait in their queues,
    /// so that no operator keeps another one's waiting.
    pub const PER_CYCLE: usize = Self::QOS.publishers * Self::QOS.buffer;

    /// How long a request that leads to motion may wait for the controller, ns: who has had no
    /// answer by then may give up, and nothing will move.
    pub const LATE_NS: u64 = 300_000_000;

    /// How long after a stop no arming is accepted, ns: no human looks and arms sooner.
    pub const AFTER_STOP_NS: u64 = 500_000_000;

    /// A request to arm in spite of this veto; 0: of none.
    pub fn arm(id: u64, veto: u32) -> Self {
        Self {
            veto,
            ..Self::new(id, Action::Arm)
        }
    }

    /// A request for an action other than [`Action::Strategy`].
    pub fn new(id: u64, action: Action) -> Self {
        Self {
            id,
            action: action.code(),
            ..Self::default()
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

    /// The action; `None` if the code is unknown.
    pub fn action(&self) -> Option<Action> {
        Action::from_code(self.action)
    }

    /// The strategy; `None` if the code is unknown.
    pub fn strategy_code(&self) -> Option<StrategyCode> {
        StrategyCode::from_code(self.strategy)
    }

    /// Checks the codes of action and strategy, which reception does not.
    ///
    /// # Errors
    /// [`Invalid`] names the unknown one.
    pub fn check_codes(&self) -> Result<(), Invalid> {
        message::check(self, true)
    }
}

message! {
    /// The controller's answer to a request.
    Reply {
        /// Head; `data_ns` is the publication of the request.
        stamp: Stamp,
        /// That of the request.
        id: u64,
        /// The cycle from which the request counts.
        cycle: u64,
        /// That of the request; zero if it is unknown.
        action: u32 [code(Action)],
        /// Outcome of the request.
        outcome: u32 [code(Outcome)],
        /// State after the request.
        state: u32 [code(TwistState)],
        /// Cause of that state.
        hold: u32 [code(Hold)],
        /// Strategy after the request.
        strategy: u32 [code(StrategyCode)],
        /// Its neighbours (knn), else zero.
        neighbours: u32,
        /// The veto that stands: the random name of the last operator's stop, by a request or the
        /// stop file (odd), or disarm (even) since it was last armed; 0: none.
        veto: u32,
        /// The veto that the request names.
        named: u32,
        /// The first cycle since that veto, CLOCK_MONOTONIC; greatest before that cycle, 0 without
        /// a veto.
        veto_ns: u64 ["ns"],
    }
    // As many as a cycle may answer.
    "vpc/replies" from "controller": Qos { history: 0, buffer: 256, subscribers: 16, publishers: 1 }
}

impl Reply {
    /// The outcome of the request; `None` if the code is unknown, which reception refuses.
    pub fn outcome(&self) -> Option<Outcome> {
        Outcome::from_code(self.outcome)
    }

    /// The state after the request.
    pub fn state(&self) -> Option<TwistState> {
        TwistState::from_code(self.state)
    }

    /// What holds the law's twist back after the request, if anything.
    pub fn hold(&self) -> Option<Hold> {
        Hold::from_code(self.hold)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_contract_names_the_requests_of_a_cycle() {
        let words = format!("at most {} requests per cycle", Request::PER_CYCLE);
        assert!(
            include_str!("../../CONTRACT.md").contains(&words),
            "{words}"
        );
    }
    use crate::message::Message;

    #[test]
    fn a_request_with_an_unknown_action_is_received() {
        let mut request = Request::new(7, Action::Arm);
        request.stamp.sequence = 1;
        request.action = 99;
        assert_eq!(request.check(), Ok(()));
        let message = request.check_codes().unwrap_err().to_string();
        assert_eq!(
            message,
            "vpc/requests: action = 99; allowed: 0 status, 1 arm, 2 disarm, 3 stop, 4 strategy, \
             5 record, 6 recover"
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
            cycle: 0,
            action: Action::Arm.code(),
            outcome: Outcome::NoFeatures.code(),
            state: TwistState::Disarmed.code(),
            hold: Hold::Stale.code(),
            ..Reply::default()
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
