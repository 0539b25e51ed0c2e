//! The decision of a cycle: gate, law, supervisor. A function of its inputs and of what earlier cycles left, with no
//! clock and no port: the loop calls it live, the replay of a flight record calls it again, and both get the same bits.

use ipc::{
    Action, CycleRecord, Features, Hold, Outcome, RecallCode, Reply, Request, RobotState,
    SolverStatus, Stamp, StrategyCode,
};

use crate::gate::{Gate, Input, Verdict};
use crate::law::{self, Decision, Law};
use crate::robot::RobotWatch;
use crate::supervisor::{Rules, Situation, Supervisor};

/// All that a cycle learns from outside before it decides, but for requests.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Inputs {
    /// When it looked, CLOCK_MONOTONIC, ns.
    pub now_ns: u64,
    /// What came from the camera.
    pub features: Input,
    /// What came from the robot.
    pub robot: Input<RobotState>,
    /// Releases missed just before this cycle.
    pub missed: u64,
    /// Whether the daemon is to stop.
    pub shutdown: bool,
}

/// What a cycle is to send.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Answer {
    /// Head of the features message that it answers; all zero where there is none.
    pub stamp: Stamp,
    /// The command.
    pub decision: Decision,
}

/// What a cycle leaves to the next. Plain data.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct State {
    /// The gate.
    pub gate: Gate,
    /// What was heard of the robot.
    pub robot: RobotWatch,
    /// The law.
    pub law: vpc::State,
    /// The supervisor.
    pub supervisor: Supervisor,
    /// The last command of the law, for cycles without news.
    pub standing: Answer,
}

/// Gate, law and supervisor, with what a cycle leaves to the next.
pub struct Pilot {
    gate: Gate,
    robot: RobotWatch,
    law: Law,
    supervisor: Supervisor,
    /// The last command of the law, for cycles without news.
    standing: Answer,
}

impl Pilot {
    /// A pilot before its first cycle; features are stale after `stale_ns` of silence, never in lockstep (`None`).
    pub fn new(law: Law, stale_ns: Option<u64>, rules: Rules) -> Self {
        Self {
            gate: Gate::new(stale_ns),
            robot: RobotWatch::new(rules.lost_ns),
            law,
            supervisor: Supervisor::new(rules),
            standing: Answer {
                stamp: Stamp::default(),
                decision: law::held(Hold::NoFeatures),
            },
        }
    }

    /// What the cycles so far leave to the next. A copy; never allocates.
    pub fn state(&self) -> State {
        // Field by field: who adds one must say here whether the next cycle depends on it.
        let Self {
            gate,
            robot,
            law,
            supervisor,
            standing,
        } = self;
        State {
            gate: *gate,
            robot: *robot,
            law: law.state(),
            supervisor: *supervisor,
            standing: *standing,
        }
    }

    /// Goes on from a state of this pilot, or of another one with the same scene, memory and settings.
    pub fn restore(&mut self, state: &State) {
        self.gate = state.gate;
        self.robot = state.robot;
        self.law.restore(&state.law);
        self.supervisor = state.supervisor;
        self.standing = state.standing;
    }

    /// As [`Pilot::restore`]; the command that followed the last features was `twist`, whatever the law had said.
    pub(crate) fn follow(&mut self, state: &State, twist: &[f64; 6]) {
        self.restore(state);
        self.law.follow(twist);
    }

    /// The law.
    pub fn law(&self) -> &Law {
        &self.law
    }

    /// Whether the last twist was zero.
    pub fn is_at_rest(&self) -> bool {
        self.supervisor.is_at_rest()
    }

    /// Takes an operator's request; it counts from the next decision on. The answer lacks its stamp only.
    pub fn request(&mut self, request: &Request) -> Reply {
        let outcome = match request.action() {
            Some(Action::Strategy) => self.change(request),
            // The recorder, not the pilot, knows about flight records.
            Some(Action::Record) | None => Outcome::NoRecord,
            Some(action) => self.supervisor.request(action),
        };
        let (state, hold) = self.supervisor.state();
        let (strategy, neighbours) = law::strategy_code(self.law.settings().strategy);
        Reply {
            stamp: Stamp {
                data_ns: request.stamp.published_ns,
                ..Stamp::default()
            },
            id: request.id,
            action: request.action,
            outcome: outcome.code(),
            state: state.code(),
            hold: hold.code(),
            strategy: strategy.code(),
            neighbours,
        }
    }

    /// One decision, and in `record` what there is to tell about it: all but times and counts. Never allocates.
    pub fn decide(&mut self, inputs: &Inputs, record: &mut CycleRecord) -> Answer {
        self.law.describe(record);
        let proposed = self.propose(inputs, record);
        let situation = Situation {
            decision: proposed.decision,
            good_ns: self.gate.good_ns(),
            solver_failed: solver_failed(record),
            recall_refused: recall_refused(record),
            missed: inputs.missed,
            robot: self.robot.look(&inputs.robot, inputs.now_ns),
            shutdown: inputs.shutdown,
        };
        let decision = self.supervisor.supervise(&situation, inputs.now_ns);
        if decision.twist != proposed.decision.twist {
            // The law's next prediction would be of a motion that does not happen.
            self.gate.mark_gap();
            self.law.overruled();
        }
        // As sent, whoever chose it. The instant is that of the law's plan, so that a replay needs no other clock.
        let effective_ns = self.effective_ns(&proposed.stamp, inputs.now_ns);
        self.law.sent(&decision.twist, effective_ns);
        record.features_sequence = proposed.stamp.sequence;
        record.twist = decision.twist;
        record.state = decision.state.code();
        record.hold = decision.hold.code();
        Answer {
            stamp: proposed.stamp,
            decision,
        }
    }

    /// When a command that is decided at `now_ns` takes effect: at once; or in lockstep, where the camera's stamps are
    /// the clock, when the features that it answers were delivered.
    pub fn effective_ns(&self, answered: &Stamp, now_ns: u64) -> u64 {
        if self.gate.is_live() {
            now_ns
        } else {
            answered.published_ns
        }
    }

    /// Tells that the last decision could not be sent.
    pub fn unsent(&mut self) {
        self.law.forget_sent();
    }

    /// What gate and law would send.
    fn propose(&mut self, inputs: &Inputs, record: &mut CycleRecord) -> Answer {
        match self.gate.judge(&inputs.features, inputs.now_ns) {
            Verdict::Step { features, link } => {
                show(&features, record);
                let effective_ns = self.effective_ns(&features.stamp, inputs.now_ns);
                let decision = self.law.step(&features, effective_ns, link, record);
                if decision.hold == Hold::None {
                    self.gate.approve();
                } else {
                    self.gate.hold(decision.hold);
                }
                self.standing = Answer {
                    stamp: features.stamp,
                    decision,
                };
                self.standing
            }
            Verdict::Repeat => self.standing,
            Verdict::Hold(cause, stamp) => {
                if cause == Hold::Hidden {
                    self.law.lose_sight();
                }
                Answer {
                    stamp,
                    decision: law::held(cause),
                }
            }
        }
    }

    fn change(&mut self, request: &Request) -> Outcome {
        let code = StrategyCode::from_code(request.strategy);
        let Some(strategy) = code.and_then(|code| law::strategy_of(code, request.neighbours))
        else {
            return Outcome::Neighbours;
        };
        if self.law.set_strategy(strategy) {
            Outcome::Done
        } else {
            Outcome::NoMemory
        }
    }
}

/// Whether the law ran, and if, whether its solver failed.
fn solver_failed(record: &CycleRecord) -> Option<bool> {
    match SolverStatus::from_code(record.status) {
        None | Some(SolverStatus::Idle) => None,
        Some(status) => Some(status == SolverStatus::NumericalFailure),
    }
}

/// Whether the memory was asked, and if, whether its answer was out of range.
fn recall_refused(record: &CycleRecord) -> Option<bool> {
    match RecallCode::from_code(record.recalled) {
        None | Some(RecallCode::Unasked) => None,
        Some(code) => Some(code == RecallCode::Refused),
    }
}

/// Copies the features into the record.
fn show(features: &Features, record: &mut CycleRecord) {
    record.count = features.count;
    record.points = features.points;
}
