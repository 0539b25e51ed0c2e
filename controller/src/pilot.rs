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

    /// Takes an operator's request; it counts from the next decision on. The answer lacks its stamp and cycle only.
    pub fn request(&mut self, request: &Request) -> Reply {
        let outcome = match (request.action(), request.strategy_code()) {
            (None, _) | (_, None) => Outcome::Unknown,
            (Some(Action::Strategy), Some(code)) => self.change(code, request.neighbours),
            // The recorder, not the pilot, knows about flight records.
            (Some(Action::Record), _) => Outcome::NoRecord,
            (Some(action), _) => self.supervisor.request(action),
        };
        let (state, hold) = self.supervisor.state();
        let (strategy, neighbours) = law::strategy_code(self.law.settings().strategy);
        Reply {
            stamp: Stamp {
                data_ns: request.stamp.published_ns,
                ..Stamp::default()
            },
            id: request.id,
            cycle: 0,
            action: request.action().unwrap_or(Action::Status).code(),
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

    fn change(&mut self, code: StrategyCode, neighbours: u32) -> Outcome {
        let Some(strategy) = law::strategy_of(code, neighbours) else {
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

#[cfg(test)]
mod tests {
    use ipc::{Order, Received};
    use rand::{Rng, RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;

    const MS: u64 = 1_000_000;
    const PERIOD: u64 = 33 * MS;
    const LIMITS: [f64; 6] = [0.5, 0.5, 0.5, 1.0, 1.0, 1.0];
    /// Features far from the goal: the law always wants to move.
    const FAR: [[f64; 2]; 4] = [
        [250.0, 250.0],
        [420.0, 260.0],
        [410.0, 430.0],
        [240.0, 420.0],
    ];

    fn nasty_instant(now_ns: u64, random: &mut impl Rng) -> u64 {
        match random.random_range(0..6) {
            0 => random.random(),
            1 => [0, 1, 1 << 63, u64::MAX - 1, u64::MAX][random.random_range(0..5)],
            _ => now_ns.saturating_add(PERIOD) - random.random_range(0..20 * PERIOD),
        }
    }

    fn nasty_stamp(now_ns: u64, random: &mut impl Rng) -> Stamp {
        Stamp {
            sequence: nasty_instant(now_ns, random),
            published_ns: nasty_instant(now_ns, random),
            data_ns: nasty_instant(now_ns, random),
        }
    }

    fn any_order(random: &mut impl Rng) -> Order {
        let missed = random.random();
        [
            Order::First,
            Order::Next,
            Order::Gap { missed },
            Order::Repeated,
            Order::Restarted,
        ][random.random_range(0..5)]
    }

    /// What a camera sends: good features mostly, so that the law has a say; anything else now and then.
    fn features(now_ns: u64, random: &mut impl Rng) -> Input {
        let points = FAR.map(|point| point.map(|x| x + random.random_range(-0.1..0.1)));
        let mut message = Features::new(&points, now_ns - 20 * MS);
        (message.stamp.sequence, message.stamp.published_ns) = (7, now_ns - MS);
        let mut order = Order::Next;
        match random.random_range(0..40) {
            0 => message.stamp = nasty_stamp(now_ns, random),
            1 => order = any_order(random),
            2 => message.points = message.points.map(|x| x * random.random_range(-1e9..1e9)),
            3 => message.points[random.random_range(0..8)] = f64::NAN,
            4 => message.count = random.random(),
            5 => message.visible = random.random(),
            6 => return Input::Nothing,
            7 => return Input::Refused(nasty_stamp(now_ns, random)),
            8 => return Input::Failed,
            _ => (),
        }
        Input::Message(Received { message, order })
    }

    fn robot(now_ns: u64, random: &mut impl Rng) -> Input<RobotState> {
        let mut message = RobotState::free_camera([0.0, 0.0, 0.5], [0.0; 3], now_ns);
        message.stamp.published_ns = now_ns;
        match random.random_range(0..40) {
            0 => message.stamp = nasty_stamp(now_ns, random),
            1 => message.mode = random.random(),
            2 => message.faults = random.random(),
            3..20 => return Input::Nothing,
            _ => (),
        }
        let order = any_order(random);
        Input::Message(Received { message, order })
    }

    #[test]
    fn in_real_time_no_input_whatsoever_panics_or_passes_the_limits() {
        let mut random = ChaCha8Rng::seed_from_u64(1);
        let text = scene::PAPER_SIM.to_owned();
        let mut law = Law::parse(text, "sim".to_owned(), None, vpc::Settings::default()).unwrap();
        law.go_live(3 * PERIOD);
        let rules = Rules {
            limits: LIMITS,
            brake_ns: 150 * MS,
            lost_ns: Some(300 * MS),
            armed: true,
        };
        let mut pilot = Pilot::new(law, Some(2 * PERIOD), rules);
        let mut now_ns = 1 << 40;
        let (mut moving, mut still) = (0, 0);
        for cycle in 0..30_000 {
            now_ns += match random.random_range(0..200) {
                0 => random.random_range(0..3000 * MS),
                1 => 0,
                _ => PERIOD,
            };
            // No clock should.
            now_ns -= if random.random_bool(0.005) { 2 * MS } else { 0 };
            if random.random_bool(0.3) {
                let action = if random.random_bool(0.9) {
                    Action::Arm.code()
                } else {
                    random.random_range(0..7)
                };
                let mut request = Request::new(cycle, Action::Status);
                (request.action, request.neighbours) = (action, random.random());
                pilot.request(&request);
            }
            let inputs = Inputs {
                now_ns,
                features: features(now_ns, &mut random),
                robot: robot(now_ns, &mut random),
                missed: match random.random_range(0..20) {
                    0 => random.random(),
                    _ => 0,
                },
                shutdown: false,
            };
            let Answer { decision, .. } = pilot.decide(&inputs, &mut CycleRecord::default());
            let mut shares = decision.twist.iter().zip(LIMITS);
            // A NaN is not within.
            let is_within = shares.all(|(v, limit)| v.abs() <= limit * (1.0 + 1e-9));
            assert!(is_within, "{decision:?} after {inputs:?}");
            match decision.twist == [0.0; 6] {
                true => still += 1,
                false => moving += 1,
            }
        }
        // Not for want of work, or of faults.
        assert!(moving > 3000 && still > 3000, "{moving} and {still}");
    }
}
